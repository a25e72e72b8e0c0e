"""Show for notebook 03 the iterations of rigid ICP on one frame, with the residuals of the depth points."""

from __future__ import annotations

import ipywidgets as widgets
import numpy as np
from scipy.spatial import cKDTree

from ..geometry.frame import RgbdFrame
from ..geometry.mesh import transform_points, vertex_normals
from ..studies.icp import depth_points, displaced, run_icp
from ..studies.session import Session
from ..tracking.types import TrackedFrame
from .charts import LiveChart, Series
from .face_view import FaceView
from .neutral_study import _STYLE, _WIDE, _Study
from .sliders import ValueSlider, linear_steps


class IcpStudy(_Study):
    """Rigid ICP on one frame from a start that is off by a known amount, with a slider for the iteration.

    Parameters
    ----------
    session : Session
        The performance.
    frame : RgbdFrame
        One of its frames.
    result : TrackedFrame
        Of that frame. Its pose is the goal, and its v1 is the shape to align.
    """

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
        lines: dict[str, Series] = {"mean residual": self.run.residuals, "stop rule, 3 mm": rule}
        self.chart.update(k, **lines, **{"error of the pose": np.array(errors)})
        self.note = (
            f"after {k} step{'s' * (k != 1)}: mean residual {self.run.residuals[k]:.2f} mm over "
            f"{self.run.matches[k]} matches; error of the pose {errors[k]:.2f} mm"
        )

    def _residuals(self, points: np.ndarray) -> np.ndarray:
        """(p,) distance of depth points from the plane of the nearest vertex; NaN beyond the largest distance."""
        distance, nearest = self._tree.query(points)
        along = np.abs(((points - self._vertices[nearest]) * self._all_normals[nearest]).sum(axis=1))
        return np.where(distance < self.max_distance.value, along, np.nan)
