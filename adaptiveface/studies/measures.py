"""Measure errors per vertex and per frame, mm, for the heat maps and charts of the notebooks."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..evaluation import motion_error, neutral_alignment
from ..geometry.frame import RgbdFrame
from ..geometry.mesh import transform_points, vertex_normals
from ..parameters import Parameters
from ..tracking.feature_rows import reprojection_errors
from ..tracking.types import TrackedFrame
from .session import Session

#: Gives the vertices (N, 3) of one tracked frame in the head frame, mm, and their heat (N,) or None.
Pane = Callable[[TrackedFrame, RgbdFrame], tuple[np.ndarray, np.ndarray | None]]


@dataclass(frozen=True)
class TunedPane:
    """A pane whose content also depends on the explorer's parameters: ``draw`` is a :data:`Pane` with a third argument."""

    draw: Callable[[TrackedFrame, RgbdFrame, Parameters], tuple[np.ndarray, np.ndarray | None]]


#: Height of the chart of errors, mm or px, if they contain the sensor's noise.
WITHOUT_TRUTH = 5.0


def depth_distance(frame: RgbdFrame, points: np.ndarray) -> np.ndarray:
    """Distances (n,) of camera-frame points (n, 3) from the depth on their viewing rays, mm; NaN without depth."""
    pixels = np.round(frame.camera.project(points)).astype(int)
    height, width = frame.depth.shape
    inside = (pixels >= 0).all(axis=1) & (pixels[:, 0] < width) & (pixels[:, 1] < height)
    measured = np.where(inside, frame.depth[np.where(inside, pixels[:, 1], 0), np.where(inside, pixels[:, 0], 0)], 0.0)
    gap = np.abs(measured - points[:, 2])
    return np.where((measured > 0) & (gap < 30.0), gap, np.nan)


class Measures:
    """Errors of a session's tracked frames, against the truth if it is known, and otherwise against the depth map.

    A video has no depth, so that nothing is known about single vertices. :meth:`mean_error` is then the error of the 2D
    features in pixels.

    Attributes
    ----------
    label : str
        Meaning of the colours; "" if they show nothing.
    curve, unit : str
        Meaning and unit of :meth:`mean_error`.
    """

    def __init__(self, session: Session) -> None:
        self.session, actor = session, session.actor
        truth = session.truth
        self._truth = truth if truth is not None and truth.neutral.shape == actor.neutral.shape else None
        self.label, self.unit = "distance to the depth map, mm", "mm"
        if self.has_truth:
            self.label = "motion error against the truth, mm"
        self.curve = self.label
        if session.colour_only:
            self.label, self.curve, self.unit = "", "distance from the 2D features, px", "px"
        if self._truth is not None:
            self._alignment = neutral_alignment(actor.neutral, self._truth.neutral, actor.frontal)

    @property
    def has_truth(self) -> bool:
        """Whether the truth is known on the actor's mesh."""
        return self._truth is not None

    def top(self, known: float) -> float:
        """Upper end of a chart of mean errors. ``known`` mm suffice against the truth; without it, the chart is higher."""
        return known if self.has_truth else max(known, WITHOUT_TRUTH)

    def error(self, result: TrackedFrame, frame: RgbdFrame, stage: str = "v4") -> np.ndarray:
        """Errors (N,) of a stage's mesh, mm; NaN outside the frontal region, if unknown, and if the head is lost."""
        actor = self.session.actor
        if not result.tracked:
            return np.full(len(actor.neutral), np.nan)
        vertices = result.in_camera(getattr(result, stage))
        if self._truth is not None:
            truth = self._truth[frame.index]
            vectors = motion_error(
                vertices, actor.neutral, truth.vertices, self._truth.neutral, truth.head_pose, self._alignment
            )
            lengths = np.linalg.norm(vectors, axis=1)
        else:
            towards = -np.einsum("nd,nd->n", vertex_normals(vertices, actor.triangles), vertices)
            seen = towards > 0.2 * np.linalg.norm(vertices, axis=1)  # the near side hides the far one
            lengths = np.where(seen, depth_distance(frame, vertices), np.nan)
        return np.where(actor.frontal & actor.depth_valid, lengths, np.nan)

    def mean_error(self, result: TrackedFrame | None, frame: RgbdFrame, stage: str = "v4") -> float:
        """Mean of :meth:`error`, mm, or for a video of the 2D features' errors, px. NaN for a frame that is not tracked."""
        if result is None or not result.tracked:
            return float("nan")
        if self.session.colour_only:
            points = model_features(self.session, getattr(result, stage), result.head_pose)
            return float(reprojection_errors(frame.seen, frame.camera, points).mean())
        known = self.error(result, frame, stage)
        known = known[np.isfinite(known)]
        return float(known.mean()) if len(known) else float("nan")

    def mean_map(self, results, frames, stage: str = "v4") -> np.ndarray:
        """Means (N,) of :meth:`error` over the tracked frames, mm; NaN for vertices whose error is never known."""
        errors = np.full((1, len(self.session.actor.neutral)), np.nan)
        tracked = [self.error(r, f, stage) for r, f in zip(results, frames, strict=True) if r is not None and r.tracked]
        errors = np.vstack([errors, *tracked])
        known = np.isfinite(errors).sum(axis=0)
        return np.where(known > 0, np.nansum(errors, axis=0) / np.maximum(known, 1), np.nan)

    def stage(self, name: str) -> Pane:
        """Make a pane of the mesh of a stage, "v1" to "v4", coloured by its error if it is known."""
        if self.session.colour_only:
            return plain(name)
        return lambda result, frame: (getattr(result, name), self.error(result, frame, name))

    def difference(self, name: str, other: str) -> Pane:
        """Make a pane of the mesh of stage ``name``, coloured by its distance from stage ``other`` (figures 4 and 7)."""
        frontal = self.session.actor.frontal

        def pane(result: TrackedFrame, frame: RgbdFrame):
            lengths = np.linalg.norm(getattr(result, name) - getattr(result, other), axis=1)
            return getattr(result, name), np.where(frontal, lengths, np.nan)

        return pane


def plain(name: str) -> Pane:
    """Make a pane of the mesh of a stage in the colour of skin."""
    return lambda result, frame: (getattr(result, name), None)


def model_features(session: Session, vertices: np.ndarray, pose: np.ndarray) -> np.ndarray:
    """Places (40, 3) of the 2D features in the camera frame, on a mesh (N, 3) in the head frame, mm."""
    actor = session.actor
    return transform_points(pose, np.einsum("fk,fkd->fd", actor.feature_weights, vertices[actor.feature_triangles]))
