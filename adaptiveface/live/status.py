"""One line of text that is written over in a terminal, and now and then a new one in a log file."""

from __future__ import annotations

import shutil
import sys
import time

#: Seconds between two lines where the output is no terminal, and between two updates where it is.
LOG_SECONDS, UPDATE_SECONDS = 5.0, 0.1


class StatusLine:
    """``show(text)`` as often as wanted; ``end(text)`` leaves a line that stays."""

    def __init__(self, stream=None) -> None:
        self._stream = stream or sys.stdout
        self._terminal = self._stream.isatty()
        self._next, self._open = 0.0, False

    def show(self, text: str) -> None:
        """Show ``text`` in place of what was shown before, if it is time."""
        now = time.monotonic()
        if now < self._next:
            return
        self._next = now + (UPDATE_SECONDS if self._terminal else LOG_SECONDS)
        if self._terminal:
            width = shutil.get_terminal_size().columns - 1
            self._stream.write(f"\r{text[:width]:<{width}}")
            self._open = True
        else:
            self._stream.write(f"{text}\n")
        self._stream.flush()

    def end(self, text: str = "") -> None:
        """A line that stays; without ``text`` only the end of the one that is shown."""
        if self._open:
            width = shutil.get_terminal_size().columns - 1
            self._stream.write("\r" + " " * width + "\r")
            self._open = False
        if text:
            self._stream.write(f"{text}\n")
        self._stream.flush()
