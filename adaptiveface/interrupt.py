"""Ctrl-C as a wish that a loop looks at, where other threads are at work."""

from __future__ import annotations

import signal
import threading


class CtrlC:
    """A context manager. Inside it the first Ctrl-C only sets ``pressed``; a second one raises KeyboardInterrupt.

    Python would raise it between any two steps of the main thread, also when that has just taken a lock: it is then never
    given back, and whoever needs it to close (a tracker, a pool of writers) waits for ever. Outside the main thread, and
    where somebody else handles the signal, everything stays as it is.
    """

    def __init__(self) -> None:
        self.pressed = False
        self._handles = False

    def __enter__(self) -> CtrlC:
        main = threading.current_thread() is threading.main_thread()
        self._handles = main and signal.getsignal(signal.SIGINT) is signal.default_int_handler
        if self._handles:
            signal.signal(signal.SIGINT, self._press)
        return self

    def __exit__(self, *_) -> None:
        if self._handles:
            signal.signal(signal.SIGINT, signal.default_int_handler)

    def check(self) -> None:
        """Raise KeyboardInterrupt when it was pressed, at a place where nothing is held."""
        if self.pressed:
            raise KeyboardInterrupt

    def _press(self, *_) -> None:
        self.check()
        self.pressed = True
