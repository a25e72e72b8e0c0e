"""Show a status: a line that is rewritten in a terminal or, in a log file, a new line now and then."""

from __future__ import annotations

import sys
import time

from tqdm import tqdm

#: Seconds between two lines where the output is no terminal, and between two updates where it is.
LOG_SECONDS, UPDATE_SECONDS = 5.0, 0.1


class StatusLine:
    """Shows a changing text: call :meth:`show` as often as wanted, and :meth:`end` to leave a line that stays."""

    def __init__(self, stream=None) -> None:
        self._stream = stream or sys.stdout
        self._bar: tqdm | None = None  # made on first need, because it writes to the terminal
        self._next = 0.0

    def show(self, text: str) -> None:
        """Show ``text`` in place of what was shown before, unless that was just now."""
        now = time.monotonic()
        if now < self._next:
            return
        terminal = self._stream.isatty()
        self._next = now + (UPDATE_SECONDS if terminal else LOG_SECONDS)
        if not terminal:
            print(text, file=self._stream, flush=True)
            return
        if self._bar is None:
            self._bar = tqdm(file=self._stream, bar_format="{desc}", dynamic_ncols=True, leave=False)
        self._bar.set_description_str(text)

    def end(self, text: str = "") -> None:
        """Write a line that stays; without ``text``, only clear the one that is shown."""
        if self._bar is not None:
            self._bar.close()
            self._bar = None
        if text:
            print(text, file=self._stream)
        self._stream.flush()
