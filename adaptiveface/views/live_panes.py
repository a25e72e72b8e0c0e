"""Draw the panes of the live view: input, tracked mesh, character, curves and bars."""

from __future__ import annotations

from collections import deque

import ipywidgets as widgets
import numpy as np

from ..geometry.mesh import surface_points, transform_points, vertex_normals
from ..insides.gaze import GazeTrack
from ..live.session import LiveResult
from ..model.actor import Actor
from ..model.face_model import FaceModel, embedded_face_model
from ..retargeting.arkit import ArkitWeights, arkit_weights
from ..retargeting.loading import load_character
from ..retargeting.portrait import FACING, portrait
from ..studies.measures import depth_distance
from ..tracking.types import STAGE_NAMES
from .charts import BarChart, LiveChart
from .face_view import FaceView
from .pictures import CameraView, encode, image_widget

#: What the heat map can show, each with its fixed range, mm.
ADDED, TO_DEPTH, PLAIN = "v4 - v1: deformation, learning", "distance to the depth map", "none"
HEAT_LIMITS = (0.0, 3.0)
#: Number of frames that the curves show.
HISTORY = 300


class MeshPane:
    """The tracked mesh v4 in the head's pose with a heat map. During the neutral scan, it shows the coverage."""

    def __init__(self, size: tuple[int, int] = (270, 290)) -> None:
        self._size = size
        self._view: FaceView | None = None
        self._actor: Actor | FaceModel | None = None
        self._gaze: GazeTrack | None = None
        self.heat = widgets.Dropdown(
            options=[ADDED, TO_DEPTH, PLAIN],
            description="colours",
            layout=widgets.Layout(width=f"{size[0]}px"),
            style={"description_width": "60px"},
        )
        self.follow = widgets.Checkbox(True, description="turn with the head", indent=False)
        self.widget = widgets.VBox([], layout=widgets.Layout(width=f"{size[0] + 15}px"))

    def show_scan(self, coverage: np.ndarray, pose: np.ndarray | None) -> None:
        """Show the average head, coloured by the share (V,) of the views that the scan still needs."""
        model, view = embedded_face_model(), self._view
        if view is None or self._actor is not model:
            label = "share of the views wanted (1: enough)"
            view = self._open(model, model.mean, "seen by depth", (0.0, 1.0), label, False)
        self._draw(view, model.mean, coverage, pose)

    def show(self, actor: Actor, result: LiveResult) -> None:
        """Show a tracked frame. If the frame is not tracked, the last picture stays."""
        view, track = self._view, self._gaze
        if view is None or track is None or self._actor is not actor:
            view = self._open(actor, actor.neutral, "tracked mesh v4", HEAT_LIMITS, "mm", True)
            track = self._gaze = GazeTrack(actor, keep=False)
        tracked = result.tracked
        gaze = track.see(tracked, result.frame)
        if tracked.tracked:
            self._draw(view, tracked.v4, self._heat(actor, result), tracked.head_pose, gaze)

    def _heat(self, actor: Actor, result: LiveResult) -> np.ndarray | None:
        tracked = result.tracked
        if self.heat.value == PLAIN:
            return None
        if self.heat.value == ADDED:
            return np.where(actor.frontal, np.linalg.norm(tracked.v4 - tracked.v1, axis=1), np.nan)
        vertices = tracked.in_camera(tracked.v4)
        towards = -np.einsum("nd,nd->n", vertex_normals(vertices, actor.triangles), vertices)
        seen = actor.frontal & actor.depth_valid & (towards > 0.2 * np.linalg.norm(vertices, axis=1))
        return np.where(seen, depth_distance(result.frame, vertices), np.nan)

    def _draw(
        self,
        view: FaceView,
        vertices: np.ndarray,
        heat: np.ndarray | None,
        pose: np.ndarray | None,
        gaze: np.ndarray | None = None,
    ) -> None:
        turn = FACING @ pose[:3, :3] if self.follow.value and pose is not None else None
        view.show(0, vertices, heat, gaze=gaze, turn=turn)
        view.refresh()

    def _open(self, owner: Actor | FaceModel, vertices: np.ndarray, title: str, limits, label: str, choices: bool) -> FaceView:
        self.close()
        centre = vertices[owner.frontal].mean(axis=0)
        view = FaceView(vertices, owner.triangles, (title,), limits, label, self._size, centre, radius=150.0)
        self._view, self._actor = view, owner
        self.widget.children = [view.widget, *([self.heat] if choices else []), self.follow]
        return view

    def close(self) -> None:
        """Send nothing more. The last picture stays."""
        if self._view is not None:
            self._view.close()
            self._view = self._actor = None


