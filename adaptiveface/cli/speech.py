"""Make sure that what commands print arrives on any terminal, pipe or file."""

from __future__ import annotations

import io
import sys


def speak() -> None:
    """Write characters that the output's encoding lacks as escapes, so that no message ends a job: ``\\\\u30c6``.

    For everything that writes there: print, progress bars, warnings, logging, and Python's own messages.
    """
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # None where there is no console
            stream.reconfigure(errors="backslashreplace")
