"""Seconds every notebook takes from its first to its last cell, in full length: ``python tests/notebook_times.py [05 ...]``

Each one runs in a kernel of its own, on a fresh copy and with an empty cache: the performance is rendered and its rig
captured anew. ``--cold`` also has the kernels compiled anew, as on the first run after an installation. The limit is 60 s on
two quiet cores; the machine's load is printed beside the figures.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import time
from datetime import datetime
from pathlib import Path

import nbclient
import nbformat

from adaptiveface.lab import copy_notebooks, lab_environment

LIMIT = 60.0


def run(name: str, cold: bool) -> tuple[float, float, str]:
    """Seconds of the notebook, seconds of its slowest cell, and that cell's first line."""
    with tempfile.TemporaryDirectory() as folder:
        copy_notebooks(Path(folder))
        env = {k: v for k, v in lab_environment(Path(folder)).items() if k != "ADAPTIVEFACE_NOTEBOOK_FAST"}
        env |= {"XDG_CACHE_HOME": f"{folder}/cache", "ADAPTIVEFACE_STRICT": "1"}
        env |= {"NUMBA_CACHE_DIR": f"{folder}/compiled"} if cold else {}
        notebook = nbformat.read(Path(folder) / name, 4)
        client = nbclient.NotebookClient(notebook, timeout=600, resources={"metadata": {"path": folder}})
        start = time.perf_counter()
        client.execute(env=env)
        seconds = time.perf_counter() - start
    slowest, line = max((duration(cell), cell.source.splitlines()[0]) for cell in notebook.cells if cell.cell_type == "code")
    return seconds, slowest, line


def duration(cell) -> float:
    """Seconds between a cell's start and its end, as the kernel's messages are dated; 0 for one that did not run."""
    times = cell.metadata.get("execution", {})
    if "iopub.status.busy" not in times or "iopub.status.idle" not in times:
        return 0.0
    start, end = (datetime.fromisoformat(times[f"iopub.status.{state}"]) for state in ("busy", "idle"))
    return (end - start).total_seconds()


def main() -> int:
    """Run the chosen notebooks, print a line for each; 1 when one took longer than the limit."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cold", action="store_true", help="have the kernels compiled anew, too")
    parser.add_argument("numbers", nargs="*", help="e.g. 00 05 live; default: all")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        copied = copy_notebooks(Path(folder)).new
    names = sorted(n for n in copied if "/" not in n and (not args.numbers or n.partition("_")[0] in args.numbers))
    longest = 0.0
    for name in names:
        seconds, slowest, line = run(name, args.cold)
        longest = max(longest, seconds)
        load = f"load {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores"
        print(f"{name:32} {seconds:6.1f} s   slowest cell {slowest:5.1f} s: {line[:50]}   ({load})", flush=True)
    print(f"longest: {longest:.1f} s, limit {LIMIT:.0f} s")
    return int(longest > LIMIT)


if __name__ == "__main__":
    sys.exit(main())
