"""For notebook 03: rigid ICP iteration by iteration on one frame, with the residuals on the depth points."""

from __future__ import annotations

from dataclasses import dataclass

import ipywidgets as widgets
import numpy as np
from scipy.spatial import cKDTree

from ..evaluation import neutral_alignment, pose_error
from ..geometry.frame import RgbdFrame
from ..geometry.mesh import transform_points, vertex_normals
from ..parameters import DepthParameters, Parameters
from ..registration.association import Correspondences, find_correspondences
from ..registration.icp import icp
from ..registration.step import apply_rigid_update, motion_of, point_to_plane_step
from ..registration.surface import crop_window, depth_surface
from ..tracking.types import TrackedFrame
from .charts import LiveChart
from .face_view import FaceView
from .neutral_study import _STYLE, _WIDE, _Study
from .replay import Replay
from .session import Session
from .sliders import ValueSlider, linear_steps


@dataclass(frozen=True)
class IcpRun:
    """``poses`` (I + 1, 4, 4): before and after every step; ``residuals`` (I + 1,) mean |distance| of the matches, mm;
    ``matches`` (I + 1,) their number."""

    poses: np.ndarray
    residuals: np.ndarray
    matches: np.ndarray


def displaced(pose: np.ndarray, centre: np.ndarray, shift: float, turn: float) -> np.ndarray:
    """A pose (4, 4) moved by ``shift`` mm sideways and forwards, and turned by ``turn`` degrees about the vertical."""
    update = np.concatenate([np.radians(turn) * np.array([0.0, 1.0, 0.0]), shift * np.array([0.8, 0.0, -0.6])])
    return apply_rigid_update(pose, update, transform_points(pose, centre))


def run_icp(
    frame: RgbdFrame,
    shape: np.ndarray,
    normals: np.ndarray,
    start: np.ndarray,
    max_distance: float,
    iterations: int = 12,
    step=point_to_plane_step,
) -> IcpRun:
    """Rigid ICP from ``start`` (4, 4) for a shape (n, 3) with normals (n, 3), head frame, with every iterate kept.

    Partners farther away than ``max_distance`` mm are dropped.
    ``step(points, correspondences, centre, vertex_weights)`` -> (6,) is the heart of it.
    """
    pixels = frame.camera.project(transform_points(start, shape))
    surface = depth_surface(frame.depth, frame.camera, crop_window(frame.camera, pixels, 40.0), DepthParameters())
    weights, middle = np.ones(len(shape)), shape.mean(axis=0)

    def associate(pose: np.ndarray) -> Correspondences:
        return find_correspondences(surface, shape, normals, max_distance, pose)

    def advance(pose: np.ndarray, matches: Correspondences) -> tuple[np.ndarray, float]:
        centre = transform_points(pose, middle)
        update = step(matches.points, matches, centre, weights)
        return apply_rigid_update(pose, update, centre), motion_of(update)

    run = list(icp(start, associate, advance, lambda matches: matches.count, 6, iterations))
    residuals, counts = [i.matches.mean_distance for i in run], [i.matches.count for i in run]
    return IcpRun(np.array([i.pose for i in run]), np.array(residuals), np.array(counts))


def depth_points(frame: RgbdFrame, pose: np.ndarray, centre: np.ndarray, radius: float = 130.0, stride: int = 3) -> np.ndarray:
    """(p, 3) measured points around the head, mm, in the head frame given by ``pose`` (4, 4)."""
    v, u = np.mgrid[0 : frame.depth.shape[0] : stride, 0 : frame.depth.shape[1] : stride]
    depth = frame.depth[::stride, ::stride]
    pixels = np.stack([u[depth > 0], v[depth > 0]], axis=1).astype(float)
    points = transform_points(np.linalg.inv(pose), frame.camera.back_project(pixels, depth[depth > 0]))
    return points[np.linalg.norm(points - centre, axis=1) < radius]


