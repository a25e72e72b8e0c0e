"""The face view: one or several heads side by side with linked cameras, heat maps with one fixed range, points."""

from __future__ import annotations

import threading
from collections.abc import Sequence

import ipywidgets as widgets
import numpy as np

from ..actor import Actor
from ..mesh import vertex_normals
from ..rendering import Light, heat_map, irradiance
from .headless import prepare_rendering
from .kernel import on_main_thread
from .pictures import encode, image_widget
from .turntable import LIMITS, Turntable

SKIN = (205.0, 170.0, 150.0)
#: Room for two of the camera's sliders, pixels: under one head they take two rows, so that a panel fits beside it.
TWO_SLIDERS = 390
#: How far behind the face the views turn, mm.
PIVOT_DEPTH = 50.0
#: A colour map that people with any colour vision can order, and that survives printing in grey.
COLOURMAP = "viridis"
#: Steps of the sliders for turn and tilt per degree, and for zoom: whole per cent.
SCALES = (1, 1, 100)


class FaceView:
    """Heads of one topology, pane by pane. ``widget`` is what to display; :meth:`close` frees the renderer.

    ``titles``: one per pane. ``limits``, ``label``: range and meaning of every heat map ("distance in mm"). ``shape``
    (rows, columns) of the panes. Cameras are linked: turn, tilt and zoom act on all, by mouse (drag, wheel, double click)
    or by sliders.
    """

    def __init__(
        self, vertices: np.ndarray, triangles: np.ndarray, titles: Sequence[str] = ("",), limits=(0.0, 5.0),
        label: str = "", pane: tuple[int, int] = (380, 420), centre: np.ndarray | None = None,
        shape: tuple[int, int] | None = None, colourmap: str = COLOURMAP, radius: float = 138.0,
    ) -> None:  # fmt: skip
        pyvista = prepare_rendering()
        rows, columns = shape or (1, len(titles))
        self.limits, self.label, self._radius = tuple(limits), label, radius
        size = (pane[0] * columns, pane[1] * rows)
        self.plotter = pyvista.Plotter(
            off_screen=True, notebook=False, shape=(rows, columns), window_size=size, border=False
        )
        faces = np.column_stack([np.full(len(triangles), 3), triangles]).astype(np.int64)
        self._triangles = np.asarray(triangles)
        self._meshes, self._actors, self._colours, self._normals = [], [], [], []
        self._clouds, self._colourmap = {}, colourmap
        for number, title in enumerate(titles):
            self.plotter.subplot(*divmod(number, columns))
            self.plotter.set_background("white")
            mesh = pyvista.PolyData(np.asarray(vertices, np.float32), faces)
            mesh["lit"] = np.full((len(vertices), 3), 200, np.uint8)
            drawn = self.plotter.add_mesh(mesh, scalars="lit", rgb=True, lighting=False, show_scalar_bar=False)
            self._actors.append(drawn)
            if title:
                # In a corner, pyvista would scale the text to its length.
                place = (0.01, 1 - (19 + 14 * title.count("\n")) / pane[1])
                self.plotter.add_text(title, position=place, viewport=True, font_size=7, color="black")
            self._meshes.append(mesh)
            self._colours.append(np.full((len(vertices), 3), SKIN))
            self._normals.append(vertex_normals(np.asarray(vertices, float), self._triangles))
        self.plotter.disable_anti_aliasing()
        if len(titles) > 1:
            self.plotter.link_views()
        self.centre = np.asarray(vertices, float).mean(axis=0) if centre is None else np.asarray(centre, float)
        self._image = Turntable(width=size[0], height=size[1], name="adaptiveface-face")
        self._closed, self._follower = False, 0
        self._make_widget(label)
        self.look()

    @classmethod
    def of(cls, actor: Actor, titles: Sequence[str] = ("",), **options) -> FaceView:
        """The view of an actor's head, looking at the face."""
        centre = actor.neutral[actor.frontal].mean(axis=0)
        return cls(actor.neutral, actor.triangles, titles, centre=centre, **options)

    def show(self, pane: int, vertices: np.ndarray, heat: np.ndarray | None = None) -> None:
        """Put vertices (N, 3), head frame mm, into a pane, coloured by ``heat`` (N,); then :meth:`refresh`."""
        mesh = self._meshes[pane]
        mesh.points = np.asarray(vertices, np.float32)
        self._normals[pane] = vertex_normals(np.asarray(vertices, float), self._triangles)
        self._colours[pane] = (
            np.full((mesh.n_points, 3), SKIN) if heat is None else heat_map(heat, self.limits, self._colourmap)
        )

    def hide_head(self, pane: int) -> None:
        """Leave only the points in a pane."""
        self._actors[pane].visibility = False

    def show_points(
        self,
        pane: int,
        points: np.ndarray,
        values: np.ndarray | None = None,
        normals: np.ndarray | None = None,
        count: int = 6000,
        size: int = 3,
    ) -> None:
        """A cloud of points (n, 3) in a pane, coloured by values (n,) in the view's range, lit by normals (n, 3).

        ``size``: of a point, pixels; the first call's counts.
        Drawn with a constant ``count``: a cloud that changes its size would have to be rebuilt for every frame.
        """
        if len(points) == 0:
            points, values, normals = np.full((1, 3), 1e6), None, None  # out of sight
        pick = np.linspace(0, len(points) - 1, count).astype(int)
        positions = np.asarray(points, np.float32)[pick]
        shown = np.zeros(count) if values is None else np.asarray(values, float)[pick]
        colours = heat_map(shown, self.limits, self._colourmap)
        if normals is not None:
            towards = np.broadcast_to(self._away[None], (count, 3))
            diffuse, _ = irradiance(np.asarray(normals, float)[pick], towards, Light())
            colours = colours * diffuse[:, None]
        colours = np.clip(colours, 0, 255).astype(np.uint8)
        if pane in self._clouds:
            self._clouds[pane].points, self._clouds[pane]["lit"] = positions, colours
            return
        cloud = prepare_rendering().PolyData(positions)
        cloud["lit"] = colours
        self.plotter.subplot(*divmod(pane, self.plotter.shape[1]))
        self.plotter.add_mesh(
            cloud, scalars="lit", rgb=True, style="points", point_size=size, lighting=False, show_scalar_bar=False,
            reset_camera=False,
        )  # fmt: skip
        self._clouds[pane] = cloud

    def look(self, turn: float = 0.0, tilt: float = 0.0, zoom: float = 1.0) -> None:
        """Camera ``turn`` degrees to the side and ``tilt`` degrees up from straight ahead; redraws."""
        self._follow((turn, tilt, zoom), self._image)
        self._aim(turn, tilt, zoom)

    def _wish(self, *camera: float) -> None:
        """Look where the picture was dragged. It has its camera: writing it back could undo a newer wish of another thread."""
        self._follow(camera)
        self._aim(*camera)

    def _aim(self, turn: float, tilt: float, zoom: float) -> None:
        if self._closed:
            return
        a, e = np.radians(turn), np.radians(tilt)
        away = np.array([np.sin(a) * np.cos(e), np.sin(e), np.cos(a) * np.cos(e)])
        self._away = away
        # About the middle of the skull: about the face, a profile's back of the head would leave the pane.
        pivot = self.centre - np.array([0.0, 0.0, PIVOT_DEPTH])
        for renderer in self.plotter.renderers:
            camera = renderer.camera
            camera.focal_point, camera.up = pivot, (0.0, 1.0, 0.0)
            camera.position = pivot + (700.0 + PIVOT_DEPTH) * away
            camera.view_angle = float(np.degrees(2 * np.arctan(self._radius / 700.0 / zoom)))
            camera.clipping_range = (100.0, 2000.0)
        self.refresh()

    def refresh(self) -> None:
        """Draw, and send the picture to the browser."""
        if not self._closed:
            self._image.value = encode(self.picture())

    def picture(self) -> np.ndarray:
        """(H, W, 3) uint8 of the panes as they are now."""
        # Lit per vertex here: in software, VTK's own lights take 20 ms for every pane.
        towards, up = self._away[None], np.array([0.0, 1.0, 0.0])
        light = Light(key_direction=tuple(0.6 * up + np.cross(up, self._away) * -0.5 + 0.5 * self._away))
        for mesh, normals, colours in zip(self._meshes, self._normals, self._colours, strict=True):
            diffuse, specular = irradiance(normals, np.broadcast_to(towards, normals.shape), light)
            mesh["lit"] = np.clip(colours * diffuse[:, None] + 255 * specular[:, None], 0, 255).astype(np.uint8)
        self.plotter.render()  # screenshot() alone returns the previous picture
        return np.asarray(self.plotter.screenshot(return_img=True))[..., :3]

    def close(self) -> None:
        """Free the renderer; the last picture stays."""
        self._closed = True
        self.plotter.close()

    def _make_widget(self, label: str) -> None:
        # Whole numbers: JupyterLab's sliders round, and send back what they rounded, which would overtake the next wish.
        self.turn, self.tilt, self.zoom = (
            widgets.IntSlider(
                start, min=round(scale * low), max=round(scale * high), description=name, readout_format="d",
                style={"description_width": width}, layout=widgets.Layout(width="188px"),
            )
            for name, start, scale, width, (low, high) in zip(
                ("turn, °", "tilt, °", "zoom, %"), (0, 0, 100), SCALES, ("44px", "40px", "52px"), LIMITS, strict=True
            )
        )  # fmt: skip
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
