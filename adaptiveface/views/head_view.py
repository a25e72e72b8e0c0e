"""What every 3D picture of heads shares: vertices with heat, the camera that mouse and sliders turn, the light, the widget."""

from __future__ import annotations

import threading

import ipywidgets as widgets
import numpy as np

from ..mesh import vertex_normals
from ..rendering import Light, heat_map, irradiance
from .kernel import on_main_thread
from .pictures import encode, image_widget
from .turntable import LIMITS, Turntable

SKIN = (205.0, 170.0, 150.0)
#: Room for two of the camera's sliders, pixels: under one head they take two rows, so that a panel fits beside it.
TWO_SLIDERS = 390
#: Steps of the sliders for turn and tilt per degree, and for zoom: whole per cent.
SCALES = (1, 1, 100)
#: The camera stands so far before the middle of the face, and turns about a point so far behind it, mm.
DISTANCE, PIVOT_DEPTH = 700.0, 50.0
#: A colour map that people with any colour vision can order, and that survives printing in grey.
COLOURMAP = "viridis"


class HeadView:
    """Heads of one topology with linked cameras; a subclass draws them (:meth:`picture`). ``widget`` is what to display.

    ``panes``: number of heads; ``size`` (width, height) of the picture; ``limits``, ``label``, ``colourmap`` of the heat map;
    ``centre`` (3,) mm of what is looked at, ``radius`` mm of what is seen of it.
    """

    def __init__(
        self,
        vertices: np.ndarray,
        triangles: np.ndarray,
        panes: int,
        size: tuple[int, int],
        limits,
        colourmap: str,
        centre: np.ndarray | None,
        radius: float,
    ) -> None:
        vertices = np.asarray(vertices, float)
        self.limits, self._colourmap, self._radius = tuple(limits), colourmap, radius
        self._triangles = np.asarray(triangles)
        self._vertices = [vertices] * panes
        self._normals = [vertex_normals(vertices, self._triangles)] * panes
        self._colours = [np.full((len(vertices), 3), SKIN)] * panes
        self.centre = vertices.mean(axis=0) if centre is None else np.asarray(centre, float)
        self._image = Turntable(width=size[0], height=size[1], name="adaptiveface-face")
        self._closed, self._follower = False, 0

    def show(self, pane: int, vertices: np.ndarray, heat: np.ndarray | None = None) -> None:
        """Put vertices (N, 3), head frame mm, into a pane, coloured by ``heat`` (N,); then :meth:`refresh`."""
        self._vertices[pane] = vertices = np.asarray(vertices, float)
        self._normals[pane] = vertex_normals(vertices, self._triangles)
        self._colours[pane] = (
            np.full((len(vertices), 3), SKIN) if heat is None else heat_map(heat, self.limits, self._colourmap)
        )

    def look(self, turn: float = 0.0, tilt: float = 0.0, zoom: float = 1.0) -> None:
        """Camera ``turn`` degrees to the side and ``tilt`` degrees up from straight ahead; redraws."""
        self._follow((turn, tilt, zoom), self._image)
        self._stand(turn, tilt, zoom)

    def _wish(self, *camera: float) -> None:
        """Look where the picture was dragged. It has its camera: writing it back could undo a newer wish of another thread."""
        self._follow(camera)
        self._stand(*camera)

    def _stand(self, turn: float, tilt: float, zoom: float) -> None:
        if self._closed:
            return
        a, e = np.radians(turn), np.radians(tilt)
        self._away, self._zoom = np.array([np.sin(a) * np.cos(e), np.sin(e), np.cos(a) * np.cos(e)]), zoom
        self._aim()
        self.refresh()

    def _aim(self) -> None:
        """The camera has moved: it looks along minus ``_away`` at :attr:`_pivot`."""

    @property
    def _pivot(self) -> np.ndarray:
        """The middle of the skull: about the face, a profile's back of the head would leave the pane."""
        return self.centre - np.array([0.0, 0.0, PIVOT_DEPTH])

    @property
    def _spread(self) -> float:
        """Tangent of half the viewing angle."""
        return self._radius / DISTANCE / self._zoom

    def refresh(self) -> None:
        """Draw, and send the picture to the browser."""
        if not self._closed:
            self._image.value = encode(self.picture())

    def picture(self) -> np.ndarray:
        """(H, W, 3) uint8 of the panes as they are now."""
        raise NotImplementedError

    def _lit(self, pane: int) -> np.ndarray:
        """(N, 3) uint8 colours of the vertices in the light, which comes along with the camera."""
        up, normals = np.array([0.0, 1.0, 0.0]), self._normals[pane]
        light = Light(key_direction=tuple(0.6 * up + np.cross(up, self._away) * -0.5 + 0.5 * self._away))
        diffuse, specular = irradiance(normals, np.broadcast_to(self._away[None], normals.shape), light)
        return np.clip(self._colours[pane] * diffuse[:, None] + 255 * specular[:, None], 0, 255).astype(np.uint8)

    def close(self) -> None:
        """No further drawing; the last picture stays."""
        self._closed = True

    def _make_widget(self, label: str) -> None:
        # Whole numbers: JupyterLab's sliders round, and send back what they rounded, which would overtake the next wish.
        self.turn, self.tilt, self.zoom = (
            widgets.IntSlider(
                start,
                min=round(scale * low),
                max=round(scale * high),
                description=name,
                readout_format="d",
                style={"description_width": width},
                layout=widgets.Layout(width="188px"),
            )
            for name, start, scale, width, (low, high) in zip(
                ("turn, °", "tilt, °", "zoom, %"), (0, 0, 100), SCALES, ("48px", "44px", "60px"), LIMITS, strict=True
            )
        )
        move, wish = on_main_thread(lambda *camera: self.look(*camera)), on_main_thread(self._wish)
        for slider in (self.turn, self.tilt, self.zoom):
            slider.observe(lambda change: self._following or move(*self._sliders()), "value")
        self._image.observe(lambda change: self._following or wish(*change.new), "camera")
        row = widgets.Layout(flex_flow="row wrap", max_width=f"{max(int(self._image.width), TWO_SLIDERS)}px")
        parts = [self._image, widgets.HBox([self.turn, self.tilt, self.zoom], layout=row)]
        if label:
            parts.insert(1, colour_bar(self.limits, label, self._colourmap))
        self.widget = widgets.VBox(parts)

    def _sliders(self) -> tuple[float, float, float]:
        return tuple(slider.value / scale for slider, scale in zip((self.turn, self.tilt, self.zoom), SCALES, strict=True))

    @property
    def _following(self) -> bool:
        """Whether a change is :meth:`_follow`'s own. Wishes of the browser arrive on another thread, also meanwhile."""
        return self._follower == threading.get_ident()

    def _follow(self, camera, image: Turntable | None = None) -> None:
        """Sliders, and the mouse where ``image`` is given, go on from a camera, wherever it came from."""
        self._follower = threading.get_ident()
        try:
            if image is not None:
                image.camera = [float(value) for value in camera]
            for slider, scale, value in zip((self.turn, self.tilt, self.zoom), SCALES, camera, strict=True):
                slider.value = min(max(round(scale * value), slider.min), slider.max)
        finally:
            self._follower = 0


def colour_bar(limits, label: str, colourmap: str = COLOURMAP, width: int = 380) -> widgets.Image:
    """The legend of a heat map: its range and meaning, drawn once."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width / 100, 0.55), dpi=100, facecolor="white")
    canvas = FigureCanvasAgg(figure)
    axis = figure.add_axes((0.05, 0.72, 0.9, 0.24))
    bar = figure.colorbar(ScalarMappable(Normalize(*limits), colourmap), cax=axis, orientation="horizontal")
    bar.ax.tick_params(labelsize=8, pad=1)
    bar.set_label(label, fontsize=8, labelpad=1)
    canvas.draw()
    image = image_widget(width, 55, "png")
    image.value = encode(np.asarray(canvas.buffer_rgba())[..., :3], "png")
    return image
