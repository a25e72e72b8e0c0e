"""Blender for the tests: which Python has it, and one run of :mod:`blender.evaluate` in a process of its own."""

from __future__ import annotations

import functools
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

SCRIPT = Path(__file__).with_name("blender") / "evaluate.py"


@functools.cache
def blender_python() -> str | None:
    """A Python that can import ``bpy``: ``ADAPTIVEFACE_BLENDER_PYTHON``, or this one (extra ``blender``)."""
    python = os.environ.get("ADAPTIVEFACE_BLENDER_PYTHON", sys.executable)
    run = subprocess.run([python, "-c", "import importlib.util as u, sys; sys.exit(u.find_spec('bpy') is None)"])
    return python if run.returncode == 0 else None


needs_blender = pytest.mark.skipif(blender_python() is None, reason="the extra 'blender' (bpy) is not installed")


def evaluate(folder: Path, jobs: dict) -> dict[str, np.ndarray]:
    """What Blender says to ``jobs`` (:mod:`blender.evaluate`)."""
    (folder / "jobs.json").write_text(json.dumps(jobs))
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    command = [blender_python(), str(SCRIPT), str(folder / "jobs.json"), str(folder / "answer.npz")]
    run = subprocess.run(command, capture_output=True, text=True, timeout=300, env=environment)
    assert run.returncode == 0, run.stdout[-1500:] + run.stderr[-1500:]
    with np.load(folder / "answer.npz", allow_pickle=False) as answer:
        return dict(answer)
