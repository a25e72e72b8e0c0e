"""Pair depth and colour of the same moment, for cameras that deliver them separately."""

from __future__ import annotations

from collections import deque

#: Images of a stream kept until their partner comes: one stream may be delivered some frames after the other.
MOST_WAITING = 4


class Pairing:
    """Images that wait for their partner: put into ``depth`` and ``colour`` as tuples that end with their time, s.

    ``skew``: images further apart than this, s, are not of the same moment.
    """

    def __init__(self, skew: float) -> None:
        self.skew = skew
        self.depth: deque[tuple] = deque(maxlen=MOST_WAITING)
        self.colour: deque[tuple] = deque(maxlen=MOST_WAITING)

    def take(self) -> tuple[tuple, tuple] | None:
        """The oldest pair of depth and colour, or None. The pair and everything older are forgotten."""
        for d, depth in enumerate(self.depth):
            for c, colour in enumerate(self.colour):
                if abs(depth[-1] - colour[-1]) <= self.skew:
                    for waiting, number in ((self.depth, d), (self.colour, c)):
                        for _ in range(number + 1):
                            waiting.popleft()
                    return depth, colour
        return None
