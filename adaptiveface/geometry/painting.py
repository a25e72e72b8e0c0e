"""Pictures of meshes for films and live views: fast, on the calling thread, without Python's lock.

:func:`adaptiveface.geometry.rendering.ray_cast` makes the same picture (within 0.002 grey values on average with the same
light). It also keeps depth, triangle and weights of every pixel for its other users, and takes 9.6 ms instead of 3.0 for
360 x 400 pixels, without light.
"""

from __future__ import annotations

import math

import numpy as np

from ..caches.compiled import compiled
from .camera import Camera
from .mesh import vertex_normals
from .rendering import NEAR, Light, irradiance


def paint(camera: Camera, points: np.ndarray, triangles: np.ndarray, colours: np.ndarray, cull: bool = False) -> np.ndarray:
    """(H, W, 3) uint8: triangles (T, 3) int64 of points (N, 3) mm, camera frame, on white.

    colours (N, 3) uint8 are interpolated in the picture, which differs from the surface by less than a grey value where
    triangles are small. ``cull`` leaves out triangles seen from behind; those with a vertex nearer than
    :data:`adaptiveface.geometry.rendering.NEAR` are left out always.
    """
    image = np.full((camera.height, camera.width, 3), 255, np.uint8)
    nearness = np.zeros((camera.height, camera.width), np.float32)
    depths = np.maximum(points[:, 2], 1e-9)
    pixels = points[:, :2] * (np.array([camera.fx, camera.fy]) / depths[:, None]) + [camera.cx, camera.cy]
    _paint(pixels, np.where(points[:, 2] < NEAR, -1.0, 1.0 / depths), triangles, colours, nearness, image, cull)
    return image


def lit(points: np.ndarray, triangles: np.ndarray, albedo: np.ndarray, light: Light | None = None) -> np.ndarray:
    """(N, 3) uint8 colours of the vertices in the light; points (N, 3) camera frame, albedo (3,) or (N, 3) in 0..255."""
    away = points / np.maximum(np.linalg.norm(points, axis=1), 1e-9)[:, None]
    diffuse, specular = irradiance(vertex_normals(points, triangles), -away, light or Light())
    return np.clip(np.asarray(albedo, float) * diffuse[:, None] + 255 * specular[:, None], 0, 255).astype(np.uint8)


@compiled(nogil=True)
def _paint(pixels, inverse_depths, triangles, colours, nearness, image, cull):
    """A z-buffer of inverse depths, which are linear in the picture; weights of the corners from edge functions."""
    height, width = nearness.shape
    for t in range(len(triangles)):
        i, j, k = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        if inverse_depths[i] < 0.0 or inverse_depths[j] < 0.0 or inverse_depths[k] < 0.0:
            continue
        ui, vi, uj, vj, uk, vk = pixels[i, 0], pixels[i, 1], pixels[j, 0], pixels[j, 1], pixels[k, 0], pixels[k, 1]
        area = (uj - ui) * (vk - vi) - (uk - ui) * (vj - vi)
        if area == 0.0 or (cull and area > 0.0):
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
