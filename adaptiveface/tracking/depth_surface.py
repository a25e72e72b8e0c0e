"""The depth map as a surface: crop, noise-reduced depth, its gradient, and projective correspondences (section 4.1).

A vertex is matched with the depth measured on its own viewing ray ("the point of the depth map that has the same camera
space coordinate", section 4.2). The point and its normal follow from the smoothed depth and its gradient at that pixel:
with z(u, v) the surface point is z K^-1 (u, v, 1), and the cross product of its two derivatives is the normal.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from ..caches.compiled import compiled
from ..camera import Camera
from ..parameters import DepthParameters


@dataclass(frozen=True)
class DepthSurface:
    """A cropped, smoothed depth map. ``origin`` (u, v) pixel of the crop's corner; the rest (h, w) float32:

    depth mm; gradient_u, gradient_v mm per pixel; valid: 1 where measured and away from depth edges, else 0; min_view: the
    smallest usable cosine of the viewing angle.
    """

    camera: Camera
    origin: tuple[int, int]
    depth: np.ndarray
    gradient_u: np.ndarray
    gradient_v: np.ndarray
    valid: np.ndarray
    min_view: float


def crop_window(camera: Camera, pixels: np.ndarray, margin: float, fixed: int = 0) -> tuple[int, int, int, int]:
    """u0, v0, u1, v1 of the face window: the box of ``pixels`` (n, 2) plus a margin, or a fixed square about its centre."""
    low, high = pixels.min(axis=0), pixels.max(axis=0)
    if fixed:
        centre = (low + high) / 2
        low, high = centre - fixed / 2, centre + fixed / 2
    else:
        low, high = low - margin, high + margin
    size = np.array([camera.width, camera.height])
    low = np.clip(np.floor(low), 0, size - 1).astype(int)
    high = np.clip(np.ceil(high) + 1, low + 1, size).astype(int)
    return int(low[0]), int(low[1]), int(high[0]), int(high[1])


def depth_surface(depth: np.ndarray, camera: Camera, window, parameters: DepthParameters) -> DepthSurface:
    """Crop and smooth a depth map (H, W) mm; see :class:`DepthSurface`.

    Normalised convolution: missing pixels neither pull the mean towards zero nor leave a rim. Pixels at a depth edge are
    invalid, since the sensor mixes foreground and background there (Rusinkiewicz & Levoy 2001 reject boundary points).
    """
    u0, v0, u1, v1 = window
    z = np.ascontiguousarray(depth[v0:v1, u0:u1], np.float32)
    measured = (z > 0).astype(np.float32)
    far = np.where(z > 0, z, np.float32(1e6))
    span = cv2.dilate(z, np.ones((3, 3))) - cv2.erode(far, np.ones((3, 3)))
    edge = (span > parameters.edge).astype(np.uint8)
    clean = measured * (1 - edge)

    def smooth(image: np.ndarray, sigma: float) -> np.ndarray:
        return cv2.GaussianBlur(image, (0, 0), sigma, borderType=cv2.BORDER_CONSTANT)

    def masked_mean(sigma: float) -> tuple[np.ndarray, np.ndarray]:
        weight = smooth(clean, sigma)
        return smooth(z * clean, sigma) / np.maximum(weight, 1e-3), weight

    fine, _ = masked_mean(parameters.smoothing)
    coarse, support = masked_mean(parameters.normal_smoothing)
    gradient_u = cv2.Sobel(coarse, cv2.CV_32F, 1, 0, ksize=3, scale=0.125)
    gradient_v = cv2.Sobel(coarse, cv2.CV_32F, 0, 1, ksize=3, scale=0.125)
    # Half of the support is missing on a straight rim: one and a half smoothing lengths inside it, 7 % are.
    valid = clean * (support > 0.8)
    return DepthSurface(camera, (u0, v0), fine, gradient_u, gradient_v, valid, parameters.min_view)


@compiled
def _associate(
    points,
    normals,
    pose,
    depth,
    gradient_u,
    gradient_v,
    valid,
    intrinsics,
    reach,
    min_cosine,
    min_view,
    out,
    distance,
    plane,
):
    """Put the points into the camera frame; point-to-plane distance, normal and weight of each (weight 0: no match)."""
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
        facing = 0.0  # cosine between the surface's normal and the point's own, turned by the pose
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
        # A grazing surface is measured badly: weigh by the cosine between viewing ray and normal.
        weight[i] = -(nx * x + ny * y + nz * z) / np.sqrt(x * x + y * y + z * z)
        if weight[i] < min_view:
            weight[i] = 0.0
    return weight


@dataclass(frozen=True)
class Correspondences:
    """Point-to-plane matches of n points, in the camera frame.

    distances (n,) mm, n_i^T (v_i - p_i); normals (n, 3); weights (n,), 0 = no match; points (n, 3) mm: the v_i, where known.
    """

    distances: np.ndarray
    normals: np.ndarray
    weights: np.ndarray
    points: np.ndarray | None = None

    @property
    def count(self) -> int:
        """Number of matched points."""
        return int(np.count_nonzero(self.weights))

    @property
    def mean_distance(self) -> float:
        """Mean absolute distance over the matched points, mm (inf if there are none)."""
        matched = self.weights > 0
        return float(np.abs(self.distances[matched]).mean()) if matched.any() else float("inf")


def find_correspondences(
    surface: DepthSurface,
    points: np.ndarray,
    normals: np.ndarray,
    reach: float,
    pose: np.ndarray | None = None,
    max_angle: float = 60.0,
) -> Correspondences:
    """Match points (n, 3) with unit normals (n, 3) to the depth map by projection.

    ``pose`` (4, 4) takes both to the camera frame; None: they are there. Dropped: no depth or a depth edge at the pixel,
    depth point farther than ``reach`` mm, normals more than ``max_angle`` degrees apart, viewing angle too flat.
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
        reach,
        np.cos(np.radians(max_angle)),
        surface.min_view,
        in_camera,
        distances,
        planes,
    )
    return Correspondences(distances, planes, weights, in_camera)


def occluded_share(surface: DepthSurface, points: np.ndarray, normals: np.ndarray, margin: float) -> float:
    """Share of the measured points (n, 3) that something more than ``margin`` mm in front of them hides: a hand, hair.

    ``points`` and unit ``normals`` (n, 3) in the camera frame; what does not face the camera is not asked, since the
    face hides that itself. 0 where nothing is measured.
    """
    facing = -np.einsum("nd,nd->n", normals, points) > 0.3 * np.linalg.norm(points, axis=1)
    front = points[facing & (points[:, 2] > 1.0)]
    pixels = np.rint(surface.camera.project(front) - surface.origin).astype(int)
    height, width = surface.valid.shape
    inside = (pixels >= 0).all(axis=1) & (pixels[:, 0] < width) & (pixels[:, 1] < height)
    u, v = pixels[inside].T
    measured = surface.valid[v, u] > 0
    hidden = measured & (surface.depth[v, u] < front[inside, 2] - margin)
    return float(hidden.sum() / max(measured.sum(), 1))
