"""Ctrl-C and its like as a wish that a loop looks at, where other threads are at work; SIGTERM as the same wish."""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager


class Terminated(KeyboardInterrupt):
    """SIGTERM: whoever stops this process (a service manager, a shutdown, ``kill``) wants an orderly end, as Ctrl-C does."""


def _terminate(*_) -> None:
    raise Terminated


#: Signal -> its handler that raises, which :class:`CtrlC` takes the place of.
_RAISING = {signal.SIGINT: signal.default_int_handler, signal.SIGTERM: _terminate}


@contextmanager
def orderly_end() -> Iterator[None]:
    """Inside, SIGTERM raises :class:`Terminated`, a KeyboardInterrupt.

    Only in the main thread, and where nobody handles or ignores the signal.
    """
    main = threading.current_thread() is threading.main_thread()
    handles = main and signal.getsignal(signal.SIGTERM) is signal.SIG_DFL
    if handles:
        signal.signal(signal.SIGTERM, _terminate)
    try:
        yield
    finally:
        if handles:
            signal.signal(signal.SIGTERM, signal.SIG_DFL)


def end_process(status: int) -> None:
    """End the process as ``sys.exit`` does; Ctrl-C while it ends is passed over, because nothing is left to be saved."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)
    try:
        sys.stdout.flush()
    except (OSError, ValueError):  # nobody reads any more: Python would say so once more
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        status = status or 1
    sys.exit(status)


class CtrlC:
    """A context manager. Inside it the first Ctrl-C or SIGTERM only sets ``pressed``; a second one raises.

    Python would raise KeyboardInterrupt between any two steps of the main thread, also when that has just taken a lock: it
    is then never given back, and whoever needs it to close (a tracker, a pool of writers) waits for ever. Outside the main
    thread, and where somebody else handles the signal, everything stays as it is.
    """

    def __init__(self) -> None:
        self.pressed: type[KeyboardInterrupt] | None = None
        self._handles: list[signal.Signals] = []

    def __enter__(self) -> CtrlC:
        if threading.current_thread() is threading.main_thread():
            self._handles = [number for number, handler in _RAISING.items() if signal.getsignal(number) is handler]
        for number in self._handles:
            signal.signal(number, self._press)
        return self

    def __exit__(self, *_) -> None:
        for number in self._handles:
            signal.signal(number, _RAISING[number])

    def check(self) -> None:
        """Raise KeyboardInterrupt (:class:`Terminated` for SIGTERM) when it was pressed, where nothing is held."""
        if self.pressed:
            raise self.pressed

    def _press(self, number: int, _) -> None:
        self.check()
        self.pressed = Terminated if number == signal.SIGTERM else KeyboardInterrupt
