"""Whether the pictures are of the same moment as their depth, by what a moving head shows.

A picture that comes tau frames late shows the skin displaced by -tau times the head's motion v, while the head itself is
where the depth sees it. The colours' rows (:class:`.skin_term.SkinTerm`) say by how much s the whole face seems displaced;
the warm start and the features, which come from the same picture, take a part of it. So

    lag = -sum s . v / (sum v . v + prior)

over the last frames, in the plane of the picture, is 0 for pictures in time whatever the face does. Measured on performers
2005 to 2011 in four looks: -0.17 to 0.10 with pictures in time; with pictures three frames late 0.15 to 0.38 once the head
had moved. A stream that has stopped repeats its picture to the bit, which no camera's noise does.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..geometry.frame import RgbdFrame
from .skin_term import SkinTerm

#: What is left of a frame's say in the next one, and the prior of no lag, mm^2.
FADES, PRIOR = 0.93, 2.0
#: From this lag on the pictures are late.
LATE = 0.13
#: Every so many rows and columns are compared to tell a repeated picture from a new one.
_SPARSE = 8


@dataclass(frozen=True)
class ColourClock:
    """What the frames so far tell: the sums of the module's equation, mm^2; the last picture and depth, thinned."""

    shifted: float = 0.0
    moved: float = 0.0
    picture: np.ndarray | None = None
    depth: np.ndarray | None = None
    repeated: bool = False

    @property
    def late(self) -> bool:
        """Whether the newest picture is of an earlier moment than its depth."""
        return self.repeated or self.shifted > LATE * (self.moved + PRIOR)

    def after(self, frame: RgbdFrame) -> ColourClock:
        """With a frame that has colour: does it repeat the last picture, though the depth is another?"""
        assert frame.colour is not None
        picture, depth = (np.ascontiguousarray(image[::_SPARSE, ::_SPARSE]) for image in (frame.colour, frame.depth))
        same = self.picture is not None and np.array_equal(picture, self.picture)
        repeated = same and self.depth is not None and not np.array_equal(depth, self.depth)
        return replace(self, picture=picture, depth=depth, repeated=repeated)

    def seen(self, term: SkinTerm, rotation: np.ndarray, motion: np.ndarray) -> ColourClock:
        """With the rows of that frame: rotation (3, 3) head to camera, motion (3,) of the head since the last frame, mm."""
        shift = rotation @ face_shift(term)
        shifted = FADES * self.shifted - float(shift[:2] @ motion[:2])
        return replace(self, shifted=shifted, moved=FADES * self.moved + float(motion[:2] @ motion[:2]))


def face_shift(term: SkinTerm) -> np.ndarray:
    """(3,) mm, head frame: by how much all the samples together seem displaced, where each only knows some directions."""
    matrix = term.matrices.sum(axis=0)
    matrix += 1e-3 * np.trace(matrix) * np.eye(3)
    shift: np.ndarray = np.linalg.solve(matrix, term.pulls.sum(axis=0))
    return shift
