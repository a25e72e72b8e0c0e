"""For the teacher: notebooks without solutions, and a class's submissions graded in one go.

A submission is a notebook, or a Python file, that defines functions with the names of the exercises. Only imports,
constants, functions and classes of it are run, each file in a process of its own. That is no sandbox: grade
submissions as a user who has nothing to lose, or in a container.
"""

from __future__ import annotations

import ast
import csv
import json
import re
import subprocess
import sys
import textwrap
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from tqdm import tqdm

from ..errors import AdaptiveFaceError, FileFormatError
from ..files import read_text, replacing
from .grading import Exercise

MAX_BYTES = 8 << 20
#: Seconds for all exercises of one submission; each call has a limit of its own.
MAX_SECONDS = 300
_SOLUTION = re.compile(r"\s*A\s+solution\s+is\s+in\s+\[[^\]]*\]\([^)]*\)\.", re.S)

_START = """# How to begin

1. `python -m pip install "adaptiveface[notebooks]=={version}"`, or what your teacher names instead; then `adaptiveface doctor`.
2. `jupyter lab` in this folder. Open the notebook of the sheet, and run its cells from the top (Shift+Enter). The first run
   renders a performance, which takes half a minute.
3. An exercise has a cell with an empty function. Write it, run the cell, and run the cell below it: that is the grader. It says
   what is wrong. The hints help: the first says where to look, the second what to do, the third holds the formula.
4. Hand in: save the notebook and send the file. Keep the functions' names; only they, and what they need, are graded. To see
   what the teacher will see, put the file into a folder of its own and run `adaptiveface exercises --grade FOLDER`.

The exercises stand at the end of their notebooks:

| notebook | function | hints |
|---|---|---|
{rows}
"""


@dataclass(frozen=True)
class Mark:
    """One exercise of one student: ``points`` 1 or 0, and ``remark``, the grader's words."""

    student: str
    exercise: str
    points: int
    remark: str


