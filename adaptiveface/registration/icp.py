"""Iterative closest points (Besl & McKay 1992) as a generator of its iterates: one loop for every rigid alignment."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np

Matches = TypeVar("Matches")


@dataclass(frozen=True)
class Iterate(Generic[Matches]):
    """One iterate of :func:`icp`.

    pose (4, 4) head to camera; matches: the correspondences at that pose; starved: whether they were too few for a step.
    """

    pose: np.ndarray
    matches: Matches
    starved: bool = False


def icp(
    pose: np.ndarray,
    associate: Callable[[np.ndarray], Matches],
    step: Callable[[np.ndarray, Matches], tuple[np.ndarray, float]],
    count: Callable[[Matches], int],
    min_matches: int,
    iterations: int,
    converged: float = 0.0,
) -> Iterator[Iterate[Matches]]:
    """Alternate between association and step; yield the start and the pose after every step.

    Parameters
    ----------
    pose : (4, 4) start, head to camera, mm.
    associate : finds the matches at a pose (4, 4).
    step : makes the next pose (4, 4) from a pose and its matches, and says how far that moves the face, mm.
    count : number of matches.
    min_matches : with fewer matches no step is made; the last iterate is ``starved``.
    iterations : largest number of steps.
    converged : stop after a step that moves the face by less, mm.
    """
    for _ in range(iterations):
        matches = associate(pose)
        starved = count(matches) < min_matches
        yield Iterate(pose, matches, starved)
        if starved:
            return
        pose, motion = step(pose, matches)
        if motion < converged:
            break
    yield Iterate(pose, associate(pose))


def last(iterates: Iterator[Iterate[Matches]]) -> Iterate[Matches]:
    """The iterate at which ICP stops."""
    return deque(iterates, maxlen=1).pop()
