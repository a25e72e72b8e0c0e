"""A virtual environment with NumPy 1 for vendors' libraries, with what reading a sensor needs of this project."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]


def requirements(*extras: str) -> list[str]:
    """What reading a sensor needs of the project's own requirements, and these extras."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    needed = [p for p in project["dependencies"] if re.match(r"(numpy|opencv|pillow)", p)]
    assert len(needed) == 3
    return needed + [p for extra in extras for p in project["optional-dependencies"][extra]]


class Environment:
    """``environment(script, ...)`` runs Python there and returns what it printed (stderr where ``status`` is not 0)."""

    def __init__(self, folder: Path) -> None:
        if sys.version_info >= (3, 13) or sys.platform != "linux":
            pytest.skip("pyk4a-bundle has no build for this Python or system")
        self.python = folder / "venv" / "bin" / "python"
        self._try([sys.executable, "-m", "venv", str(self.python.parents[1])])
        self.install(*requirements("azure"))
        self._try([str(self.python), "-c", "import pyk4a"])

    def install(self, *packages: str) -> None:
        """Install ``packages``; skips the test where they cannot be had."""
        quiet = ["-q", "--disable-pip-version-check", "--no-compile", "--only-binary", ":all:"]
        self._try([str(self.python), "-m", "pip", "install", *quiet, *packages])

    def _try(self, command: list[str]) -> None:
        done = subprocess.run(command, capture_output=True, text=True, timeout=300)
        if done.returncode:
            pytest.skip(f"no environment with NumPy 1 and the vendors' libraries: {done.stderr.strip()[-300:]}")

    def __call__(self, *arguments, status: int = 0, folder: Path | None = None) -> str:
        values = {**os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT), str(ROOT / "tests")])}
        command = [str(self.python), *map(str, arguments)]
        done = subprocess.run(command, capture_output=True, text=True, timeout=120, env=values, cwd=folder)
        assert done.returncode == status, done.stderr[-2000:]
        return done.stdout if status == 0 else done.stderr
