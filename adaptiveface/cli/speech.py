"""Make sure that what commands print arrives on any terminal, pipe or file."""

from __future__ import annotations

import io
import sys


def speak() -> None:
    """Escape characters that the output's encoding lacks (``\\\\u30c6``), so that no message can end a job.

    This applies to everything that is written there: print, progress bars, warnings, logging, and Python's own messages.
    """
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # None where there is no console
            stream.reconfigure(errors="backslashreplace")
