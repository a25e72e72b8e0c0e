"""Score a tracked performance against its truth by stage, by region, and by first time or repeat.

Shapes: S stages, F scored frames, n vertices that may take depth, m frontal vertices. Lengths are in mm.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from ..errors import AdaptiveFaceError
from ..geometry.mesh import vertex_normals
from ..model.actor import Actor
from ..tracking.types import TrackedFrame
from . import metrics
from .regions import actor_regions
from .truth import FIRST, NEUTRAL, REPEAT, AnyTruth, GroundTruth

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
        """Return which frames (F,) bool belong to a performance. None means all frames after the neutral scan."""
        return self.performance != NEUTRAL if performance is None else self.performance == performance

    def motion_length(self, stage: str) -> np.ndarray:
        """Return the lengths (F, m) of a stage's motion error, mm."""
        s = self.stages.index(stage)
        return np.hypot(self.normal[s], self.tangential[s])

    def surface_percentiles(self, stage: str, performance: int | None, percentiles=(50, 95)) -> list[float]:
        """Return percentiles of the surface distance over all (frame, vertex) pairs of a performance, mm."""
        values = self.surface[self.stages.index(stage)][self.frames(performance)]
        if not values.size:
            return [float("nan")] * len(percentiles)
        return [float(value) for value in np.percentile(values, percentiles)]

    def active_share(self, stage: str, performance: int | None, region: str | None = None) -> float:
        """Return :func:`metrics.active_share` over the frontal vertices of a performance, or only those of a ``region``."""
        chosen = self.frames(performance)
        inside = slice(None) if region is None else self.regions[region][self.frontal]
        return metrics.active_share(self.motion_length(stage)[chosen][:, inside], self.motion[chosen][:, inside])

    def region_error(self, stage: str, region: str, performance: int | None, active: bool = False) -> float:
        """Return the mean length of the motion error over a region's vertices and a performance's frames, mm.

        With ``active``, only the pairs of a frame and a vertex whose true motion exceeds 2 mm count.
        """
        chosen, inside = self.frames(performance), self.regions[region][self.frontal]
        error = self.motion_length(stage)[chosen][:, inside]
        if active:
            error = error[self.motion[chosen][:, inside] > metrics.ACTIVE_MOTION]
        return float(error.mean(dtype=float)) if error.size else float("nan")

    def parts(self, stage: str, performance: int | None) -> tuple[float, float]:
        """Return the mean of the |normal| and of the tangential part of the motion error over the active pairs, mm."""
        s, chosen = self.stages.index(stage), self.frames(performance)
        active = self.motion[chosen] > metrics.ACTIVE_MOTION
        if not active.any():
            return float("nan"), float("nan")
        normal, tangential = np.abs(self.normal[s][chosen][active]), self.tangential[s][chosen][active]
        return float(normal.mean(dtype=float)), float(tangential.mean(dtype=float))

    def summary(self, stage: str, performance: int | None) -> dict[str, float]:
        """Return every measure of a stage and a performance by its name, in mm except for shares."""
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
        """Return the mean length (N,) of the motion error of each vertex, mm. It is NaN outside the frontal region."""
        out = np.full(len(self.frontal), np.nan)
        chosen = self.frames(performance)
        if chosen.any():
            out[self.frontal] = self.motion_length(stage)[chosen].mean(axis=0)
        return out

    def table(self) -> str:
        """Return the summary of every stage and performance as text."""
        from .table import evaluation_table

        return evaluation_table(self)


@dataclass(frozen=True)
class _FrameErrors:
    """Errors of one frame. The attributes are those of :class:`Evaluation`, without the dimension of the frames."""

    index: int
    performance: int
    surface: np.ndarray
    normal: np.ndarray
    tangential: np.ndarray
    motion: np.ndarray
    pose_shift: float
    pose_angle: float
    anchor_distance: float
    adaptive_distance: float


