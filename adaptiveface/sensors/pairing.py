"""Pair depth and colour of the same moment, for cameras that deliver them separately."""

from __future__ import annotations

from collections import deque

#: How many images of a stream wait for their partners. One stream may be some frames behind the other.
MOST_WAITING = 4


class Pairing:
    """Images that wait for their partners.

    Parameters
    ----------
    skew : float
        Longest time between two images of the same moment, s.

    Attributes
    ----------
    depth, colour : deque of tuple
        The waiting images. The last entry of each tuple is the time of the image, s.
    """

    def __init__(self, skew: float) -> None:
        self.skew = skew
        self.depth: deque[tuple] = deque(maxlen=MOST_WAITING)
        self.colour: deque[tuple] = deque(maxlen=MOST_WAITING)

    def take(self) -> tuple[tuple, tuple] | None:
        """Remove the oldest pair, and drop everything that is older.

        Returns
        -------
        tuple of tuple or None
            The entries of depth and colour, or None if there is no pair.
        """
        for d, depth in enumerate(self.depth):
            for c, colour in enumerate(self.colour):
                if abs(depth[-1] - colour[-1]) <= self.skew:
                    for waiting, number in ((self.depth, d), (self.colour, c)):
                        for _ in range(number + 1):
                            waiting.popleft()
                    return depth, colour
        return None
