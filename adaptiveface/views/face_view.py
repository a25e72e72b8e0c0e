"""Show heads side by side with linked cameras, heat maps with one fixed range, and points."""

from __future__ import annotations

from collections.abc import Sequence

import ipywidgets as widgets
import numpy as np

from ..geometry.polydata import surface
from ..insides import make_insides, moved
from ..model.actor import Actor
from . import heads, still

#: Colour maps that people with any colour vision can order: of lengths, and of signed values.
COLOURMAP, SIGNED = "viridis", "coolwarm"


class FaceView:
    """Heads of one topology, pane by pane. ``widget`` is what to display; the browser draws it and turns it.

    ``titles``: one per pane. ``limits``, ``label``: range and meaning of every heat map ("distance in mm"); the colours are
    those of signed values where the range begins below zero. ``shape`` (rows, columns) of the panes. ``centre`` (3,) mm of
    what is looked at, ``radius`` mm of what is seen of it. ``compare``: with several panes a slider enlarges their
    difference from the first one. Cameras are linked: turn, tilt and zoom act on all.
    ``moving`` (N,) bool: of the other vertices nothing is sent while they rest.

    Heads of the embedded model's mesh have eyes, teeth and tongue, fitted to ``vertices``, which are somebody's neutral head.
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
        colourmap: str | None = None,
        radius: float = 138.0,
        compare: bool = False,
        moving: np.ndarray | None = None,
    ) -> None:
        vertices, self._triangles = np.asarray(vertices, float), np.asarray(triangles)
        self.titles, self.limits, self._closed = tuple(titles), tuple(map(float, limits)), False
        self.pane = pane
        self.colourmap = colourmap or (SIGNED if limits[0] < 0 else COLOURMAP)
        self.centre = vertices.mean(axis=0) if centre is None else np.asarray(centre, float)
        rows, columns = shape or (1, len(titles))
        self._compare = compare and len(titles) > 1
        insides = make_insides(vertices, self._triangles)
        motion = None if insides is None else insides.motion(vertices)
        self._shown = [still.Shown(vertices, insides=insides, motion=motion) for _ in titles]
        self._rests = [heads.rest(insides)] * len(titles)
        self._moving = None if moving is None else heads.Moving(moving, vertices)
        geometry = heads.geometry(len(vertices), self._triangles, insides=insides)
        geometry |= {} if self._moving is None else self._moving.sent()
        self._image = heads.Heads(
            geometry=[geometry] * len(titles),
            rests=self._rests,
            frame=self._frame(),
            titles=list(self.titles),
            grid=[columns, rows],
            pane=list(pane),
            centre=[float(x) for x in self.centre],
            radius=float(radius),
            limits=list(self.limits),
            label=label,
            palette=heads.palette(self.colourmap),
            differs=self._compare,
        )
        self._image.still = self.picture
        self.widget = widgets.VBox([self._image])

    @classmethod
    def of(cls, actor: Actor, titles: Sequence[str] = ("",), **options) -> FaceView:
        """The view of an actor's head, looking at the face."""
        centre = actor.neutral[actor.frontal].mean(axis=0)
        moving = actor.frontal | (actor.blendshapes != 0).any(axis=(0, 2))
        return cls(actor.neutral, actor.triangles, titles, centre=centre, moving=moving, **options)

    def show(
        self,
        pane: int,
        vertices: np.ndarray,
        heat: np.ndarray | None = None,
        *,
        gaze: np.ndarray | None = None,
        turn: np.ndarray | None = None,
        neutral: np.ndarray | None = None,
    ) -> None:
        """Put vertices (N, 3), head frame mm, into a pane, coloured by ``heat`` (N,); then :meth:`refresh`.

        ``gaze`` (2, 2): yaw and pitch of the left and the right eye, rad. ``turn`` (3, 3): a rotation about the view's centre.
        ``neutral`` (N, 3): whose head it is, where it is not the one that the view began with.
        """
        shown = self._shown[pane]
        shown.vertices, shown.heat = np.asarray(vertices, float), None if heat is None else np.asarray(heat, float)
        motion = None
        if shown.insides is not None:
            if neutral is not None and not np.array_equal(neutral, shown.insides.neutral_skin):
                shown.insides = make_insides(np.asarray(neutral, float), self._triangles)
                self._rests[pane] = heads.rest(shown.insides)
            motion = shown.insides.motion(shown.vertices, gaze)
        if turn is not None:
            shift = self.centre - turn @ self.centre
            shown.vertices = shown.vertices @ turn.T + shift
            motion = motion and moved(motion, turn, shift)
        shown.motion = motion

    def hide_head(self, pane: int) -> None:
        """Show only the points in a pane. Call :meth:`refresh` afterwards."""
        self._shown[pane].visible = False

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

        ``count``: at most so many points, evenly chosen; ``size``: of a point, pixels. Then :meth:`refresh`.
        """
        pick = np.linspace(0, len(points) - 1, min(count, len(points))).astype(int)
        values = np.zeros(len(pick)) if values is None else np.asarray(values, float)[pick]
        normals = None if normals is None else np.asarray(normals, float)[pick]
        self._shown[pane].cloud = (np.asarray(points, float).reshape(-1, 3)[pick], values, normals, size)

    def look(self, turn: float = 0.0, tilt: float = 0.0, zoom: float = 1.0) -> None:
        """Camera ``turn`` degrees to the side and ``tilt`` degrees up from straight ahead, on every page that shows it."""
        self._image.camera = [float(turn), float(tilt), float(zoom)]

    def refresh(self) -> None:
        """Send to the browser what has changed."""
        if not self._closed:
            with self._image.hold_sync():  # one message: a head never has the parts of another one
                self._image.rests = list(self._rests)
                self._image.frame = self._frame()

    def _frame(self) -> list[dict]:
        """What the browser shows, pane by pane."""
        out = []
        for k, shown in enumerate(self._shown):
            one = heads.shape(shown.vertices, shown.heat, self._compare and k > 0, shown.visible, self._moving)
            if shown.motion is not None:
                one["inside"] = heads.inside(*shown.motion)
            out.append(one | ({"points": heads.points(*shown.cloud)} if shown.cloud else {}))
        return out

    def picture(self) -> np.ndarray:
        """(H, W, 3) uint8 of the panes as they are now, drawn here: what a saved notebook shows without a kernel."""
        image = self._image
        camera = still.Still(tuple(image.pane), self.centre, image.radius, *image.camera)
        panes = [still.picture(camera, s, self._triangles, self.limits, self.colourmap) for s in self._shown]
        return still.tiled(panes, image.grid[0], self.titles)

    def mesh(self, pane: int | str = 0, heat: np.ndarray | None = None):
        """A pane's head as ``pyvista.PolyData`` in mm: x out of the face, y to the subject's left, z up.

        ``pane``: its number, or how its title begins ("v2"); ``heat`` (N,): the array of that name, by default the values
        that are shown. Raises KeyError for a title that does not exist, :class:`MissingExtraError` without pyvista.
        """
        if isinstance(pane, str):
            found = [k for k, title in enumerate(self.titles) if title.startswith(pane)]
            if not found:
                raise KeyError(f"no pane's title begins with {pane!r}; there are: {', '.join(self.titles)}")
            pane = found[0]
        shown = self._shown[pane]
        return surface(shown.vertices, self._triangles, heat=shown.heat if heat is None else heat)

    def close(self) -> None:
        """Send nothing more. The last picture stays and can be turned."""
        self._closed = True
