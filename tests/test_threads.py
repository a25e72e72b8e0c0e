"""BLAS and OpenCV keep to one thread while frames are tracked."""

from __future__ import annotations

import cv2
import pytest
from threadpoolctl import threadpool_info

from adaptiveface.runtime.threads import one_thread


def blas_threads() -> set[int]:
    return {library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"}


def test_one_thread_holds_until_the_last_caller_ends():
    """Callers end in any order."""
    before = cv2.getNumThreads()
    cv2.setNumThreads(2)
    first, second = one_thread(), one_thread()
    try:
        for begin in (first, second):
            begin.__enter__()
        first.__exit__(None, None, None)
        assert cv2.getNumThreads() == 1 and blas_threads() == {1}
        second.__exit__(None, None, None)
        assert cv2.getNumThreads() == 2
    finally:
        cv2.setNumThreads(before)


def test_its_earlier_name_warns():
    from adaptiveface import pipeline

    with pytest.warns(DeprecationWarning, match="one_blas_thread is now called"):
        assert pipeline.one_blas_thread is one_thread
