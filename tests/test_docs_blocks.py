"""Code in the docs: every command line parses, and the "how do I" pages' blocks run on a small take."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest
from export_scene import save_run, tracked_result
from recordings import talking_head

from adaptiveface.cli import _parser, main

ROOT = Path(__file__).resolve().parents[1]
PAGES = sorted((ROOT / "docs").rglob("*.md"))
PAGES = [page for page in PAGES if not page.relative_to(ROOT / "docs").parts[0].startswith("_")]
HOWTO = [page for page in PAGES if page.parent.name == "howto" and page.name != "index.md"]
#: A fenced block; commands are run where "<!-- run -->" stands before it, the others need a sensor, minutes, or a file.
BLOCK = re.compile(r"(?P<run><!-- run -->\n)?```(?P<language>bash|python)\n(?P<text>.*?)```", re.DOTALL)


def commands(text: str) -> list[list[str]]:
    """The words of every command of this package in a block of shell lines."""
    lines = (shlex.split(line, comments=True) for line in text.replace("\\\n", " ").splitlines())
    return [words[1:] for words in lines if words[:1] == ["adaptiveface"]]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """What the pages name: result.npz and actor.npz, the recording ``take``, the curves take.csv."""
    folder = save_run(tmp_path_factory.mktemp("howto"), *tracked_result(frames=3)[:2])
    talking_head(folder / "take", 2)
    words = ["export", "result.npz", "--format", "arkit-csv", "--out", "take.csv"]
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        assert main(words) == 0
    return folder


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT / "docs").as_posix())
def test_every_command_line_is_one(page):
    parser = _parser()
    for block in BLOCK.finditer(page.read_text(encoding="utf-8")):
        for words in commands(block["text"]) if block["language"] == "bash" else ():
            parser.parse_args(words)


@pytest.mark.parametrize("page", HOWTO, ids=lambda page: page.stem)
def test_blocks_run(page, folder, monkeypatch):
    text = page.read_text(encoding="utf-8")
    if "table()" in text:
        pytest.importorskip("pandas")
    monkeypatch.chdir(folder)
    names: dict = {}
    for block in BLOCK.finditer(text):
        if block["language"] == "python":
            exec(compile(block["text"], str(page), "exec"), names)
        elif block["run"]:
            assert [main(words) for words in commands(block["text"])] == [0]


def test_the_pages_are_short_and_listed():
    listed = (ROOT / "docs" / "howto" / "index.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| \[[^\]]+\]\(([^)]+)\)", listed, re.MULTILINE)
    assert len(set(rows)) == len(rows) >= 20
    assert {page.name for page in HOWTO} <= set(rows) and set(rows) >= {f"../programs/{name}.md" for name in ("unity", "maya")}
    for row in rows:
        assert len((ROOT / "docs" / "howto" / row).read_text(encoding="utf-8").splitlines()) < 60, row
