"""Turn Ctrl-C and SIGTERM into a wish that a loop looks at, so that they do not interrupt code that holds locks."""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager


class Terminated(KeyboardInterrupt):
    """The end that SIGTERM asks for. A service manager, a shutdown or ``kill`` wants an orderly end, as Ctrl-C does."""


def _terminate(*_) -> None:
    raise Terminated


#: The handler of each signal that raises an error. :class:`CtrlC` replaces these handlers.
_RAISING = {signal.SIGINT: signal.default_int_handler, signal.SIGTERM: _terminate}


@contextmanager
def orderly_end() -> Iterator[None]:
    """Let SIGTERM raise :class:`Terminated`, a KeyboardInterrupt, inside this context.

    It does so only in the main thread, and only if nobody else handles or ignores the signal.
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
    """End the process as ``sys.exit`` does. Ctrl-C is ignored meanwhile, because nothing is left to be saved."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)
    try:
        sys.stdout.flush()
    except (OSError, ValueError):  # nobody reads the output any more, and Python would report that once more
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        status = status or 1
    sys.exit(status)


class CtrlC:
    """A context manager inside which the first Ctrl-C or SIGTERM only sets ``pressed``. A second one raises.

    Python would raise KeyboardInterrupt between any two steps of the main thread, even right after it has taken a lock. The
    lock would then never be released, and a tracker or a pool of writers that needs it for closing would wait for ever.
    Outside the main thread, and if somebody else handles the signal, nothing changes.
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
        """Raise KeyboardInterrupt (:class:`Terminated` for SIGTERM) if it was pressed. Call this where no lock is held."""
        if self.pressed:
            raise self.pressed

    def _press(self, number: int, _) -> None:
        self.check()
        self.pressed = Terminated if number == signal.SIGTERM else KeyboardInterrupt
