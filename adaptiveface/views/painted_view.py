"""One head, drawn beside a live tracker.

VTK without a graphics card draws on threads of its own and keeps Python's interpreter locked until they are done; where
MediaPipe and the browser want the cores as well, the tracker waits for all of them. The kernel here runs on the calling
thread alone and leaves the interpreter to the others: 4.6 ms of CPU time instead of 12.2 ms for a picture of 360 x 400 pixels,
light and all. :func:`adaptiveface.rendering.ray_cast` makes the same picture (within 0.002 grey values on average), but
keeps depth, triangle and weights of every pixel for its other users: 9.6 ms instead of 3.0 without the light.
"""

from __future__ import annotations

import math

import ipywidgets as widgets
import numba
import numpy as np

from ..camera import Camera
from .head_view import COLOURMAP, DISTANCE, PIVOT_DEPTH, HeadView


class PaintedView(HeadView):
    """One head with a heat map, a camera to turn and a ``title`` above; the arguments are those of :class:`HeadView`.

    ``label``: the meaning of the heat map ("distance in mm").
    """

    def __init__(
        self, vertices: np.ndarray, triangles: np.ndarray, title: str = "", limits=(0.0, 5.0), label: str = "",
        size: tuple[int, int] = (380, 420), centre: np.ndarray | None = None, colourmap: str = COLOURMAP,
        radius: float = 138.0,
    ) -> None:  # fmt: skip
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


def paint(camera: Camera, points: np.ndarray, triangles: np.ndarray, colours: np.ndarray) -> np.ndarray:
    """(H, W, 3) uint8: triangles (T, 3) int64 of points (N, 3) mm, camera frame, all in front of it, on white.

    colours (N, 3) uint8 are interpolated in the picture, which differs from the surface by less than a grey value where
    triangles are small. Both sides are drawn.
    """
    image = np.full((camera.height, camera.width, 3), 255, np.uint8)
    nearness = np.zeros((camera.height, camera.width), np.float32)
    _paint(camera.project(points), 1.0 / points[:, 2], triangles, colours, nearness, image)
    return image


@numba.njit(cache=True, nogil=True)
def _paint(pixels, inverse_depths, triangles, colours, nearness, image):
    """A z-buffer of inverse depths, which are linear in the picture; weights of the corners from edge functions."""
    height, width = nearness.shape
    for t in range(len(triangles)):
        i, j, k = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        ui, vi, uj, vj, uk, vk = pixels[i, 0], pixels[i, 1], pixels[j, 0], pixels[j, 1], pixels[k, 0], pixels[k, 1]
        area = (uj - ui) * (vk - vi) - (uk - ui) * (vj - vi)
        if area == 0.0:
            continue
        a_u, b_u = (vj - vk) / area, (vk - vi) / area  # the weights' steps from pixel to pixel
        first_u, last_u = max(0, math.ceil(min(ui, uj, uk))), min(width - 1, math.floor(max(ui, uj, uk)))
        first_v, last_v = max(0, math.ceil(min(vi, vj, vk))), min(height - 1, math.floor(max(vi, vj, vk)))
        for v in range(first_v, last_v + 1):
            a_0 = (uj * (vk - v) - uk * (vj - v)) / area
            b_0 = (uk * (vi - v) - ui * (vk - v)) / area
            for u in range(first_u, last_u + 1):
                a, b = a_0 + a_u * u, b_0 + b_u * u
                c = 1.0 - a - b
                if a < 0.0 or b < 0.0 or c < 0.0:
                    continue
                near = a * inverse_depths[i] + b * inverse_depths[j] + c * inverse_depths[k]
                if near > nearness[v, u]:
                    nearness[v, u] = near
                    for channel in range(3):
                        image[v, u, channel] = np.uint8(
                            a * colours[i, channel] + b * colours[j, channel] + c * colours[k, channel]
                        )
