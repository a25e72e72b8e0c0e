"""Projective association: a point is matched with the depth measured on its own viewing ray (sections 4.1 and 4.2).

This is "the point of the depth map that has the same camera space coordinate" (section 4.2). The matched point and its normal
follow from the smoothed depth and its gradient at that pixel.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from ..caches.compiled import compiled
from ..renamed import renamed
from .surface import DepthSurface


@compiled
def _associate(
    points: np.ndarray,
    normals: np.ndarray,
    pose: np.ndarray,
    depth: np.ndarray,
    gradient_u: np.ndarray,
    gradient_v: np.ndarray,
    valid: np.ndarray,
    intrinsics: tuple[float, ...],
    reach: float,
    min_cosine: float,
    min_view: float,
    out: np.ndarray,
    distance: np.ndarray,
    plane: np.ndarray,
) -> np.ndarray:
    """Match points at a pose: their camera-frame places, and distance, normal and weight of each match (weight 0: none)."""
    fx, fy, cx, cy, u0, v0 = intrinsics
    h, w = depth.shape
    weight = np.zeros(len(points))
    for i in range(len(points)):
        a, b, c = points[i]
        x = pose[0, 0] * a + pose[0, 1] * b + pose[0, 2] * c + pose[0, 3]
        y = pose[1, 0] * a + pose[1, 1] * b + pose[1, 2] * c + pose[1, 3]
        z = pose[2, 0] * a + pose[2, 1] * b + pose[2, 2] * c + pose[2, 3]
        out[i, 0], out[i, 1], out[i, 2] = x, y, z
        if z <= 1.0:
            continue
        u, v = fx * x / z + cx - u0, fy * y / z + cy - v0
        iu, iv = int(np.floor(u + 0.5)), int(np.floor(v + 0.5))
        if iu < 0 or iv < 0 or iu >= w or iv >= h or valid[iv, iu] == 0:
            continue
        gu, gv = gradient_u[iv, iu], gradient_v[iv, iu]
        measured = depth[iv, iu] + gu * (u - iu) + gv * (v - iv)
        du, dv = u + u0 - cx, v + v0 - cy
        nx, ny, nz = fx * gu, fy * gv, -(measured + du * gu + dv * gv)
        length = np.sqrt(nx * nx + ny * ny + nz * nz)
        nx, ny, nz = nx / length, ny / length, nz / length
        facing = 0.0  # cosine between the surface's normal and the point's own normal, turned by the pose
        for k in range(3):
            facing += normals[i, k] * (nx * pose[0, k] + ny * pose[1, k] + nz * pose[2, k])
        if facing < min_cosine:
            continue
        ray = measured / z  # the depth point is ray * (x, y, z)
        gap = 1.0 - ray
        along = gap * (nx * x + ny * y + nz * z)
        if gap * gap * (x * x + y * y + z * z) > reach * reach:
            continue
        distance[i] = along
        plane[i, 0], plane[i, 1], plane[i, 2] = nx, ny, nz
        # Depth is inaccurate on a grazing surface, so the weight is the cosine between viewing ray and normal.
        weight[i] = -(nx * x + ny * y + nz * z) / np.sqrt(x * x + y * y + z * z)
        if weight[i] < min_view:
            weight[i] = 0.0
    return weight


@renamed
@dataclass(frozen=True)
class Correspondences:
    """Point-to-plane matches of n points v_i with points p_i of the depth map, camera frame.

    Attributes
    ----------
    distances : (n,)
        n_i^T (v_i - p_i), mm.
    normals : (n, 3)
        Unit normals n_i of the depth map.
    weights : (n,)
        0 for points without a match.
    points : (n, 3)
        The v_i, mm.
    """

    distances: np.ndarray
    normals: np.ndarray
    weights: np.ndarray
    points: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))

    @property
    def count(self) -> int:
        """Number of matched points."""
        return int(np.count_nonzero(self.weights))

    def equally_weighted(self) -> Correspondences:
        """The same matches, all with weight 1."""
        return replace(self, weights=(self.weights > 0).astype(float))

    @property
    def mean_distance(self) -> float:
        """Mean absolute distance over the matched points, mm (inf if there are none)."""
        matched = self.weights > 0
        return float(np.abs(self.distances[matched]).mean()) if matched.any() else float("inf")


def find_correspondences(
    surface: DepthSurface,
    points: np.ndarray,
    normals: np.ndarray,
    max_correspondence_distance: float,
    pose: np.ndarray | None = None,
    max_angle: float = 60.0,
) -> Correspondences:
    """Match points to the depth map by projection.

    Points without a match are those whose pixel has no depth or lies at a depth edge, whose depth point is too far away or
    turned too far, or whose surface is seen at too flat an angle.

    Parameters
    ----------
    surface : DepthSurface
        The depth map.
    points, normals : (n, 3)
        Points, mm, and their unit normals in the camera frame, or in the frame that ``pose`` maps to it.
    max_correspondence_distance : float
        Depth points farther away are dropped, mm.
    pose : (4, 4), optional
        Maps points and normals to the camera frame, mm.
    max_angle : float
        Largest angle between the normals of a match, degrees.

    Returns
    -------
    Correspondences
        One entry per point.
    """
    camera, n = surface.camera, len(points)
    in_camera, distances, planes = np.zeros((n, 3)), np.zeros(n), np.zeros((n, 3))
    weights = _associate(
        np.ascontiguousarray(points, np.float64),
        np.ascontiguousarray(normals, np.float64),
        np.eye(4) if pose is None else np.ascontiguousarray(pose, np.float64),
        surface.depth,
        surface.gradient_u,
        surface.gradient_v,
        surface.valid,
        (camera.fx, camera.fy, camera.cx, camera.cy, float(surface.origin[0]), float(surface.origin[1])),
        max_correspondence_distance,
        np.cos(np.radians(max_angle)),
        surface.min_view,
        in_camera,
        distances,
        planes,
    )
    return Correspondences(distances, planes, weights, in_camera)
