"""A line of text that is rewritten in place in a terminal; in a log file, a new line now and then."""

from __future__ import annotations

import shutil
import sys
import time

#: Seconds between two lines where the output is no terminal, and between two updates where it is.
LOG_SECONDS, UPDATE_SECONDS = 5.0, 0.1


class StatusLine:
    """Shows a changing text: call :meth:`show` as often as wanted, and :meth:`end` to leave a line that stays."""

    def __init__(self, stream=None) -> None:
        self._stream = stream or sys.stdout
        self._terminal = self._stream.isatty()
        self._next, self._open = 0.0, False

    def show(self, text: str) -> None:
        """Show ``text`` in place of what was shown before, unless that was just now."""
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
        """Write a line that stays; without ``text``, only clear the one that is shown."""
        if self._open:
            width = shutil.get_terminal_size().columns - 1
            self._stream.write("\r" + " " * width + "\r")
            self._open = False
        if text:
            self._stream.write(f"{text}\n")
        self._stream.flush()
