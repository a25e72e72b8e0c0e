"""Keep BLAS and OpenCV on one thread while frames are tracked, for any number of callers that may end in any order."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager

import cv2
from threadpoolctl import threadpool_limits

from ..renamed import old_objects

__getattr__ = old_objects(__name__)

_lock = threading.Lock()
_limits: list[threadpool_limits] = []
_users, _opencv = 0, 1


@contextmanager
def one_thread() -> Iterator[None]:
    """Run BLAS and OpenCV on one thread inside this context.

    On shared cores, a second BLAS thread stalls small solves for up to 100 ms. A second OpenCV thread adds 1.9 ms of processor
    time to each frame with pictures and makes none of them faster (10.1 ms with one thread, 10.2 with two): the parts of the
    pictures that are looked at are small.

    The limit holds for the whole process. Contexts may overlap in any order and in any threads. The first one sets the limit,
    each one extends it to the BLAS libraries that were loaded since, and the last one to end restores the state from before.
    """
    global _users, _opencv
    with _lock:
        if not _users:
            _opencv = cv2.getNumThreads()
            cv2.setNumThreads(1)
        _users += 1
        _limits.append(threadpool_limits(limits=1, user_api="blas"))
    try:
        yield
    finally:
        with _lock:
            _users -= 1
            if not _users:
                cv2.setNumThreads(_opencv)
            while not _users and _limits:
                _limits.pop().restore_original_limits()