class InputPane:
    """The sensor's picture with the 2D features and the model over it."""

    def __init__(self, size: tuple[int, int] = (250, 290)) -> None:
        self.camera = CameraView(size, "input: features (yellow), model (blue)")
        self.widget = self.camera.widget

    def show_scan(self, frame) -> None:
        """Show a frame of the neutral scan."""
        self.camera.show(frame)

    def show(self, actor: Actor, result: LiveResult) -> None:
        """Show a tracked frame."""
        tracked = result.tracked
        if not tracked.tracked:
            self.camera.show(result.frame)
            return
        points = transform_points(tracked.head_pose, tracked.v4[actor.frontal][::6])
        places = surface_points(tracked.v4, actor.feature_triangles, actor.feature_weights)
        self.camera.show(result.frame, points, transform_points(tracked.head_pose, places))


class CharacterPane:
    """A character that follows the re-solved coefficients (section 6)."""

    def __init__(self, name: str, size: int = 270) -> None:
        self.character, self._size = load_character(name), size
        self._table: ArkitWeights | None = None
        self._names: tuple[str, ...] = ()
        self._image = image_widget(size, size, name="adaptiveface-character")
        self._image.value = encode(portrait(self.character, self.character.neutral, size, rays=1))
        self.widget = widgets.VBox([widgets.HTML(f"<b>{self.character.name}</b>"), self._image])

    def show(self, actor: Actor, result: LiveResult) -> None:
        """Show a tracked frame."""
        tracked = result.tracked
        if tracked.tracked:
            names, table = actor.expression_names[: len(tracked.coefficients)], self._table
            if table is None or names != self._names:
                table = self._table = arkit_weights(names)
                self._names = names
            shape = self.character.shape(self.character.weights(table.curves(tracked.coefficients[None]))[0])
            picture = portrait(self.character, shape, self._size, tracked.head_pose[:3, :3], rays=1)
            self._image.value = encode(picture)


class CurvesPane:
    """Figure 11 over the last frames, the coefficients, and the milliseconds of every stage.

    ``curves.widget`` is the chart of figure 11, which is placed beside the pictures. ``widget`` holds the other charts.
    """

    def __init__(self) -> None:
        self._anchor: deque[float] = deque(maxlen=HISTORY)
        self._adaptive: deque[float] = deque(maxlen=HISTORY)
        self.curves = LiveChart(
            ("to anchor space", "to adaptive space"),
            (-HISTORY, 0),
            (0, 1.5),
            "frames ago",
            "mean distance, mm",
            "figure 11: distance of v2",
            size=(380, 290),
        )
        self.stages = BarChart([*STAGE_NAMES, "2D features"], (0, 20), "ms", "time per frame", size=(440, 230))
        self.coefficients: BarChart | None = None
        self._names: tuple[str, ...] = ()
        self._box = widgets.VBox([])
        self.widget = widgets.HBox(
            [self.stages.widget, self._box],
            layout=widgets.Layout(flex_flow="row wrap"),
        )

    def add(self, result: LiveResult) -> None:
        """Add a result to the curves."""
        tracked = result.tracked
        self._anchor.append(tracked.anchor_distance if tracked.tracked else np.nan)
        self._adaptive.append(tracked.adaptive_distance if tracked.tracked else np.nan)

    def clear(self) -> None:
        """Clear the curves, because another head is tracked."""
        self._anchor.clear()
        self._adaptive.clear()

    def draw(self, actor: Actor, result: LiveResult, detect_ms: float) -> None:
        """Draw the current curves and bars."""
        x = np.arange(1 - len(self._anchor), 1)
        series = {"to anchor space": (x, np.array(self._anchor)), "to adaptive space": (x, np.array(self._adaptive))}
        self.curves.update(**series)
        tracked = result.tracked
        self.stages.update([*(tracked.stage_ms.get(name, 0.0) for name in STAGE_NAMES), detect_ms])
        names = actor.expression_names[: len(tracked.coefficients)]
        if names != self._names:
            self._names = names
            self.coefficients = BarChart(names, (0, 1), "", "coefficients (re-solved)", size=(330, 470))
            self._box.children = [self.coefficients.widget]
        if self.coefficients is not None:
            self.coefficients.update(tracked.coefficients)
