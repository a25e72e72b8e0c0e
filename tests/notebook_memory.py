"""Memory of a notebook's kernel after each of its cells, MB: ``python tests/notebook_memory.py [06 ...] [--kernels N]``

``--kernels``: N kernels at once, each through the whole notebook, and what they take together: a class on one server.

``own``: what the kernel allocated itself, and another kernel needs once more. ``files``: of programs, libraries and the cache,
which all kernels share and the system drops when it needs room. ``proportional``: own and the share in files, which depends on
who else runs. ``resident``: own and files, what ``top`` shows. Linux only; with the performance and the rig in the cache.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from contextlib import ExitStack
from pathlib import Path

import nbclient
import nbformat
import numpy as np

from adaptiveface.lab import copy_notebooks, lab_environment

#: Sums over the kernel's mappings, MB; a name of its own that no notebook has.
PROBE = """
def _memory():
    lines = open("/proc/self/smaps_rollup").read().splitlines()[1:]
    kb = {name: int(value.split()[0]) for name, value in (line.split(":") for line in lines)}
    print(*(round(one / 1000) for one in (kb["Anonymous"], kb["Rss"] - kb["Anonymous"], kb["Pss"], kb["Rss"])))
_memory()
"""


def prepared(folder: Path, name: str) -> tuple[dict[str, str], nbformat.NotebookNode, list[nbformat.NotebookNode]]:
    """Environment, notebook and its code cells without the exercises, in a fresh copy."""
    copy_notebooks(folder)
    env = {k: v for k, v in lab_environment(folder).items() if k != "ADAPTIVEFACE_NOTEBOOK_FAST"}
    notebook = nbformat.read(folder / name, 4)
    return env, notebook, [cell for cell in notebook.cells if cell.cell_type == "code" and "exercises" not in cell.source]


def together(name: str, count: int) -> None:
    """Take ``count`` kernels through the notebook, one after the other, keep them, and print what they share and what not."""
    with tempfile.TemporaryDirectory() as folder, ExitStack() as kernels:
        env, notebook, notebook.cells = prepared(Path(folder), name)
        clients = []
        for number in range(count):
            client = nbclient.NotebookClient(notebook, timeout=3600, resources={"metadata": {"path": folder}})
            kernels.enter_context(client.setup_kernel(env=env))
            for index, cell in enumerate(notebook.cells):
                client.execute_cell(cell, index)
            clients.append(client)
            held = np.array([held_by(one.km.provisioner.process.pid) for one in clients])
            own, proportional, resident = held.sum(axis=0) / len(held)
            print(
                f"{name}: {number + 1} kernels, each: own {own:.0f} MB, with its share of the files {proportional:.0f}, "
                f"resident {resident:.0f}; together {held[:, 1].sum():.0f}",
                flush=True,
            )


def held_by(process: int) -> tuple[float, float, float]:
    """Own, proportional and resident memory of a process, MB."""
    lines = Path(f"/proc/{process}/smaps_rollup").read_text().splitlines()[1:]
    kb = {key: int(value.split()[0]) for key, value in (line.split(":") for line in lines)}
    return kb["Anonymous"] / 1000, kb["Pss"] / 1000, kb["Rss"] / 1000


def run(name: str) -> None:
    """Run the notebook without its exercises, and print a line for each code cell."""
    with tempfile.TemporaryDirectory() as folder:
        env, notebook, cells = prepared(Path(folder), name)
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
    parser.add_argument("--kernels", type=int, default=0, metavar="N", help="what N kernels take together")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        copied = copy_notebooks(Path(folder)).new
    for name in sorted(n for n in copied if "/" not in n and n.partition("_")[0] in args.numbers):
        together(name, args.kernels) if args.kernels else run(name)
    return 0


if __name__ == "__main__":
    sys.exit(main())