class ErrorCollector:
    """Scores tracked frames one by one, so that a run can be scored while it is tracked, without keeping meshes.

    Parameters
    ----------
    truth : GroundTruth
        The truth, or any other argument of :meth:`GroundTruth.of`.
    actor : Actor
        The rig that is tracked.
    stages : tuple of str
        The meshes to score, of ``STAGES``.
    alignment : (4, 4), optional
        Transform from the actor's head frame to the true one. By default, :func:`metrics.neutral_alignment` finds it.

    Raises
    ------
    AdaptiveFaceError
        The truth and the actor have different meshes.
    """

    def __init__(
        self, truth: AnyTruth, actor: Actor, stages: tuple[str, ...] = STAGES, alignment: np.ndarray | None = None
    ) -> None:
        self.truth, self.actor, self.stages = GroundTruth.of(truth), actor, stages
        if len(self.truth.neutral) != len(actor.neutral):
            raise AdaptiveFaceError(
                f"the truth has {len(self.truth.neutral)} vertices, the actor {len(actor.neutral)}: errors per "
                "vertex need the same mesh; track with an actor captured with the model that made the truth"
            )
        self.frontal = actor.frontal.astype(bool)
        self.scored = self.frontal & actor.depth_valid.astype(bool)
        if alignment is None:
            alignment = metrics.neutral_alignment(actor.neutral, self.truth.neutral, self.frontal)
        self.alignment = alignment
        self.centre = self.truth.neutral[self.frontal].mean(axis=0)
        self._frames: list[_FrameErrors] = []
        self._lost = {NEUTRAL: 0, FIRST: 0, REPEAT: 0}

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
        """Score one frame.

        Parameters
        ----------
        index : int
            Number of the frame in the truth.
        rigid : (4, 4)
            The tracked transform from the head frame to the camera frame, mm.
        meshes : dict
            Vertices (N, 3) of each stage in the camera frame, mm.
        anchor, adaptive : float
            The distances of figure 11.
        """
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
        shift, angle = metrics.pose_error(rigid, truth.head_pose, self.alignment, self.centre)
        self._frames.append(
            _FrameErrors(
                index=index,
                performance=truth.performance,
                surface=np.array(distances, np.float32),
                normal=np.array(normal, np.float32),
                tangential=np.array(tangential, np.float32),
                motion=np.linalg.norm(motion, axis=1).astype(np.float32),
                pose_shift=shift,
                pose_angle=angle,
                anchor_distance=anchor,
                adaptive_distance=adaptive,
            )
        )

    def finish(self) -> Evaluation:
        """Return the errors of all frames so far. Raises :class:`AdaptiveFaceError` if none was tracked."""
        frames = self._frames
        if not frames:
            raise AdaptiveFaceError("no frame was tracked, so there is no error to report")
        return Evaluation(
            stages=self.stages,
            index=np.array([frame.index for frame in frames]),
            performance=np.array([frame.performance for frame in frames]),
            lost=dict(self._lost),
            surface=np.stack([frame.surface for frame in frames], axis=1),
            normal=np.stack([frame.normal for frame in frames], axis=1),
            tangential=np.stack([frame.tangential for frame in frames], axis=1),
            motion=np.stack([frame.motion for frame in frames]),
            pose_shift=np.array([frame.pose_shift for frame in frames], float),
            pose_angle=np.array([frame.pose_angle for frame in frames], float),
            anchor_distance=np.array([frame.anchor_distance for frame in frames], float),
            adaptive_distance=np.array([frame.adaptive_distance for frame in frames], float),
            scored=self.scored,
            frontal=self.frontal,
            regions=actor_regions(self.actor),
        )


def evaluate_run(frames: Iterable[TrackedFrame], truth: AnyTruth, actor: Actor, stages: tuple[str, ...] = STAGES) -> Evaluation:
    """Score tracked frames against the truth.

    Parameters
    ----------
    frames : iterable of TrackedFrame
        The frames. Their ``index`` is the number of the frame in the truth.
    truth : GroundTruth, TrueSource or path-like
        A sensor with ``ground_truth(index)``, a :class:`GroundTruth`, or the path of a ``ground_truth.npz``.
    actor : Actor
        The rig that was tracked.
    stages : tuple of str
        The meshes to score, "v1" to "v4".

    Returns
    -------
    Evaluation
        The errors by stage, frame and vertex.

    Raises
    ------
    AdaptiveFaceError
        The mesh differs from the truth's mesh, or no frame was tracked.
    """
    collector = ErrorCollector(truth, actor, tuple(stages))
    for frame in frames:
        collector.add(frame)
    return collector.finish()
