"""Merge depth frames in a truncated signed distance volume (Curless & Levoy 1996), and extract surface points."""

from __future__ import annotations

import numpy as np

from ..caches.compiled import compiled
from .registration import DepthView


class TsdfVolume:
    """Signed distance samples on a regular grid in the model frame.

    Attributes
    ----------
    box : (2, 3)
        Corners of the grid, mm.
    voxel : float
        Its spacing, mm.
    truncation : float
        Distance at which the samples saturate, mm.
    distance, weight : (X, Y, Z) float32
        Running weighted mean of distance / truncation, which is positive outside the head, and its weight.
    """

    def __init__(self, box: np.ndarray, voxel: float, truncation: float) -> None:
        shape = np.ceil((box[1] - box[0]) / voxel).astype(int) + 1
        self.origin, self.voxel, self.truncation = box[0].astype(float), float(voxel), float(truncation)
        self.distance = np.ones(tuple(shape), np.float32)
        self.weight = np.zeros(tuple(shape), np.float32)

    def integrate(self, view: DepthView, pose: np.ndarray, min_cosine: float) -> None:
        """Add one registered depth view at ``pose`` (4, 4), model to camera. Its weight is the cosine of the viewing angle."""
        camera = view.camera
        _integrate(
            self.distance,
            self.weight,
            self.origin,
            self.voxel,
            self.truncation,
            pose,
            view.points,
            view.normals,
            view.valid,
            camera.fx,
            camera.fy,
            camera.cx,
            camera.cy,
            min_cosine,
        )

    def surface(self, min_weight: float = 1e-3) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Find the zero crossings on the grid's edges: points (P, 3) mm, unit normals (P, 3), accumulated weights (P,)."""
        capacity = max(3 * int((self.weight > min_weight).sum()), 1)
        out = np.empty((min(capacity, 6_000_000), 7))
        count = _zero_crossings(self.distance, self.weight, np.float32(min_weight), out)
        found = out[:count]
        return self.origin + self.voxel * found[:, :3], found[:, 3:6].copy(), found[:, 6].copy()


@compiled
def _integrate(
    distance: np.ndarray,
    weight: np.ndarray,
    origin: np.ndarray,
    voxel: float,
    truncation: float,
    pose: np.ndarray,
    points: np.ndarray,
    normals: np.ndarray,
    valid: np.ndarray,
    fx: float,
    fy: float,
    cx: float,
    cy: float,
    min_cosine: float,
) -> None:
    # This is serial, because parallel loops stalled on shared cores. The distance is measured to the tangent plane and not
    # along the ray, because a ray overestimates it on slanted skin, and the nearest pixel is up to half a pixel off.
    height, width = valid.shape
    for i in range(distance.shape[0]):
        x = origin[0] + i * voxel
        for j in range(distance.shape[1]):
            y = origin[1] + j * voxel
            for k in range(distance.shape[2]):
                z = origin[2] + k * voxel
                depth = pose[2, 0] * x + pose[2, 1] * y + pose[2, 2] * z + pose[2, 3]
                if depth <= 1.0:
                    continue
                across = pose[0, 0] * x + pose[0, 1] * y + pose[0, 2] * z + pose[0, 3]
                down = pose[1, 0] * x + pose[1, 1] * y + pose[1, 2] * z + pose[1, 3]
                column = int(np.floor(fx * across / depth + cx + 0.5))
                row = int(np.floor(fy * down / depth + cy + 0.5))
                if column < 0 or row < 0 or column >= width or row >= height or not valid[row, column]:
                    continue
                px, py, pz = points[row, column, 0], points[row, column, 1], points[row, column, 2]
                if pz - depth < -2.0 * truncation:
                    continue
                nx, ny, nz = normals[row, column, 0], normals[row, column, 1], normals[row, column, 2]
                cosine = -(nx * px + ny * py + nz * pz) / np.sqrt(px * px + py * py + pz * pz)
                if cosine < min_cosine:
                    continue
                d = (nx * (across - px) + ny * (down - py) + nz * (depth - pz)) / truncation
                if d < -1.0:
                    continue
                d = min(d, 1.0)
                old = weight[i, j, k]
                distance[i, j, k] = (distance[i, j, k] * old + d * cosine) / (old + cosine)
                weight[i, j, k] = old + cosine


@compiled
def _zero_crossings(distance: np.ndarray, weight: np.ndarray, min_weight: float | np.float32, out: np.ndarray) -> int:
    nx, ny, nz = distance.shape
    count = 0
    gradient = np.empty((2, 3))
    for i in range(1, nx - 2):
        for j in range(1, ny - 2):
            for k in range(1, nz - 2):
                if weight[i, j, k] <= min_weight:
                    continue
                d0 = distance[i, j, k]
                for axis in range(3):
                    a, b, c = i + (axis == 0), j + (axis == 1), k + (axis == 2)
                    d1 = distance[a, b, c]
                    if weight[a, b, c] <= min_weight or (d0 > 0) == (d1 > 0) or abs(d0 - d1) > 1.0:
                        continue
                    if not (
                        _gradient(distance, weight, min_weight, i, j, k, gradient[0])
                        and _gradient(distance, weight, min_weight, a, b, c, gradient[1])
                    ):
                        continue
                    t = d0 / (d0 - d1)
                    g0 = (1 - t) * gradient[0, 0] + t * gradient[1, 0]
                    g1 = (1 - t) * gradient[0, 1] + t * gradient[1, 1]
                    g2 = (1 - t) * gradient[0, 2] + t * gradient[1, 2]
                    length = np.sqrt(g0 * g0 + g1 * g1 + g2 * g2)
                    if length < 1e-9 or count >= out.shape[0]:
                        continue
                    out[count, 0] = i + t * (axis == 0)
                    out[count, 1] = j + t * (axis == 1)
                    out[count, 2] = k + t * (axis == 2)
                    out[count, 3] = g0 / length
                    out[count, 4] = g1 / length
                    out[count, 5] = g2 / length
                    out[count, 6] = (1 - t) * weight[i, j, k] + t * weight[a, b, c]
                    count += 1
    return count


@compiled
def _gradient(
    distance: np.ndarray, weight: np.ndarray, min_weight: float | np.float32, i: int, j: int, k: int, out: np.ndarray
) -> bool:
    """Central differences; False at the rim of the data, where a normal would not be measured."""
    if (
        weight[i - 1, j, k] <= min_weight
        or weight[i + 1, j, k] <= min_weight
        or weight[i, j - 1, k] <= min_weight
        or weight[i, j + 1, k] <= min_weight
        or weight[i, j, k - 1] <= min_weight
        or weight[i, j, k + 1] <= min_weight
    ):
        return False
    out[0] = distance[i + 1, j, k] - distance[i - 1, j, k]
    out[1] = distance[i, j + 1, k] - distance[i, j - 1, k]
    out[2] = distance[i, j, k + 1] - distance[i, j, k - 1]
    return True
