"""Ctrl-C where threads are at work: looked at by the loop, never raised while a lock is held."""

from __future__ import annotations

import signal
import threading

import pytest

from adaptiveface.runtime.interrupt import CtrlC


def press() -> None:
    signal.raise_signal(signal.SIGINT)


def test_the_first_one_is_noted_and_the_second_one_raises():
    with CtrlC() as ctrl_c:
        ctrl_c.check()
        press()
        assert ctrl_c.pressed
        with pytest.raises(KeyboardInterrupt):
            ctrl_c.check()
        with pytest.raises(KeyboardInterrupt):
            press()
    with pytest.raises(KeyboardInterrupt):  # afterwards all is as before
        press()


def test_a_lock_that_was_just_taken_is_given_back():
    """As it happens under load: the signal comes between taking a lock and the block that would release it."""

    class Lock:
        def __init__(self) -> None:
            self.lock = threading.Lock()

        def __enter__(self) -> None:
            self.lock.acquire()
            press()

        def __exit__(self, *_) -> None:
            self.lock.release()

    guarded = Lock()
    with CtrlC() as ctrl_c, guarded:
        pass
    assert ctrl_c.pressed and not guarded.lock.locked()


def test_who_handles_the_signal_already_goes_on_doing_so():
    caught = []
    before = signal.signal(signal.SIGINT, lambda *_: caught.append(True))
    try:
        with CtrlC() as ctrl_c:
            press()
    finally:
        signal.signal(signal.SIGINT, before)
    assert caught == [True] and not ctrl_c.pressed


def test_outside_the_main_thread_nothing_is_touched():
    handlers = []

    def work() -> None:
        with CtrlC():
            handlers.append(signal.getsignal(signal.SIGINT))

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert handlers == [signal.default_int_handler]
