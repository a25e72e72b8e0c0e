"""Show heads side by side with linked cameras, heat maps with one fixed range, and points."""

from __future__ import annotations

from collections.abc import Sequence

import ipywidgets as widgets
import numpy as np

from ..geometry.polydata import surface
from ..insides import make_insides, moved
from ..model.actor import Actor
from . import heads, still

#: Colour maps for lengths and for signed values. People with any colour vision can order their colours.
COLOURMAP, SIGNED = "viridis", "coolwarm"


class FaceView:
    """Heads of one topology in panes side by side. Display its ``widget``; the browser draws the heads and turns them.

    The cameras are linked: turn, tilt and zoom act on all panes. Heads with the embedded model's mesh have eyes, teeth and a
    tongue, which are fitted to ``vertices``.

    Parameters
    ----------
    vertices : (N, 3)
        Somebody's neutral head, mm.
    triangles : (T, 3)
        Of every head.
    titles : sequence of str
        One per pane.
    limits : (float, float)
        Range of every heat map. If it begins below zero, the colours are those of signed values.
    label : str
        Meaning of every heat map, such as "distance in mm".
    pane : (int, int)
        Width and height of a pane, pixels.
    centre : (3,), optional
        The point that the cameras look at, mm; the middle of the vertices by default.
    shape : (int, int), optional
        Rows and columns of the panes; one row by default.
    colourmap : str, optional
        Name of another colour map.
    radius : float
        Radius of what a pane shows around the centre, mm.
    compare : bool
        Whether a slider enlarges the differences of the other panes from the first one.
    moving : (N,) bool, optional
        Vertices that may move. Nothing is sent of the others while they rest.
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
        """Make the view of an actor's head, looking at the face."""
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
        """Put a head into a pane. Call :meth:`refresh` afterwards.

        Parameters
        ----------
        pane : int
            Number of the pane.
        vertices : (N, 3)
            The head in the head frame, mm.
        heat : (N,), optional
            Values that colour it.
        gaze : (2, 2), optional
            Yaw and pitch of the left and the right eye, rad.
        turn : (3, 3), optional
            A rotation about the view's centre.
        neutral : (N, 3), optional
            The neutral of this head, mm, if it is not the head that the view began with.
        """
        shown = self._shown[pane]
        shown.vertices, shown.heat = np.asarray(vertices, float), None if heat is None else np.asarray(heat, float)
        insides = shown.insides
        if insides is not None and neutral is not None and not np.array_equal(neutral, insides.neutral_skin):
            insides = shown.insides = make_insides(np.asarray(neutral, float), self._triangles)
            self._rests[pane] = heads.rest(insides)
        motion = None if insides is None else insides.motion(shown.vertices, gaze)
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
        """Put a cloud of points into a pane. Call :meth:`refresh` afterwards.

        Parameters
        ----------
        pane : int
            Number of the pane.
        points : (n, 3)
            The points in the head frame, mm.
        values : (n,), optional
            Values that colour them.
        normals : (n, 3), optional
            Unit normals for the light.
        count : int
            Largest number of points to show. They are chosen evenly.
        size : int
            Of a point, pixels.
        """
        pick = np.linspace(0, len(points) - 1, min(count, len(points))).astype(int)
        values = np.zeros(len(pick)) if values is None else np.asarray(values, float)[pick]
        normals = None if normals is None else np.asarray(normals, float)[pick]
        self._shown[pane].cloud = (np.asarray(points, float).reshape(-1, 3)[pick], values, normals, size)

    def look(self, turn: float = 0.0, tilt: float = 0.0, zoom: float = 1.0) -> None:
        """Turn the camera to the side and tilt it upwards from straight ahead, degrees, on every page that shows the view."""
        self._image.camera = [float(turn), float(tilt), float(zoom)]

    def refresh(self) -> None:
        """Send the changes to the browser."""
        if not self._closed:
            with self._image.hold_sync():  # one message, so that a head never has the parts of another one
                self._image.rests = list(self._rests)
                self._image.frame = self._frame()

    def _frame(self) -> list[dict]:
        """The content of every pane, as the browser reads it."""
        out = []
        for k, shown in enumerate(self._shown):
            one = heads.shape(shown.vertices, shown.heat, self._compare and k > 0, shown.visible, self._moving)
            if shown.motion is not None:
                one["inside"] = heads.inside(*shown.motion)
            out.append(one | ({"points": heads.points(*shown.cloud)} if shown.cloud else {}))
        return out

    def picture(self) -> np.ndarray:
        """Draw the panes as they are now, (H, W, 3) uint8; a saved notebook shows this picture without a kernel."""
        image = self._image
        camera = still.Still((image.pane[0], image.pane[1]), self.centre, image.radius, *image.camera)
        panes = [still.picture(camera, s, self._triangles, self.limits, self.colourmap) for s in self._shown]
        return still.tiled(panes, image.grid[0], self.titles)

    def mesh(self, pane: int | str = 0, heat: np.ndarray | None = None):
        """Return the head of a pane for pyvista.

        Parameters
        ----------
        pane : int or str
            Number of the pane, or the beginning of its title, such as "v2".
        heat : (N,), optional
            The array ``heat``; by default the values that are shown.

        Returns
        -------
        pyvista.PolyData
            The head in mm: x points out of the face, y to the subject's left, z up.

        Raises
        ------
        KeyError
            No title begins so.
        MissingExtraError
            pyvista is not installed.
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
