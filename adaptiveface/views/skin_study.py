"""For notebook 05: dense skin on one frame. What the colours change, what each sample knows, and the aperture problem."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from matplotlib.collections import EllipseCollection, LineCollection
from matplotlib.figure import Figure
from scipy.spatial import cKDTree

from ..errors import AdaptiveFaceError
from ..geometry.frame import RgbdFrame
from ..geometry.mesh import surface_points, vertex_normals
from ..model.actor import Actor
from ..model.skin import Skin
from ..neutral.skin import gather_skin
from ..parameters import Parameters
from ..tracking.skin_term import SkinTerm
from ..tracking.tracker import FaceTracker
from ..tracking.types import TrackedFrame
from .figures import inked, picture
from .measures import Measures
from .session import Session

#: Frames tracked before the one that is shown: the term starts from the last frame's displacement.
_BEFORE = 8
#: Samples within so many pixels are shown together.
PATCH = 4.0
#: An axis of an ellipse ends here, px: along an edge nothing is known.
_LONGEST = 5.0


@dataclass(frozen=True)
class SkinFrame:
    """One frame tracked without and with the colour term; ``samples`` (Q, 3) mm in the camera frame, ``term``: their rows."""

    frame: RgbdFrame
    without: TrackedFrame
    coloured: TrackedFrame
    samples: np.ndarray
    term: SkinTerm

    def pixels(self) -> np.ndarray:
        """(Q, 2) px: where the samples lie in the picture."""
        return self.frame.camera.project(self.samples)

    def information(self) -> np.ndarray:
        """(Q, 2, 2) 1/px^2: what each sample knows of its shift in the picture."""
        across = self.coloured.head_pose[:2, :3]  # head frame to u and v
        scale = self.frame.camera.fx / self.samples[:, 2]
        return across @ self.term.matrices @ across.T / scale[:, None, None] ** 2


def actor_with_skin(session: Session) -> Actor:
    """The session's actor; where its skin is not known (a performer's exact features need no colour), with it."""
    actor = session.actor
    if actor.skin is not None:
        return actor
    tracker, views = FaceTracker(actor, Parameters()), []
    for frame in session.neutral:
        tracked = tracker.track(frame)
        views += [(frame, tracked.head_pose)] if tracked.tracked and frame.colour is not None else []
    return replace(actor, skin=gather_skin(actor, views, Parameters().skin)) if views else actor


def track_skin(session: Session, index: int) -> SkinFrame:
    """The first frame from ``index`` on in which the neutral's colours are found, without and with the colour term.

    Raises :class:`AdaptiveFaceError` where there is none.
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


def _rows(tracker: FaceTracker, frame: RgbdFrame, tracked: TrackedFrame) -> SkinTerm | None:
    """The colours' rows for a frame, with the ``tracker`` as it was before it."""
    local = tracker.region.vertices
    measured = np.ones(len(local), bool)
    assert tracker.skin is not None
    looks = tracker.skin.look(frame, tracked.head_pose, tracked.v1[local], tracker.state.deformation, measured)
    return None if looks is None else looks.first


@inked()
def on_and_off(session: Session, measures: Measures, shown: SkinFrame):
    """Arrows on the picture: how the colour term moved v2 within the surface, ten times as long; and the errors of both."""
    actor, camera = session.actor, shown.frame.camera
    front = np.flatnonzero(actor.frontal & actor.depth_valid)[::7]
    start, end = (tracked.in_camera(tracked.v2)[front] for tracked in (shown.without, shown.coloured))
    normals = vertex_normals(shown.coloured.in_camera(shown.coloured.v2), actor.triangles)[front]
    motion = end - start
    motion -= (motion * normals).sum(axis=1, keepdims=True) * normals
    start = camera.project(end)
    motion = 10.0 * (camera.project(end + motion) - start)
    figure = Figure(figsize=(8.4, 4.2), layout="constrained")
    left, right = figure.subplots(1, 2)
    _face(left, shown, "moved by the colours, 10 times as long")
    left.quiver(*start.T, *motion.T, color="#ffd400", angles="xy", scale_units="xy", scale=1, width=0.004)
    for name, tracked, colour in (("without colours", shown.without, "#1f77b4"), ("with colours", shown.coloured, "#ff7f0e")):
        error = np.sort(measures.error(tracked, shown.frame, "v2")[actor.frontal & actor.depth_valid])
        right.plot(error, np.linspace(0, 100, len(error)), label=f"{name}: mean {np.nanmean(error):.2f} mm", color=colour)
    right.set(xlabel="error of v2, mm", ylabel="% of the frontal vertices below", xlim=(0, 3), ylim=(0, 100))
    right.legend(loc="lower right")
    return picture(
        figure, "Arrows on the face show how colours move the mesh; a chart compares the errors without and with them."
    )


