"""Pair depth and colour of the same moment, for cameras that deliver them separately."""

from __future__ import annotations

from collections import deque

#: How many images of a stream wait for their partners. One stream may be some frames behind the other.
MOST_WAITING = 4


class Pairing:
    """Images that wait for their partners. ``depth`` and ``colour`` take tuples whose last entry is the time, s.

    Images that are further apart than ``skew``, s, do not show the same moment.
    """

    def __init__(self, skew: float) -> None:
        self.skew = skew
        self.depth: deque[tuple] = deque(maxlen=MOST_WAITING)
        self.colour: deque[tuple] = deque(maxlen=MOST_WAITING)

    def take(self) -> tuple[tuple, tuple] | None:
        """Take out the oldest pair of depth and colour, or return None. Everything older than the pair is dropped."""
        for d, depth in enumerate(self.depth):
            for c, colour in enumerate(self.colour):
                if abs(depth[-1] - colour[-1]) <= self.skew:
                    for waiting, number in ((self.depth, d), (self.colour, c)):
                        for _ in range(number + 1):
                            waiting.popleft()
                    return depth, colour
        return None
