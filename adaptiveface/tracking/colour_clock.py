"""Tell from a moving face whether the pictures show the same moment as their depth.

Two things are true of late pictures. First, the skin in them lies behind the head: a picture that is tau frames late shows it
displaced by -tau times the head's motion v, while the depth shows where the head is. The colours' rows
(:class:`.surface_term.SurfaceTerm`) give the displacement s of the whole face. The warm start and the features, which come from
the same picture, already contain a part of it. Second, late pictures fit the face where it was one frame ago about as well as
where it is now: the colours (:meth:`.dense_skin.DenseSkin.look`) give the difference g of the two misfits. Over the last
frames, in the plane of the picture,

    lag = -sum s . v / (sum v . v + 2 mm^2),      agreement = (sum g + 1) / (sum |g| + 1)

are 0 and 1 for pictures in time. Pictures are late if neither is: a mouth that opens while the head nods looks like a lag, but
it fits the face of this frame much better than that of the frame before. docs/paper-notes.md has the figures. A stream that
has stopped repeats its picture bit by bit, which the noise of a camera never does.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..geometry.frame import RgbdFrame
from .surface_term import SurfaceTerm

#: Factor by which the weight of a frame decreases per frame, and the priors of lag, mm^2, and of agreement.
FADES, PRIOR, BELIEF = 0.93, 2.0, 1.0
#: Pictures are late with at least this lag and less than this agreement.
LATE, AGREES = 0.13, 0.95
#: Stride of the rows and columns that are compared to tell a repeated picture from a new one.
_SPARSE = 16


@dataclass(frozen=True)
class ColourClock:
    """Knowledge from the frames so far: the sums of the module's equations, and the last picture and depth, thinned."""

    shifted: float = 0.0
    moved: float = 0.0
    gained: float = 0.0
    changed: float = 0.0
    picture: np.ndarray | None = None
    depth: np.ndarray | None = None
    repeated: bool = False

    @property
    def late(self) -> bool:
        """Whether the newest picture is from an earlier moment than its depth."""
        return self.repeated or (self.lag > LATE and self.agreement < AGREES)

    @property
    def lag(self) -> float:
        """How far the skin lies behind the head, as a share of the head's motion from frame to frame."""
        return self.shifted / (self.moved + PRIOR)

    @property
    def agreement(self) -> float:
        """By how much pictures fit the face of their frame better than that of the frame before, from -1 to 1."""
        return (self.gained + BELIEF) / (self.changed + BELIEF)

    def after(self, frame: RgbdFrame) -> ColourClock:
        """Add a frame with colour, which may repeat the last picture although its depth is new."""
        assert frame.colour is not None
        picture, depth = (np.ascontiguousarray(image[::_SPARSE, ::_SPARSE]) for image in (frame.colour, frame.depth))
        same = self.picture is not None and np.array_equal(picture, self.picture)
        repeated = same and self.depth is not None and not np.array_equal(depth, self.depth)
        return replace(self, picture=picture, depth=depth, repeated=repeated)

    def seen(self, term: SurfaceTerm, rotation: np.ndarray, motion: np.ndarray, gain: float) -> ColourClock:
        """Add what that frame's picture shows.

        Parameters
        ----------
        term : SurfaceTerm
            Its rows.
        rotation : (3, 3)
            Head to camera.
        motion : (3,)
            Of the head since the last frame, mm.
        gain : float
            By how much it fits the face of the frame better than that of the frame before.
        """
        shift = rotation @ face_shift(term)
        return replace(
            self,
            shifted=FADES * self.shifted - float(shift[:2] @ motion[:2]),
            moved=FADES * self.moved + float(motion[:2] @ motion[:2]),
            gained=FADES * self.gained + gain,
            changed=FADES * self.changed + abs(gain),
        )


def face_shift(term: SurfaceTerm) -> np.ndarray:
    """Common displacement (3,) of all samples in the head frame, mm. A single sample only knows some directions."""
    matrix, pull = term.totals()
    matrix += 1e-3 * np.trace(matrix) * np.eye(3)
    shift: np.ndarray = np.linalg.solve(matrix, pull)
    return shift
