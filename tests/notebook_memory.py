"""Memory of a notebook's kernel after each of its cells, MB: ``python tests/notebook_memory.py [06 ...]``

``own``: what the kernel allocated itself, and another kernel needs once more. ``files``: of programs, libraries and the cache,
which all kernels share and the system drops when it needs room. ``proportional``: own and the share in files, which depends on
who else runs. ``resident``: own and files, what ``top`` shows. Linux only; with the performance and the rig in the cache.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

import nbclient
import nbformat

from adaptiveface.lab import copy_notebooks, lab_environment

#: Sums over the kernel's mappings, MB; a name of its own that no notebook has.
PROBE = """
def _memory():
    lines = open("/proc/self/smaps_rollup").read().splitlines()[1:]
    kb = {name: int(value.split()[0]) for name, value in (line.split(":") for line in lines)}
    print(*(round(one / 1000) for one in (kb["Anonymous"], kb["Rss"] - kb["Anonymous"], kb["Pss"], kb["Rss"])))
_memory()
"""


def run(name: str) -> None:
    """Run the notebook without its exercises, and print a line for each code cell."""
    with tempfile.TemporaryDirectory() as folder:
        copy_notebooks(Path(folder))
        env = {k: v for k, v in lab_environment(Path(folder)).items() if k != "ADAPTIVEFACE_NOTEBOOK_FAST"}
        notebook = nbformat.read(Path(folder) / name, 4)
        cells = [cell for cell in notebook.cells if cell.cell_type == "code" and "exercises" not in cell.source]
        probes = [nbformat.v4.new_code_cell(PROBE) for _ in range(len(cells) + 1)]
        notebook.cells = [probes[0]] + [one for pair in zip(cells, probes[1:], strict=True) for one in pair]
        nbclient.NotebookClient(notebook, timeout=3600, resources={"metadata": {"path": folder}}).execute(env=env)
    print(f"{name:70s}   own files proportional resident")
    titles = ["(started)"] + [cell.source.strip().splitlines()[0] for cell in cells]
    for title, probe in zip(titles, probes, strict=True):
        own, files, proportional, resident = map(int, probe.outputs[-1].text.split())
        print(f"{title[:70]:70s} {own:5d} {files:5d} {proportional:12d} {resident:8d}", flush=True)


def main() -> int:
    """Run the chosen notebooks."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("numbers", nargs="*", default=["06"], help="e.g. 00 05; default: 06")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        copied = copy_notebooks(Path(folder)).new
    for name in sorted(n for n in copied if "/" not in n and n.partition("_")[0] in args.numbers):
        run(name)
    return 0


if __name__ == "__main__":
    sys.exit(main())
