"""Run iterative closest points (Besl & McKay 1992), as a generator of iterates, for every rigid alignment."""

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

    Attributes
    ----------
    pose : (4, 4)
        Head frame to camera frame, mm.
    matches : Correspondences
        Found at that pose.
    starved : bool
        Whether they are too few for a step.
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
    pose : (4, 4)
        The start, head frame to camera frame, mm.
    associate : callable
        ``associate(pose)`` finds the matches at a pose.
    step : callable
        ``step(pose, matches)`` makes the next pose and says how far it moves the face, mm.
    count : callable
        ``count(matches)`` is their number.
    min_matches : int
        With fewer matches no step is made, and the last iterate is ``starved``.
    iterations : int
        Largest number of steps.
    converged : float
        ICP stops after a step that moves the face by less, mm.

    Yields
    ------
    Iterate
        The start, and the pose after every step.
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
    """Return the iterate at which ICP stops."""
    return deque(iterates, maxlen=1).pop()