def student_copy(source: Path, target: Path) -> list[Path]:
    """Copy the notebooks of ``source`` to the new folder ``target``, without solutions and without links to them.

    Raises :class:`AdaptiveFaceError` where ``target`` holds something already.
    """
    if target.exists() and (not target.is_dir() or any(target.iterdir())):
        raise AdaptiveFaceError(f"{target}: exists already; name a new folder, so that no student's work is lost")
    target.mkdir(parents=True, exist_ok=True)
    written = []
    for path in sorted(source.glob("*.ipynb")):
        notebook = json.loads(read_text(path, MAX_BYTES))
        for cell in notebook["cells"]:
            text = "".join(cell["source"])
            if cell["cell_type"] == "markdown" and "solutions/" in text:
                cell["source"] = _SOLUTION.sub("", text).rstrip().splitlines(keepends=True)
        with replacing(target / path.name) as temporary:
            temporary.write_text(json.dumps(notebook, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
        written.append(target / path.name)
    with replacing(target / "README.md") as temporary:
        temporary.write_text(_start(), encoding="utf-8")
    return written


def _start() -> str:
    """The README of a student copy: how to begin, and every exercise by the names under which it is found."""
    from .. import __version__, exercises

    named = {id(getattr(exercises, name)): name for name in exercises.__all__}
    rows = [
        f"| {exercise.notebook} | `{exercise.name}` | `exercises.{named[id(exercise)]}.hint(1)` |"
        for exercise in sorted(exercises.EXERCISES, key=lambda exercise: exercise.notebook)
    ]
    return _START.format(version=__version__, rows="\n".join(rows))


def find_submissions(folder: Path) -> dict[str, list[Path]]:
    """Student -> files. A folder of the class holds a folder for each student, or a file for each.

    Raises :class:`FileFormatError` where there is none.
    """
    if not folder.is_dir():
        raise FileFormatError(f"{folder}: no such folder of submissions")
    found: dict[str, list[Path]] = {}
    for entry in sorted(folder.iterdir()):
        if entry.name.startswith("."):
            continue
        if entry.is_dir():
            files = [path for path in sorted(entry.rglob("*")) if _is_submission(path)]
            if files:
                found[entry.name] = files
        elif _is_submission(entry):
            found[entry.stem] = [entry]
    if not found:
        raise FileFormatError(f"{folder}: holds no submission (.ipynb or .py, one folder or one file per student)")
    return found


def _is_submission(path: Path) -> bool:
    return path.suffix in (".ipynb", ".py") and ".ipynb_checkpoints" not in path.parts


def grade_folder(folder: Path, exercises: Sequence[Exercise], progress: bool = False) -> list[Mark]:
    """Every exercise of every student below ``folder``; an exercise that was not handed in has no points."""
    marks = []
    submissions = find_submissions(folder)
    for student, files in tqdm(submissions.items(), desc="grading", unit="student", disable=None if progress else True):
        answers = _graded_apart(files)
        for exercise in exercises:
            passed, remark = answers.get(exercise.name, (False, "not handed in"))
            marks.append(Mark(student, exercise.name, int(passed), remark))
    return marks


def _graded_apart(files: Sequence[Path]) -> dict[str, tuple[bool, str]]:
    command = [sys.executable, "-m", "adaptiveface.exercises.submission", *map(str, files)]
    try:
        run = subprocess.run(command, capture_output=True, timeout=MAX_SECONDS, stdin=subprocess.DEVNULL, check=False)
    except subprocess.TimeoutExpired:
        return _all_exercises(f"the submission did not end within {MAX_SECONDS} seconds")
    last = run.stdout.decode(errors="replace").splitlines()[-1:]
    try:
        return {name: (bool(passed), str(remark)) for name, (passed, remark) in json.loads(last[0]).items()}
    except (IndexError, ValueError, TypeError, AttributeError):
        return _all_exercises(f"the submission ended the grader's process (status {run.returncode})")


def _all_exercises(remark: str) -> dict[str, tuple[bool, str]]:
    from . import EXERCISES

    return {exercise.name: (False, remark) for exercise in EXERCISES}


def definitions(path: Path) -> list[ast.stmt]:
    """Imports, constants, functions and classes of a notebook or a Python file; what cannot be parsed is left out.

    A cell with a syntax error does not take the others with it.
    """
    text = read_text(path, MAX_BYTES)
    cells = [text]
    if path.suffix == ".ipynb":
        try:
            cells = ["".join(c["source"]) for c in json.loads(text)["cells"] if c["cell_type"] == "code"]
        except (ValueError, KeyError, TypeError):
            raise FileFormatError(f"{path}: not a notebook") from None
    kept: list[ast.stmt] = []
    for cell in cells:
        lines = [line for line in cell.splitlines() if not line.lstrip().startswith(("%", "!"))]
        try:
            body = ast.parse(textwrap.dedent("\n".join(lines))).body
        except SyntaxError:
            continue
        kept += [node for node in body if isinstance(node, _DEFINITIONS) or _is_constant(node)]
    return kept


_DEFINITIONS = (ast.Import, ast.ImportFrom, ast.FunctionDef, ast.ClassDef)


def _is_constant(node: ast.stmt) -> bool:
    if not isinstance(node, ast.Assign):
        return False
    try:
        ast.literal_eval(node.value)
    except ValueError:
        return False
    return True


def write_marks(folder: Path, marks: Sequence[Mark]) -> list[Path]:
    """``grades.csv`` and ``grades.json`` (a row per student and exercise), and ``gradescope/STUDENT.json``."""
    folder.mkdir(parents=True, exist_ok=True)
    table, tree = folder / "grades.csv", folder / "grades.json"
    with replacing(table) as temporary, open(temporary, "w", newline="", encoding="utf-8") as stream:
        writer = csv.DictWriter(stream, ["student", "exercise", "points", "remark"])
        writer.writeheader()
        writer.writerows(asdict(mark) for mark in marks)
    with replacing(tree) as temporary:
        temporary.write_text(json.dumps([asdict(mark) for mark in marks], indent=1, ensure_ascii=False), encoding="utf-8")
    (folder / "gradescope").mkdir(exist_ok=True)
    written = [table, tree]
    for student in dict.fromkeys(mark.student for mark in marks):
        tests = [
            {
                "name": m.exercise,
                "score": m.points,
                "max_score": 1,
                "status": "passed" if m.points else "failed",
                "output": m.remark,
            }
            for m in marks
            if m.student == student
        ]
        with replacing(folder / "gradescope" / f"{student}.json") as temporary:
            content = {"score": sum(m.points for m in marks if m.student == student), "tests": tests}
            temporary.write_text(json.dumps(content, indent=1, ensure_ascii=False), encoding="utf-8")
        written.append(folder / "gradescope" / f"{student}.json")
    return written


_OTTER = '''"""Written by `adaptiveface exercises --otter`: exercise {name}."""

OK_FORMAT = False

from otter.test_files import test_case

name = "{name}"
points = 1


@test_case()
def test_{name}(env):
    from adaptiveface import exercises

    exercise = next(e for e in exercises.EXERCISES if e.name == "{name}")
    assert "{name}" in env, "the function {name} is not defined"
    grade = exercise.grade(env["{name}"])
    assert grade.passed, str(grade)
'''


def write_otter_tests(folder: Path, exercises: Sequence[Exercise]) -> list[Path]:
    """One test file per exercise for otter-grader (its exception-based format) in ``folder``."""
    folder.mkdir(parents=True, exist_ok=True)
    written = []
    for exercise in exercises:
        path = folder / f"{exercise.name}.py"
        with replacing(path) as temporary:
            temporary.write_text(_OTTER.format(name=exercise.name), encoding="utf-8")
        written.append(path)
    return written
