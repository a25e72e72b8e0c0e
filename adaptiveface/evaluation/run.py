"""Score a tracked performance against its truth by stage, by region, and by first time or repeat.

Shapes: S stages, F scored frames, n vertices that may take depth, m frontal vertices. Lengths are in mm.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np

from ..errors import AdaptiveFaceError
from ..geometry.mesh import vertex_normals
from ..model.actor import Actor
from ..tracking.types import TrackedFrame
from . import metrics
from .regions import actor_regions
from .truth import FIRST, NEUTRAL, REPEAT, GroundTruth

STAGES = ("v1", "v2", "v3", "v4")


@dataclass(frozen=True)
class Evaluation:
    """Errors of every scored frame, stored per vertex, so that any statistic can be computed later. Lengths are float32 mm.

    Attributes
    ----------
    stages : (S,)
        Names of the stages.
    index, performance : (F,)
        Number and performance of the frames that were tracked.
    lost : dict
        Number of frames that were not tracked, by performance.
    scored, frontal : (N,) bool
        Vertices of the surface error (frontal and depth-valid) and of the motion error.
    surface : (S, F, n)
        Distances of the scored vertices from the true surface.
    normal, tangential : (S, F, m)
        Motion error without the neutral's (:func:`metrics.motion_error`): signed part along the true normals, and length of the
        rest.
    motion : (F, m)
        Length of the true motion.
    pose_shift, pose_angle : (F,)
        Error of the rigid pose, mm and degrees.
    anchor_distance, adaptive_distance : (F,)
        The curves of figure 11.
    regions : dict
        Vertices (N,) bool of each region by its name.
    """

    stages: tuple[str, ...]
    index: np.ndarray
    performance: np.ndarray
    lost: dict[int, int]
    surface: np.ndarray
    normal: np.ndarray
    tangential: np.ndarray
    motion: np.ndarray
    pose_shift: np.ndarray
    pose_angle: np.ndarray
    anchor_distance: np.ndarray
    adaptive_distance: np.ndarray
    scored: np.ndarray
    frontal: np.ndarray
    regions: dict[str, np.ndarray]

    def frames(self, performance: int | None) -> np.ndarray:
        """Which frames belong to a performance, (F,) bool; None means all after the neutral."""
        return self.performance != NEUTRAL if performance is None else self.performance == performance

    def motion_length(self, stage: str) -> np.ndarray:
        """Lengths (F, m) of the motion error, mm."""
        s = self.stages.index(stage)
        return np.hypot(self.normal[s], self.tangential[s])

    def surface_percentiles(self, stage: str, performance: int | None, percentiles=(50, 95)) -> list[float]:
        """Percentiles of the surface distance over all (frame, vertex) pairs of a performance, mm."""
        values = self.surface[self.stages.index(stage)][self.frames(performance)]
        if not values.size:
            return [float("nan")] * len(percentiles)
        return [float(value) for value in np.percentile(values, percentiles)]

    def active_share(self, stage: str, performance: int | None, region: str | None = None) -> float:
        """:func:`metrics.active_share` over the frontal vertices of a performance, or those of one ``region``."""
        chosen = self.frames(performance)
        inside = slice(None) if region is None else self.regions[region][self.frontal]
        return metrics.active_share(self.motion_length(stage)[chosen][:, inside], self.motion[chosen][:, inside])

    def region_error(self, stage: str, region: str, performance: int | None, active: bool = False) -> float:
        """Mean length of the motion error over a region's vertices and a performance's frames, mm.

        With ``active``, only pairs whose true motion exceeds 2 mm count. The limits are for the mean over all pairs.
        """
        chosen, inside = self.frames(performance), self.regions[region][self.frontal]
        error = self.motion_length(stage)[chosen][:, inside]
        if active:
            error = error[self.motion[chosen][:, inside] > metrics.ACTIVE_MOTION]
        return float(error.mean(dtype=float)) if error.size else float("nan")

    def parts(self, stage: str, performance: int | None) -> tuple[float, float]:
        """Mean |normal| and tangential part of the motion error over the active pairs, mm."""
        s, chosen = self.stages.index(stage), self.frames(performance)
        active = self.motion[chosen] > metrics.ACTIVE_MOTION
        if not active.any():
            return float("nan"), float("nan")
        normal, tangential = np.abs(self.normal[s][chosen][active]), self.tangential[s][chosen][active]
        return float(normal.mean(dtype=float)), float(tangential.mean(dtype=float))

    def summary(self, stage: str, performance: int | None) -> dict[str, float]:
        """Every figure of one stage and performance by its name, in mm except for shares."""
        median, p95 = self.surface_percentiles(stage, performance)
        normal, tangential = self.parts(stage, performance)
        out = dict(
            surface_median=median,
            surface_p95=p95,
            active_share=self.active_share(stage, performance),
            normal=normal,
            tangential=tangential,
        )
        for region in self.regions:
            out[region] = self.region_error(stage, region, performance)
            out[f"{region}_active"] = self.region_error(stage, region, performance, active=True)
            out[f"{region}_share"] = self.active_share(stage, performance, region)
        return out

    def mean_error_map(self, stage: str, performance: int | None) -> np.ndarray:
        """Mean lengths (N,) of the motion error of each vertex, mm; NaN outside the frontal region."""
        out = np.full(len(self.frontal), np.nan)
        chosen = self.frames(performance)
        if chosen.any():
            out[self.frontal] = self.motion_length(stage)[chosen].mean(axis=0)
        return out

    def table(self) -> str:
        """The summary of every stage and performance as text."""
        from .table import evaluation_table

        return evaluation_table(self)


@dataclass
class ErrorCollector:
    """Scores tracked frames one by one, so that a run can be scored while it is tracked, without keeping meshes.

    Parameters
    ----------
    truth : GroundTruth
        Or any argument of :meth:`GroundTruth.of`.
    actor : Actor
        The rig that is tracked.
    stages : sequence of str
        Of ``STAGES``.
    alignment : (4, 4), optional
        From the actor's head frame to the true one; by default :func:`metrics.neutral_alignment`.
    """

    truth: GroundTruth
    actor: Actor
    stages: tuple[str, ...] = STAGES
    alignment: np.ndarray | None = None
    _rows: list = field(default_factory=list, repr=False)
    _lost: dict = field(default_factory=lambda: {NEUTRAL: 0, FIRST: 0, REPEAT: 0}, repr=False)

    def __post_init__(self) -> None:
        self.truth = GroundTruth.of(self.truth)
        if len(self.truth.neutral) != len(self.actor.neutral):
            raise AdaptiveFaceError(
                f"the truth has {len(self.truth.neutral)} vertices, the actor {len(self.actor.neutral)}: errors per "
                "vertex need the same mesh; track with an actor captured with the model that made the truth"
            )
        self.frontal = self.actor.frontal.astype(bool)
        self.scored = self.frontal & self.actor.depth_valid.astype(bool)
        if self.alignment is None:
            self.alignment = metrics.neutral_alignment(self.actor.neutral, self.truth.neutral, self.frontal)
        self.centre = self.truth.neutral[self.frontal].mean(axis=0)

    def add(self, frame: TrackedFrame) -> None:
        """Score one frame. A frame that is not tracked is counted as lost."""
        if not frame.tracked:
            self.lose(frame.index)
            return
        meshes = {stage: frame.in_camera(getattr(frame, stage)) for stage in self.stages}
        self.score(frame.index, frame.head_pose, meshes, frame.anchor_distance, frame.adaptive_distance)

    def lose(self, index: int) -> None:
        """Count a frame that was not tracked."""
        performance = self.truth[index].performance
        self._lost[performance] = self._lost.get(performance, 0) + 1

    def score(
        self,
        index: int,
        rigid: np.ndarray,
        meshes: dict[str, np.ndarray],
        anchor: float = np.nan,
        adaptive: float = np.nan,
    ) -> None:
        """Score one frame at ``rigid`` (4, 4), head to camera, with the stages' meshes (N, 3) in the camera frame, mm."""
        truth = self.truth[index]
        surface = metrics.TrueSurface(truth.vertices, self.actor.triangles)
        normals = vertex_normals(truth.vertices, self.actor.triangles)[self.frontal]
        motion = metrics.true_motion(truth.vertices, truth.head_pose, self.truth.neutral)[self.frontal]
        distances, parts = [], []
        for stage in self.stages:
            distances.append(surface.distance(meshes[stage][self.scored]))
            error = metrics.motion_error(
                meshes[stage], self.actor.neutral, truth.vertices, self.truth.neutral, truth.head_pose, self.alignment
            )
            parts.append(metrics.split_by_normal(error[self.frontal], normals))
        normal, tangential = zip(*parts, strict=True)
        pose = metrics.pose_error(rigid, truth.head_pose, self.alignment, self.centre)
        self._rows.append(
            (
                index,
                truth.performance,
                np.float32(distances),
                np.float32(normal),
                np.float32(tangential),
                np.float32(np.linalg.norm(motion, axis=1)),
                *pose,
                anchor,
                adaptive,
            )
        )

    def finish(self) -> Evaluation:
        """Return the errors of all frames so far. Raises :class:`AdaptiveFaceError` if none was tracked."""
        if not self._rows:
            raise AdaptiveFaceError("no frame was tracked, so there is no error to report")
        columns = list(zip(*self._rows, strict=True))
        index, performance, distances, normal, tangential, motion, *curves = columns
        per_stage = [np.stack(column, axis=1) for column in (distances, normal, tangential)]
        return Evaluation(
            self.stages,
            np.array(index),
            np.array(performance),
            dict(self._lost),
            *per_stage,
            np.stack(motion),
            *(np.array(curve, float) for curve in curves),
            self.scored,
            self.frontal,
            actor_regions(self.actor),
        )


def evaluate_run(frames: Iterable[TrackedFrame], truth, actor: Actor, stages: tuple[str, ...] = STAGES) -> Evaluation:
    """Score tracked frames against the truth.

    Parameters
    ----------
    frames : iterable of TrackedFrame
        Their ``index`` is the number in the truth.
    truth
        A sensor with ``ground_truth(index)``, a :class:`GroundTruth`, or the path of a ``ground_truth.npz``.
    actor : Actor
        The rig that the frames were tracked with.
    stages : tuple of str
        The meshes to score, "v1" to "v4".

    Returns
    -------
    Evaluation
        Errors in millimetres by stage, frame and vertex.

    Raises
    ------
    AdaptiveFaceError
        The mesh differs from the truth's, or no frame was tracked.
    """
    collector = ErrorCollector(truth, actor, tuple(stages))
    for frame in frames:
        collector.add(frame)
    return collector.finish()
