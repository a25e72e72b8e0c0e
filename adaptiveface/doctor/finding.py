"""One line of the doctor's report, and how the installed software is asked."""

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
    """``state``: :data:`OK`; :data:`NOTE`, something optional is absent; :data:`FAULT`. ``fix``: what to do, or ""."""

    group: str
    name: str
    state: str
    text: str
    fix: str = ""


def installed(distribution: str) -> str | None:
    """The version of an installed distribution; None without it."""
    try:
        return version(distribution)
    except PackageNotFoundError:
        return None


def importable(module: str) -> bool:
    """Whether a module is there; it is not loaded."""
    try:
        return find_spec(module) is not None
    except (ImportError, ValueError):
        return False


def failure(statement: str) -> str | None:
    """Why a statement fails in a Python of its own, in one line; None when it does not. Broken libraries crash."""
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
