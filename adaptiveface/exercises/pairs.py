"""Answers that are several arrays: packed into one vector, so that they are compared as one."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from .grading import Wrong, as_array


def packed(answer: Any, parts: Sequence[tuple[str, tuple[int, ...]]]) -> np.ndarray:
    """One vector of a tuple of arrays.

    Parameters
    ----------
    answer : tuple
        What the learner's function returned.
    parts : sequence of (name, shape)
        What is expected, in this order.

    Raises
    ------
    Wrong
        It is no tuple of so many arrays, or one of them has the wrong shape.
    """
    names = ", ".join(name for name, _ in parts)
    if not isinstance(answer, (tuple, list)) or len(answer) != len(parts):
        raise Wrong(f"{len(parts)} values ({names}) are expected, as a tuple")
    arrays = [as_array(value, shape, name) for value, (name, shape) in zip(answer, parts, strict=True)]
    return np.concatenate([array.ravel() for array in arrays])


def close(a: np.ndarray, b: np.ndarray, case: Any = None) -> bool:
    """Equal to rounding, in proportion to the largest entry."""
    return bool(np.abs(a - b).max(initial=0.0) <= 1e-7 * max(np.abs(b).max(initial=0.0), 1e-9))