@inked()
def ellipses(shown: SkinFrame, apart: int = 12):
    """What the colours know: alone, every sample knows the direction across its edge; with its neighbours, mostly both."""
    figure = Figure(figsize=(8.4, 4.6), layout="constrained")
    whole, close = figure.subplots(1, 2)
    pixels, information = shown.pixels(), shown.information()
    patches = around(pixels, information)
    _face(whole, shown, f"samples within {PATCH:g} px together")
    _draw(whole, pixels[::apart], patches[::apart])
    _face(close, shown, "the mouth: alone (lines) and together")
    u, v = np.nanmean(shown.frame.seen.pixels[20:], axis=0)
    near = np.flatnonzero((np.abs(pixels - [u, v]) < [38, 34]).all(axis=1))
    _draw(close, pixels[near[::3]], patches[near[::3]])
    values, vectors = np.linalg.eigh(information[near])
    known = values[:, 1] > np.percentile(values[:, 1], 50)
    along = 1.5 * vectors[known][:, :, 0]  # what it cannot tell
    ends = np.stack([pixels[near[known]] - along, pixels[near[known]] + along], axis=1)
    close.add_collection(LineCollection(ends, colors="#ff5ad0", linewidths=0.9))
    close.set(xlim=(u - 38, u + 38), ylim=(v + 34, v - 34))
    return picture(figure, "Ellipses on the face: small on brows and lips, long along edges, large on plain skin.")


def around(pixels: np.ndarray, information: np.ndarray) -> np.ndarray:
    """(Q, 2, 2) the information of all samples within ``PATCH`` of each one."""
    neighbours = cKDTree(pixels).query_ball_point(pixels, PATCH)
    return np.array([information[some].sum(axis=0) for some in neighbours])


def aperture(shown: SkinFrame) -> str:
    """In words: how many samples, and how many patches of samples, know one direction only."""

    def single(information: np.ndarray) -> float:
        low, high = np.linalg.eigvalsh(information).T
        return float(np.mean(low[high > np.median(high)] < 0.1 * high[high > np.median(high)]))

    pixels, information = shown.pixels(), shown.information()
    return (
        f"Of the samples that know the most, {single(information):.0%} know one direction ten times better than the other; "
        f"of the patches\nof {PATCH:g} px, {single(around(pixels, information)):.0%}."
    )


def _face(axes, shown: SkinFrame, title: str) -> None:
    pixels = shown.pixels()
    (left, top), (right, bottom) = pixels.min(axis=0) - 8, pixels.max(axis=0) + 8
    axes.imshow(shown.frame.colour)
    axes.set(xlim=(left, right), ylim=(bottom, top), title=title)
    axes.set_axis_off()


def _draw(axes, pixels: np.ndarray, information: np.ndarray) -> None:
    """An ellipse for each sample: axes along the eigenvectors, as long as the deviation that the colours leave."""
    values, vectors = np.linalg.eigh(information)
    lengths = np.minimum(1.0 / np.sqrt(np.maximum(values, 1e-9)), _LONGEST)
    angles = np.degrees(np.arctan2(vectors[:, 1, 0], vectors[:, 0, 0]))
    known = lengths[:, 1] < _LONGEST
    colours = np.where(lengths[known, 0] < _LONGEST, "#00e5ff", "#ff5ad0")
    axes.add_collection(
        EllipseCollection(
            lengths[known, 0],
            lengths[known, 1],
            angles[known],
            units="xy",
            offsets=pixels[known],
            offset_transform=axes.transData,
            facecolors="none",
            edgecolors=list(colours),
            linewidths=0.7,
        )
    )
