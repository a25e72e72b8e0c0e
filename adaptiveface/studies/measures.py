"""What the heat maps and charts of the notebooks show, per vertex and per frame. Millimetres."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..evaluation import motion_error, neutral_alignment
from ..geometry.frame import RgbdFrame
from ..geometry.mesh import transform_points, vertex_normals
from ..tracking.feature_rows import reprojection_errors
from ..tracking.types import TrackedFrame
from .session import Session

#: (vertices (N, 3) in the head frame, heat (N,) or None) of one tracked frame.
Pane = Callable[[TrackedFrame, RgbdFrame], tuple[np.ndarray, np.ndarray | None]]

#: Height of the chart of errors, mm or px, where they hold the sensor's noise.
WITHOUT_TRUTH = 5.0


def depth_distance(frame: RgbdFrame, points: np.ndarray) -> np.ndarray:
    """(n,) distance, mm, of camera-frame points (n, 3) from the depth on their viewing ray; NaN where none."""
    pixels = np.round(frame.camera.project(points)).astype(int)
    height, width = frame.depth.shape
    inside = (pixels >= 0).all(axis=1) & (pixels[:, 0] < width) & (pixels[:, 1] < height)
    measured = np.where(inside, frame.depth[np.where(inside, pixels[:, 1], 0), np.where(inside, pixels[:, 0], 0)], 0.0)
    gap = np.abs(measured - points[:, 2])
    return np.where((measured > 0) & (gap < 30.0), gap, np.nan)


class Measures:
    """Errors of tracked frames of one session: against the truth where it is known, else against the depth map.

    Of a video, without depth, nothing is known of a vertex; :meth:`mean_error` is then that of the 2D features in pixels.
    ``label`` says what colours show ("" where they show nothing), ``curve`` what :meth:`mean_error` is, in ``unit``.
    """

    def __init__(self, session: Session) -> None:
        self.session, actor = session, session.actor
        truth = session.truth
        self.has_truth = truth is not None and truth.neutral.shape == actor.neutral.shape
        self.label, self.unit = "distance to the depth map, mm", "mm"
        if self.has_truth:
            self.label = "motion error against the truth, mm"
        self.curve = self.label
        if session.colour_only:
            self.label, self.curve, self.unit = "", "distance from the 2D features, px", "px"
        if self.has_truth:
            self._alignment = neutral_alignment(actor.neutral, truth.neutral, actor.frontal)

    def top(self, known: float) -> float:
        """Upper end of a chart of mean errors that needs ``known`` mm against the truth: without it, more."""
        return known if self.has_truth else max(known, WITHOUT_TRUTH)

    def error(self, result: TrackedFrame, frame: RgbdFrame, stage: str = "v4") -> np.ndarray:
        """(N,) error of a stage's mesh, mm; NaN outside the frontal region, where unknown, and where the head is lost."""
        actor = self.session.actor
        if not result.tracked:
            return np.full(len(actor.neutral), np.nan)
        vertices = result.in_camera(getattr(result, stage))
        if self.has_truth:
            truth = self.session.truth[frame.index]
            vectors = motion_error(
                vertices, actor.neutral, truth.vertices, self.session.truth.neutral, truth.head_pose, self._alignment
            )
            lengths = np.linalg.norm(vectors, axis=1)
        else:
            towards = -np.einsum("nd,nd->n", vertex_normals(vertices, actor.triangles), vertices)
            seen = towards > 0.2 * np.linalg.norm(vertices, axis=1)  # the far side is hidden by the near one
            lengths = np.where(seen, depth_distance(frame, vertices), np.nan)
        return np.where(actor.frontal & actor.depth_valid, lengths, np.nan)

    def mean_error(self, result: TrackedFrame | None, frame: RgbdFrame, stage: str = "v4") -> float:
        """Mean of :meth:`error`, mm; of a video that of the 2D features, px. NaN for a frame that is not tracked."""
        if result is None or not result.tracked:
            return float("nan")
        if self.session.colour_only:
            points = model_features(self.session, getattr(result, stage), result.head_pose)
            return float(reprojection_errors(frame.seen, frame.camera, points).mean())
        known = self.error(result, frame, stage)
        known = known[np.isfinite(known)]
        return float(known.mean()) if len(known) else float("nan")

    def mean_map(self, results, frames, stage: str = "v4") -> np.ndarray:
        """(N,) mean of :meth:`error` over the tracked frames, mm; NaN where it is never known."""
        errors = np.full((1, len(self.session.actor.neutral)), np.nan)
        tracked = [self.error(r, f, stage) for r, f in zip(results, frames, strict=True) if r is not None and r.tracked]
        errors = np.vstack([errors, *tracked])
        known = np.isfinite(errors).sum(axis=0)
        return np.where(known > 0, np.nansum(errors, axis=0) / np.maximum(known, 1), np.nan)

    def stage(self, name: str) -> Pane:
        """A pane: the mesh of stage "v1" .. "v4", coloured by its error where there is one."""
        if self.session.colour_only:
            return plain(name)
        return lambda result, frame: (getattr(result, name), self.error(result, frame, name))

    def difference(self, name: str, other: str) -> Pane:
        """A pane: the mesh of stage ``name``, coloured by its distance from stage ``other`` (figures 4 and 7)."""
        frontal = self.session.actor.frontal

        def pane(result: TrackedFrame, frame: RgbdFrame):
            lengths = np.linalg.norm(getattr(result, name) - getattr(result, other), axis=1)
            return getattr(result, name), np.where(frontal, lengths, np.nan)

        return pane


def plain(name: str) -> Pane:
    """A pane: the mesh of a stage in the colour of skin."""
    return lambda result, frame: (getattr(result, name), None)


def model_features(session: Session, vertices: np.ndarray, pose: np.ndarray) -> np.ndarray:
    """(40, 3) camera frame: where the 2D features sit on a mesh (N, 3) in the head frame."""
    actor = session.actor
    return transform_points(pose, np.einsum("fk,fkd->fd", actor.feature_weights, vertices[actor.feature_triangles]))
