"""Keep BLAS on one thread while frames are tracked, for any number of callers that may end in any order."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager

from threadpoolctl import threadpool_limits

_lock = threading.Lock()
_limits: list[threadpool_limits] = []
_users = 0


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Run BLAS on one thread inside this context. On shared cores, a second thread stalls small solves for up to 100 ms.

    The limit holds for the whole process. Contexts may overlap in any order and in any threads. The first one sets the limit,
    each one extends it to the libraries that were loaded since, and the last one to end restores the state from before.
    """
    global _users
    with _lock:
        _users += 1
        _limits.append(threadpool_limits(limits=1, user_api="blas"))
    try:
        yield
    finally:
        with _lock:
            _users -= 1
            while not _users and _limits:
                _limits.pop().restore_original_limits()
