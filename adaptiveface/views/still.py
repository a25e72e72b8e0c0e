"""Draw still pictures of heads and clouds in the kernel. A saved notebook shows them instead of a view."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from ..geometry.camera import Camera
from ..geometry.mesh import vertex_normals
from ..geometry.painting import paint
from ..geometry.rendering import Light, heat_map, irradiance
from ..insides import Insides, placed

SKIN = (205.0, 170.0, 150.0)
#: Distance of the camera from the middle of the face, and depth behind it of the point about which the camera turns, mm. If
#: it turned about the face itself, the back of the head in profile would leave the pane.
DISTANCE, PIVOT_DEPTH = 700.0, 50.0


@dataclass
class Shown:
    """Content of a pane: vertices (N, 3) mm with heat (N,) or None, and a cloud (positions, values, normals, size) or None.

    ``insides`` are the parts inside the head, and ``motion`` is the result of :meth:`~adaptiveface.insides.Insides.motion`.
    """

    vertices: np.ndarray
    heat: np.ndarray | None = None
    visible: bool = True
    cloud: tuple[np.ndarray, np.ndarray, np.ndarray | None, int] | None = None
    insides: Insides | None = None
    motion: tuple[np.ndarray, np.ndarray] | None = None


class Still:
    """The camera of a pane of ``size`` px. It turns about the skull and shows ``radius`` mm around ``centre`` (3,)."""

    def __init__(
        self,
        size: tuple[int, int],
        centre: np.ndarray,
        radius: float,
        turn: float = 0.0,
        tilt: float = 0.0,
        zoom: float = 1.0,
    ) -> None:
        a, e = np.radians(turn), np.radians(tilt)
        self.away = np.array([np.sin(a) * np.cos(e), np.sin(e), np.cos(a) * np.cos(e)])
        right = np.cross([0.0, 1.0, 0.0], self.away)
        right /= np.linalg.norm(right)
        self._axes = np.stack([right, np.cross(right, self.away), -self.away])  # x right, y down, z forward
        self._pivot = np.asarray(centre, float) - [0.0, 0.0, PIVOT_DEPTH]
        wide, high = size
        focal = high / 2 * DISTANCE / radius * zoom
        self.camera = Camera(wide, high, focal, focal, (wide - 1) / 2, (high - 1) / 2)

    def points(self, positions: np.ndarray) -> np.ndarray:
        """Turn head-frame positions (n, 3) into the camera frame, mm."""
        return (positions - self._pivot) @ self._axes.T + [0.0, 0.0, DISTANCE + PIVOT_DEPTH]

    def lit(self, colours: np.ndarray, normals: np.ndarray) -> np.ndarray:
        """Colours (n, 3) uint8 under a light that moves with the camera."""
        up = np.array([0.0, 1.0, 0.0])
        light = Light(key_direction=tuple(0.6 * up + np.cross(up, self.away) * -0.5 + 0.5 * self.away))
        diffuse, specular = irradiance(normals, np.broadcast_to(self.away[None], normals.shape), light)
        return np.clip(colours * diffuse[:, None] + 255 * specular[:, None], 0, 255).astype(np.uint8)


def picture(still: Still, shown: Shown, triangles: np.ndarray, limits, colourmap: str) -> np.ndarray:
    """Draw one pane on white, (H, W, 3) uint8."""
    image = np.full((still.camera.height, still.camera.width, 3), 255, np.uint8)
    if shown.visible:
        skin = np.full((len(shown.vertices), 3), SKIN)
        colours = skin if shown.heat is None else heat_map(shown.heat, limits, colourmap)
        vertices = shown.vertices
        if shown.insides is not None and shown.motion is not None:
            triangles = np.concatenate([triangles, shown.insides.triangles + len(vertices)])
            colours = np.concatenate([colours, shown.insides.colours])
            vertices = np.concatenate([vertices, placed(shown.insides.rest, shown.insides.part, *shown.motion)])
        lit = still.lit(colours, vertex_normals(vertices, triangles))
        image = paint(still.camera, still.points(vertices), np.ascontiguousarray(triangles, np.int64), lit)
    if shown.cloud is not None and len(shown.cloud[0]):
        _dots(image, still, *shown.cloud, limits, colourmap)
    return image


def _dots(image, still: Still, positions, values, normals, size, limits, colourmap) -> None:
    """Draw squares of ``size`` pixels, the nearest last. A head in front of them does not hide them."""
    colours = heat_map(values, limits, colourmap)
    colours = colours if normals is None else still.lit(colours, normals)
    points = still.points(positions)
    order = np.argsort(-points[:, 2])
    pixels = np.round(still.camera.project(points[order])).astype(int)
    for shift in np.ndindex(size, size):
        u, v = (pixels + np.array(shift) - size // 2).T
        inside = (u >= 0) & (v >= 0) & (u < image.shape[1]) & (v < image.shape[0])
        image[v[inside], u[inside]] = colours[order][inside]


def tiled(panes: Sequence[np.ndarray], columns: int, titles: Sequence[str]) -> np.ndarray:
    """Put panes side by side, ``columns`` in a row, with their titles."""
    blank = np.full_like(panes[0], 255)
    for pane, title in zip(panes, titles, strict=True):
        ascii_only = title.encode("ascii", "replace").decode()
        cv2.putText(pane, ascii_only, (6, 16), cv2.FONT_HERSHEY_SIMPLEX, 0.42, (60, 60, 60), 1, cv2.LINE_AA)
    rows = [list(panes[k : k + columns]) for k in range(0, len(panes), columns)]
    return np.vstack([np.hstack(row + [blank] * (columns - len(row))) for row in rows])
