"""Keep BLAS on one thread while frames are tracked, however many callers ask for that and in whatever order they end."""

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
    """Context in which BLAS runs on one thread: on shared cores a second one stalls small solves for up to 100 ms.

    The limit belongs to the whole process. Contexts may overlap in any order, in any threads: the first one sets the
    limit, each covers the libraries that were loaded since, and the last one to end restores what was there before.
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
