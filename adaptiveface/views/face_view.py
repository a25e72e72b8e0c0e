"""The face view: one or several heads side by side with linked cameras, heat maps with one fixed range, points."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..actor import Actor
from ..rendering import Light, heat_map, irradiance
from .head_view import COLOURMAP, DISTANCE, PIVOT_DEPTH, HeadView
from .headless import prepare_rendering


class FaceView(HeadView):
    """Heads of one topology, pane by pane. ``widget`` is what to display; :meth:`close` frees the renderer.

    ``titles``: one per pane. ``limits``, ``label``: range and meaning of every heat map ("distance in mm"). ``shape``
    (rows, columns) of the panes. Cameras are linked: turn, tilt and zoom act on all, by mouse (drag, wheel, double click)
    or by sliders.
    """

    def __init__(
        self,
        vertices: np.ndarray,
        triangles: np.ndarray,
        titles: Sequence[str] = ("",),
        limits=(0.0, 5.0),
        label: str = "",
        pane: tuple[int, int] = (380, 420),
        centre: np.ndarray | None = None,
        shape: tuple[int, int] | None = None,
        colourmap: str = COLOURMAP,
        radius: float = 138.0,
    ) -> None:
        pyvista = prepare_rendering()
        rows, columns = shape or (1, len(titles))
        size = (pane[0] * columns, pane[1] * rows)
        super().__init__(vertices, triangles, len(titles), size, limits, colourmap, centre, radius)
        self.plotter = pyvista.Plotter(off_screen=True, notebook=False, shape=(rows, columns), window_size=size, border=False)
        faces = np.column_stack([np.full(len(triangles), 3), triangles]).astype(np.int64)
        self._meshes, self._actors, self._clouds = [], [], {}
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
        self.plotter.disable_anti_aliasing()
        if len(titles) > 1:
            self.plotter.link_views()
        self._make_widget(label)
        self.look()

    @classmethod
    def of(cls, actor: Actor, titles: Sequence[str] = ("",), **options) -> FaceView:
        """The view of an actor's head, looking at the face."""
        centre = actor.neutral[actor.frontal].mean(axis=0)
        return cls(actor.neutral, actor.triangles, titles, centre=centre, **options)

    def show(self, pane: int, vertices: np.ndarray, heat: np.ndarray | None = None) -> None:
        """Put vertices (N, 3), head frame mm, into a pane, coloured by ``heat`` (N,); then :meth:`refresh`."""
        super().show(pane, vertices, heat)
        self._meshes[pane].points = np.asarray(vertices, np.float32)

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
            cloud,
            scalars="lit",
            rgb=True,
            style="points",
            point_size=size,
            lighting=False,
            show_scalar_bar=False,
            reset_camera=False,
        )
        self._clouds[pane] = cloud

    def _aim(self) -> None:
        for renderer in self.plotter.renderers:
            camera = renderer.camera
            camera.focal_point, camera.up = self._pivot, (0.0, 1.0, 0.0)
            camera.position = self._pivot + (DISTANCE + PIVOT_DEPTH) * self._away
            camera.view_angle = float(np.degrees(2 * np.arctan(self._spread)))
            camera.clipping_range = (100.0, 2000.0)

    def picture(self) -> np.ndarray:
        """(H, W, 3) uint8 of the panes as they are now."""
        for pane, mesh in enumerate(self._meshes):
            # Lit per vertex here: in software, VTK's own lights take 20 ms for every pane.
            mesh["lit"] = self._lit(pane)
        self.plotter.render()  # screenshot() alone returns the previous picture
        return np.asarray(self.plotter.screenshot(return_img=True))[..., :3]

    def close(self) -> None:
        """Free the renderer; the last picture stays."""
        super().close()
        self.plotter.close()
