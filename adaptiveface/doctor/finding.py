"""Hold one line of the doctor's report, and ask the installed software."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec

OK, NOTE, FAULT = "ok", "note", "fault"
_SECONDS = 60


@dataclass(frozen=True)
class Finding:
    """One finding. ``state`` is :data:`OK`, :data:`NOTE` (optional and absent) or :data:`FAULT`. ``fix`` says what to do."""

    group: str
    name: str
    state: str
    text: str
    fix: str = ""


def installed(distribution: str) -> str | None:
    """Return the version of a distribution, or None if it is not installed."""
    try:
        return version(distribution)
    except PackageNotFoundError:
        return None


def importable(module: str) -> bool:
    """Whether a module is installed. It is not loaded."""
    try:
        return find_spec(module) is not None
    except (ImportError, ValueError):
        return False


def failure(statement: str) -> str | None:
    """Say in one line why a statement fails, or return None. It runs in a process of its own, as broken libraries crash."""
    try:
        run = subprocess.run(
            [sys.executable, "-c", statement],
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            errors="replace",
            timeout=_SECONDS,
        )
    except subprocess.TimeoutExpired:
        return f"no answer within {_SECONDS} s"
    if run.returncode == 0:
        return None
    lines = run.stderr.strip().splitlines()
    return lines[-1][:200] if lines and run.returncode > 0 else f"ended with {run.returncode}"