class IcpStudy(_Study):
    """One frame, a start that is off by a known amount, and the ICP iterations as a slider."""

    def __init__(self, session: Session, frame: RgbdFrame, result: TrackedFrame) -> None:
        actor = session.actor
        self.frame, self.result, self._keep = frame, result, actor.frontal & actor.depth_valid
        self._vertices, self._all_normals = result.v1, vertex_normals(result.v1, actor.triangles)
        self._shape, self._normals = result.v1[self._keep], self._all_normals[self._keep]
        self._centre, self._tree = self._shape.mean(axis=0), cKDTree(result.v1)
        self.view = FaceView.of(actor, ("head and depth points",), limits=(0, 6), label="distance of the depth points, mm")
        self.iteration = widgets.IntSlider(0, min=0, max=12, description="iteration", style=_STYLE, layout=_WIDE)
        self.max_distance = ValueSlider(linear_steps(2, 60, 1), 25, description="max distance, mm", style=_STYLE, layout=_WIDE)
        self.shift = ValueSlider(linear_steps(0, 60, 1), 10, description="start off by, mm", style=_STYLE, layout=_WIDE)
        self.turn = ValueSlider(linear_steps(-40, 40, 1), 8, description="turned by, degrees", style=_STYLE, layout=_WIDE)
        self.chart = LiveChart(
            ("mean residual", "stop rule, 3 mm", "error of the pose"),
            (0, 12),
            (0.05, 100),
            "iteration",
            "mm, logarithmic",
            "ICP, step by step",
            log=True,
        )
        self._assemble([self.iteration, self.max_distance, self.shift, self.turn])
        self.box.layout.max_height, self.box.children = None, (*self.box.children, self.chart.widget)

    def draw(self) -> None:
        """Run ICP from the chosen start, and show the chosen iteration."""
        start = displaced(self.result.head_pose, self._centre, self.shift.value, self.turn.value)
        self.run = run_icp(self.frame, self._shape, self._normals, start, self.max_distance.value)
        k = min(self.iteration.value, len(self.run.poses) - 1)
        points = depth_points(self.frame, self.run.poses[k], self._centre)
        self.view.show(0, self._vertices)
        self.view.show_points(0, points, self._residuals(points))
        goal = transform_points(self.result.head_pose, self._shape)
        errors = [np.linalg.norm(transform_points(pose, self._shape) - goal, axis=1).mean() for pose in self.run.poses]
        rule = (np.array([0, 12]), np.array([3.0, 3.0]))
        self.chart.update(
            k, **{"mean residual": self.run.residuals, "stop rule, 3 mm": rule, "error of the pose": np.array(errors)}
        )
        self.note = (
            f"after {k} step{'s' * (k != 1)}: mean residual {self.run.residuals[k]:.2f} mm over "
            f"{self.run.matches[k]} partners; error of the pose {errors[k]:.2f} mm"
        )

    def _residuals(self, points: np.ndarray) -> np.ndarray:
        """(p,) distance of depth points from the plane of the nearest vertex; NaN beyond the pruning distance."""
        distance, nearest = self._tree.query(points)
        along = np.abs(((points - self._vertices[nearest]) * self._all_normals[nearest]).sum(axis=1))
        return np.where(distance < self.max_distance.value, along, np.nan)


def rotation_angle(a: np.ndarray, b: np.ndarray) -> float:
    """Degrees between two poses (4, 4)."""
    return float(np.degrees(np.arccos(np.clip((np.trace(a[:3, :3].T @ b[:3, :3]) - 1) / 2, -1, 1))))


__all__ = ["IcpRun", "IcpStudy", "depth_points", "displaced", "rotation_angle", "run_icp"]


def pose_errors(session: Session, **changes) -> np.ndarray:
    """(F, 2) error of the head pose of every tracked frame, mm and degrees, with parameters ``stage__name=value``."""
    truth, actor = session.truth, session.actor
    replay = Replay(session.frames, actor, Parameters().replace(**changes))
    alignment = neutral_alignment(actor.neutral, truth.neutral, actor.frontal)
    centre = truth.neutral[actor.frontal].mean(axis=0)
    return np.array(
        [
            pose_error(result.head_pose, truth[frame.index].head_pose, alignment, centre)
            for result, frame in zip(replay.run(), session.frames, strict=True)
            if result.tracked
        ]
    )
