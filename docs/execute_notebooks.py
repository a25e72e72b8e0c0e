"""Run the notebooks for the site: ``python docs/execute_notebooks.py [01 ...]``. Copies with outputs go to docs/_executed.

A copy is made again only when its notebook or the package has changed, so that the site itself is built in seconds.
"""

from __future__ import annotations

import hashlib
import json
import sys
from pathlib import Path

import nbclient
import nbformat

HERE = Path(__file__).resolve().parent
NOTEBOOKS, EXECUTED = HERE.parent / "notebooks", HERE / "_executed"
sys.path.insert(0, str(HERE / "_ext"))

from panels import static  # noqa: E402

#: Seconds of one cell.
LIMIT = 600


def package_hash() -> str:
    """Of every source file of the package and of what makes a page of a notebook."""
    digest = hashlib.sha256()
    for path in sorted([*(HERE.parent / "adaptiveface").rglob("*.py"), HERE / "_ext" / "panels.py"]):
        digest.update(path.read_bytes())
    return digest.hexdigest()


def execute(path: Path, package: str) -> bool:
    """Write the executed copy of a notebook, unless there is one of the same content; whether it was run."""
    key = hashlib.sha256(path.read_bytes() + package.encode()).hexdigest()
    target = EXECUTED / path.name
    if target.exists() and json.loads(target.read_text(encoding="utf-8"))["metadata"].get("made_from") == key:
        return False
    notebook = nbformat.read(path, 4)
    resources = {"metadata": {"path": str(path.parent)}}
    nbclient.NotebookClient(
        notebook, timeout=LIMIT, kernel_name="python3", store_widget_state=True, resources=resources
    ).execute()
    page = static(notebook)
    page["metadata"]["made_from"] = key
    EXECUTED.mkdir(exist_ok=True)
    target.write_text(json.dumps(page, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    return True


def main() -> None:
    """Run the notebooks whose names begin with one of the arguments; without any, all."""
    package, wanted = package_hash(), tuple(sys.argv[1:]) or ("",)
    for path in sorted(NOTEBOOKS.glob("*.ipynb")):
        if path.name.startswith(wanted):
            print(f"{path.name}: {'run' if execute(path, package) else 'unchanged'}", flush=True)


if __name__ == "__main__":
    main()
