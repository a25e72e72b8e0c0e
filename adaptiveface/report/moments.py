"""Choose the moments of a performance that are worth showing."""

from __future__ import annotations

import numpy as np

from ..result import Result


def expressive_frames(result: Result, count: int, spacing: int = 5) -> list[int]:
    """Choose expressive tracked frames that differ from each other, by farthest-point sampling of the coefficients.

    Parameters
    ----------
    result : Result
        The run.
    count : int
        Largest number of frames.
    spacing : int
        Smallest number of frames between two of them.

    Returns
    -------
    list of int
        Frame numbers in order of time.
    """
    candidates = np.flatnonzero(result.tracked)
    if not len(candidates):
        return []
    x = result.coefficients[candidates]
    chosen: list[int] = []
    distance = np.linalg.norm(x, axis=1)
    while len(chosen) < min(count, len(candidates)) and np.isfinite(distance).any():
        best = int(distance.argmax())
        chosen.append(best)
        distance = np.minimum(distance, np.linalg.norm(x - x[best], axis=1))
        distance[np.abs(candidates - candidates[best]) < spacing] = -np.inf
    return sorted(int(candidates[i]) for i in chosen)


def liveliest_window(result: Result, length: int) -> range:
    """Choose the ``length`` consecutive frames whose coefficients change most. There are fewer frames in a shorter run."""
    length = min(length, len(result))
    change = np.abs(np.diff(result.coefficients, axis=0)).sum(axis=1)
    change[~(result.tracked[1:] & result.tracked[:-1])] = 0
    total = np.concatenate([[0.0], np.cumsum(change)])
    score = total[length - 1 :] - total[: len(total) - length + 1]
    start = int(score.argmax())
    return range(start, start + length)
