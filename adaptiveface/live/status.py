"""Show a status in a line that is rewritten in a terminal. In a log file, a new line appears now and then."""

from __future__ import annotations

import sys
import time

from tqdm import tqdm

#: Shortest time between two lines in a log file, and between two updates in a terminal, s.
LOG_SECONDS, UPDATE_SECONDS = 5.0, 0.1


class StatusLine:
    """Shows a changing text. :meth:`show` may be called at any rate, and :meth:`end` writes a line that stays.

    Parameters
    ----------
    stream : text file, optional
        The output. The default is the standard output.
    """

    def __init__(self, stream=None) -> None:
        self._stream = stream or sys.stdout
        self._bar: tqdm | None = None  # made when it is first needed, because it writes to the terminal
        self._next = 0.0

    def show(self, text: str) -> None:
        """Replace the text, unless the last one was shown just now."""
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
        """Write a line that stays. Without ``text``, the line that is shown is only cleared."""
        if self._bar is not None:
            self._bar.close()
            self._bar = None
        if text:
            print(text, file=self._stream)
        self._stream.flush()
