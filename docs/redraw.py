"""Redraw the parts of the docs that are made from the code: `python docs/redraw.py` writes, `--check` only tells.

A page marks such a part with two comments, ``<!-- NAME -->`` and ``<!-- /NAME -->``. Between them stands what the function
of that name in ``PARTS`` returns.
"""

from __future__ import annotations

import ast
import re
import sys
from collections.abc import Callable
from pathlib import Path

from adaptiveface.evaluation.compare import OtherResult
from adaptiveface.evaluation.truth import StoredTruth
from adaptiveface.files.records import table
from adaptiveface.importers.flame import FlameFile
from adaptiveface.importers.gnm import GnmFile
from adaptiveface.model.actor import Actor
from adaptiveface.result import Result
from adaptiveface.retargeting.character import CharacterFile

DOCS = Path(__file__).resolve().parent
sys.path[:0] = [str(DOCS), str(DOCS.parent / "tests")]
from frame_walk import frame_walk  # noqa: E402
from test_architecture import FLOORS, PACKAGE, files, place, places_of  # noqa: E402


def floors() -> str:
    """The table of the packages by floor, from the top, with the first sentence of each one's docstring and its imports."""
    rows = ["| floor | package | responsibility | imports from |", "|---|---|---|---|"]
    for floor, names in reversed(FLOORS.items()):
        for name in sorted(names):
            below = sorted(set().union(*(places_of(path) for path in files() if place(path) == name)))
            rows.append(f"| {floor} | `{name}` | {sentence(name)} | {', '.join(below)} |")
            floor = ""
    return "\n".join(rows)


def sentence(name: str) -> str:
    """The first sentence of a package's or module's docstring, as Markdown."""
    path = PACKAGE / name / "__init__.py" if (PACKAGE / name).is_dir() else PACKAGE / f"{name}.py"
    text = (ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or "").split("\n\n")[0].replace("\n", " ")
    return re.sub(r":\w+:`[~.]*([^`]+)`", r"`\1`", text.replace("``", "`")).replace("|", r"\|")


PARTS: dict[str, Callable[[], str]] = {
    "floors": floors,
    "frame walk": lambda: "```text\n" + "\n".join(frame_walk()) + "\n```",
    "actor.npz": lambda: table(Actor),
    "result.npz": lambda: table(Result),
    "character.npz": lambda: table(CharacterFile),
    "flame.npz": lambda: table(FlameFile),
    "gnm_head.npz": lambda: table(GnmFile),
    "ground_truth.npz": lambda: table(StoredTruth),
    "another tracker's .npz": lambda: table(OtherResult),
}


def redrawn(text: str) -> str:
    """A page with every marked part as the code has it now."""
    for name, draw in PARTS.items():
        marked = rf"(<!-- {re.escape(name)} -->\n).*?(<!-- /{re.escape(name)} -->)"
        if re.search(marked, text, re.DOTALL):
            drawn = draw()
            text = re.sub(marked, lambda found, drawn=drawn: f"{found[1]}\n{drawn}\n\n{found[2]}", text, flags=re.DOTALL)
    return text


def pages() -> list[Path]:
    """The pages with a marked part."""
    return [page for page in sorted(DOCS.glob("*.md")) if "<!-- /" in page.read_text(encoding="utf-8")]


def main(words: list[str]) -> int:
    """Write, or with ``--check`` name, the pages that are not as the code is."""
    old = {page: text for page in pages() if redrawn(text := page.read_text(encoding="utf-8")) != text}
    for page, text in old.items():
        if "--check" not in words:
            page.write_text(redrawn(text), encoding="utf-8")
        print(f"{page.name}: {'differs from the code' if '--check' in words else 'redrawn'}")
    return 1 if old and "--check" in words else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
