"""Redraw the parts of the docs that are made from the code: `python docs/redraw.py` writes, `--check` only tells.

A page marks such a part with two comments, ``<!-- NAME -->`` and ``<!-- /NAME -->``. Between them stands what the function
of that name in ``PARTS`` returns.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Callable
from pathlib import Path

from adaptiveface.files.records import table
from adaptiveface.model.actor import Actor
from adaptiveface.result import Result

DOCS = Path(__file__).resolve().parent
PARTS: dict[str, Callable[[], str]] = {
    "actor.npz": lambda: table(Actor),
    "result.npz": lambda: table(Result),
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
