"""One head, drawn beside a live tracker.

VTK without a graphics card draws on threads of its own and keeps Python's interpreter locked until they are done; where
MediaPipe and the browser want the cores as well, the tracker waits for all of them. The kernel of
:mod:`adaptiveface.painting` runs on the calling thread alone and leaves the interpreter to the others: 4.6 ms of CPU time
instead of 12.2 ms for a picture of 360 x 400 pixels, light and all.
"""

from __future__ import annotations

import ipywidgets as widgets
import numpy as np

from ..camera import Camera
from ..painting import paint
from .head_view import COLOURMAP, DISTANCE, PIVOT_DEPTH, HeadView


class PaintedView(HeadView):
    """One head with a heat map, a camera to turn and a ``title`` above; the arguments are those of :class:`HeadView`.

    ``label``: the meaning of the heat map ("distance in mm").
    """

    def __init__(
        self,
        vertices: np.ndarray,
        triangles: np.ndarray,
        title: str = "",
        limits=(0.0, 5.0),
        label: str = "",
        size: tuple[int, int] = (380, 420),
        centre: np.ndarray | None = None,
        colourmap: str = COLOURMAP,
        radius: float = 138.0,
    ) -> None:
        super().__init__(vertices, triangles, 1, size, limits, colourmap, centre, radius)
        self._corners, self._size = np.ascontiguousarray(triangles, np.int64), size
        self._make_widget(label)
        if title:
            self.widget.children = [widgets.HTML(f"<b>{title}</b>"), *self.widget.children]
        self.look()

    def _aim(self) -> None:
        width, height = self._size
        right = np.cross([0.0, 1.0, 0.0], self._away)
        right /= np.linalg.norm(right)
        self._turn = np.stack([right, np.cross(right, self._away), -self._away])  # x right, y down, z forward
        focal = height / 2 / self._spread
        self._camera = Camera(width, height, focal, focal, (width - 1) / 2, (height - 1) / 2)

    def picture(self) -> np.ndarray:
        """(H, W, 3) uint8 of the head as it is now."""
        points = (self._vertices[0] - self._pivot) @ self._turn.T + [0.0, 0.0, DISTANCE + PIVOT_DEPTH]
        return paint(self._camera, points, self._corners, self._lit(0))
