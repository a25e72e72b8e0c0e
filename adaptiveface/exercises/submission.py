"""Grades one student's files and prints a JSON object as its last line: ``python -m adaptiveface.exercises.submission``."""

from __future__ import annotations

import ast
import io
import json
import linecache
import sys
from collections.abc import Sequence
from contextlib import redirect_stderr, redirect_stdout, suppress
from pathlib import Path

from ..errors import AdaptiveFaceError
from . import EXERCISES
from .classroom import definitions


def grade_files(files: Sequence[Path]) -> dict[str, tuple[bool, str]]:
    """Exercise -> (passed, remark) for every exercise that the files define a function for."""
    answers: dict[str, tuple[bool, str]] = {}
    for path in files:
        try:
            nodes = definitions(path)
        except AdaptiveFaceError as error:
            answers.update({e.name: (False, str(error)) for e in EXERCISES if e.name not in answers})
            continue
        space = _run(nodes, path)
        for exercise in EXERCISES:
            function = space.get(exercise.name)
            if callable(function) and not answers.get(exercise.name, (False, ""))[0]:
                grade = exercise.grade(function)
                answers[exercise.name] = (grade.passed, str(grade))
    return answers


def _run(nodes: Sequence[ast.stmt], path: Path) -> dict:
    """The names that the definitions make; one that fails, such as a missing import, does not take the others with it."""
    space: dict = {"__name__": "submission"}
    for number, node in enumerate(nodes):
        source, name = ast.unparse(node), f"<{path.name} {number}>"
        linecache.cache[name] = (len(source), None, source.splitlines(keepends=True), name)
        with suppress(Exception):
            exec(compile(source, name, "exec"), space)  # noqa: S102 - a student's code is what is graded
    return space


def main(arguments: Sequence[str]) -> int:
    """Grade the files and print the answers; what the submission prints is dropped."""
    with redirect_stdout(io.StringIO()), redirect_stderr(io.StringIO()):
        answers = grade_files([Path(argument) for argument in arguments])
    print("\n" + json.dumps(answers))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
