"""What CONTRIBUTING shows runs as it is printed."""

from __future__ import annotations

import re
import runpy
import textwrap
from pathlib import Path

CONTRIBUTING = Path(__file__).resolve().parents[1] / "CONTRIBUTING.md"


def files_of(heading: str) -> dict[str, str]:
    """Name -> text of the Python files in a section: each starts with its name in a comment."""
    section = CONTRIBUTING.read_text(encoding="utf-8").split(f"## {heading}\n")[1].split("\n## ")[0]
    blocks = re.findall(r"```python\n(.*?)```", textwrap.dedent(section.replace("\n   ", "\n")), flags=re.DOTALL)
    return {block.splitlines()[0].removeprefix("# "): block for block in blocks}


def test_a_stage_is_added_in_two_files(tmp_path, monkeypatch):
    files = files_of("Add a stage in two files")
    assert list(files) == ["exponential.py", "test_exponential.py"]
    for name, text in files.items():
        (tmp_path / name).write_text(text, encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    names = runpy.run_path(str(tmp_path / "test_exponential.py"))
    (test,) = (value for name, value in names.items() if name.startswith("test_"))
    test()
