"""Track one frame without and with the colour term, and say what each sample of the skin knows."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from ..errors import AdaptiveFaceError
from ..geometry.frame import RgbdFrame
from ..geometry.mesh import surface_points
from ..model.actor import Actor
from ..model.skin import Skin
from ..neutral.skin import gather_skin
from ..parameters import Parameters
from ..tracking.surface_term import SurfaceTerm
from ..tracking.tracker import FaceTracker
from ..tracking.types import TrackedFrame
from .session import Session

#: Number of frames tracked before the one that is shown, because the term starts from the last frame's displacement.
_BEFORE = 8


#: Samples within this distance, px, form a patch.
PATCH = 4.0


@dataclass(frozen=True)
class SkinFrame:
    """One frame, tracked without and with the colour term.

    Attributes
    ----------
    frame : RgbdFrame
        The frame.
    without, coloured : TrackedFrame
        Its results without and with the colours.
    samples : (Q, 3)
        Places of the skin's samples in the camera frame, mm.
    term : SurfaceTerm
        The rows of the samples.
    """

    frame: RgbdFrame
    without: TrackedFrame
    coloured: TrackedFrame
    samples: np.ndarray
    term: SurfaceTerm

    def pixels(self) -> np.ndarray:
        """(Q, 2) places of the samples in the picture, px."""
        return self.frame.camera.project(self.samples)

    def information(self) -> np.ndarray:
        """(Q, 2, 2) information of each sample about its shift in the picture, 1/px^2."""
        across = self.coloured.head_pose[:2, :3]  # from the head frame to u and v
        scale = self.frame.camera.fx / self.samples[:, 2]
        return across @ self.term.matrices @ across.T / scale[:, None, None] ** 2


def actor_with_skin(session: Session) -> Actor:
    """The session's actor with its skin. If the capture did not gather it, the neutral frames are tracked to gather it now."""
    actor = session.actor
    if actor.skin is not None:
        return actor
    tracker, views = FaceTracker(actor, Parameters()), []
    for frame in session.neutral:
        tracked = tracker.track(frame)
        views += [(frame, tracked.head_pose)] if tracked.tracked and frame.colour is not None else []
    return replace(actor, skin=gather_skin(actor, views, Parameters().skin)) if views else actor


def track_skin(session: Session, index: int) -> SkinFrame:
    """Track up to the first frame in which the neutral's colours are found, without and with the colour term.

    Parameters
    ----------
    session : Session
        With colour.
    index : int
        Number of the first frame that may be shown.

    Returns
    -------
    SkinFrame
        The frame and its two results.

    Raises
    ------
    AdaptiveFaceError
        The scan had no colour, or no such frame exists.
    """
    actor = actor_with_skin(session)
    if actor.skin is None:
        raise AdaptiveFaceError("the scan of this performance had no colour: dense skin needs it")
    ways = [FaceTracker(actor, Parameters().replace(skin__on=on)) for on in (False, True)]
    first = max(index - _BEFORE, 0)
    for number, frame in enumerate(session.frames[first:], first):
        last = ways[1].copy()
        without, coloured = (way.track(frame) for way in ways)
        if number >= index and without.tracked and coloured.tracked:
            term = _rows(last, frame, coloured)
            if term is not None:
                skin: Skin = actor.skin.first(Parameters().skin.samples)
                samples = surface_points(coloured.in_camera(coloured.v2), skin.triangles, skin.weights)
                return SkinFrame(frame, without, coloured, samples, term)
    raise AdaptiveFaceError(f"from frame {index} on, the neutral's colours are not found in any picture")


def _rows(tracker: FaceTracker, frame: RgbdFrame, tracked: TrackedFrame) -> SurfaceTerm | None:
    """The rows of the colours for a frame, from the ``tracker`` as it was before that frame."""
    local = tracker.region.vertices
    measured = np.ones(len(local), bool)
    assert tracker.skin is not None
    looks = tracker.skin.look(frame, tracked.head_pose, tracked.v1[local], tracker.state.deformation, measured)
    return None if looks is None else looks.first


def around(pixels: np.ndarray, information: np.ndarray) -> np.ndarray:
    """(Q, 2, 2) summed information of all samples within ``PATCH`` of each one, 1/px^2, from pixels (Q, 2)."""
    neighbours = cKDTree(pixels).query_ball_point(pixels, PATCH)
    return np.array([information[some].sum(axis=0) for some in neighbours])


def aperture(shown: SkinFrame) -> str:
    """Say how many samples, and how many patches of samples, know only one direction."""

    def single(information: np.ndarray) -> float:
        """The share of the more telling half that knows a single direction, from information (Q, 2, 2), 1/px^2."""
        low, high = np.linalg.eigvalsh(information).T
        return float(np.mean(low[high > np.median(high)] < 0.1 * high[high > np.median(high)]))

    pixels, information = shown.pixels(), shown.information()
    return (
        f"Of the samples that know the most, {single(information):.0%} know one direction ten times better than the other; "
        f"of the patches\nof {PATCH:g} px, {single(around(pixels, information)):.0%}."
    )
