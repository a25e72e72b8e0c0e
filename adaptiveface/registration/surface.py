"""Turn a depth map into a surface: crop it, reduce its noise, and compute its gradient (section 4.1).

The surface point of a pixel is z K^-1 (u, v, 1) with the smoothed depth z(u, v).
The cross product of its two derivatives is the normal.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from ..caches.compiled import compiled
from ..geometry.camera import Camera
from ..parameters import DepthParameters


@dataclass(frozen=True)
class DepthSurface:
    """A cropped, smoothed depth map with its gradient.

    Attributes
    ----------
    camera : Camera
        Of the whole depth map.
    origin : (u, v)
        Pixel of the crop's corner.
    depth : (h, w) float32
        Smoothed depth, mm.
    gradient_u, gradient_v : (h, w) float32
        Its derivatives, mm per pixel.
    valid : (h, w) float32
        1 where depth was measured away from depth edges, else 0.
    min_view : float
        Smallest usable cosine of the viewing angle.
    """

    camera: Camera
    origin: tuple[int, int]
    depth: np.ndarray
    gradient_u: np.ndarray
    gradient_v: np.ndarray
    valid: np.ndarray
    min_view: float


def crop_window(camera: Camera, pixels: np.ndarray, margin: float, fixed: int = 0) -> tuple[int, int, int, int]:
    """Choose the window around the face.

    Parameters
    ----------
    camera : Camera
        The window stays within its picture.
    pixels : (n, 2)
        Expected places of the face's points.
    margin : float
        Border around the pixels' box, pixels.
    fixed : int
        Side of a square around the box's centre that replaces the box, pixels; 0 for none.

    Returns
    -------
    u0, v0, u1, v1 : int
        The first pixel, and the first pixel beyond the window.
    """
    axes = np.ascontiguousarray(pixels.T)
    low, high = axes.min(axis=1), axes.max(axis=1)
    if fixed:
        low = np.rint((low + high - fixed) / 2)
        high = low + fixed
    else:
        low, high = np.floor(low - margin), np.ceil(high + margin) + 1
    size = np.array([camera.width, camera.height])
    low = np.clip(low, 0, size - 1).astype(int)
    high = np.clip(high, low + 1, size).astype(int)
    return int(low[0]), int(low[1]), int(high[0]), int(high[1])


def depth_surface(
    depth: np.ndarray, camera: Camera, window: tuple[int, int, int, int], parameters: DepthParameters
) -> DepthSurface:
    """Crop and smooth a depth map (section 4.1).

    Normalised convolution lets missing pixels neither pull the mean towards zero nor leave a rim. Pixels at a depth edge are
    invalid, since the sensor mixes foreground and background there (Rusinkiewicz & Levoy 2001 reject boundary points).

    Parameters
    ----------
    depth : (H, W)
        Depth, mm; 0 where nothing was measured.
    camera : Camera
        Its calibration.
    window : (u0, v0, u1, v1)
        See :func:`crop_window`.
    parameters : DepthParameters
        Smoothing and edges.

    Returns
    -------
    DepthSurface
        Of the window.
    """
    u0, v0, u1, v1 = window
    z = np.ascontiguousarray(depth[v0:v1, u0:u1], np.float32)
    clean = _away_from_edges(z, np.float32(parameters.edge))
    kept = z * clean

    def smooth(image: np.ndarray, sigma: float) -> np.ndarray:
        """The image (h, w), smoothed by ``sigma`` pixels and with nothing around it."""
        return cv2.GaussianBlur(image, (0, 0), sigma, borderType=cv2.BORDER_CONSTANT)

    def masked_mean(sigma: float) -> tuple[np.ndarray, np.ndarray]:
        """Mean depth (h, w) of what is kept around each pixel, mm, and the share of pixels that was kept (h, w)."""
        weight, mean = smooth(clean, sigma), smooth(kept, sigma)
        np.maximum(weight, 1e-3, out=weight)
        return np.divide(mean, weight, out=mean), weight

    fine, _ = masked_mean(parameters.smoothing)
    coarse, support = masked_mean(parameters.normal_smoothing)
    gradient_u = cv2.Sobel(coarse, cv2.CV_32F, 1, 0, ksize=3, scale=0.125)
    gradient_v = cv2.Sobel(coarse, cv2.CV_32F, 0, 1, ksize=3, scale=0.125)
    # On a straight rim, half of the support is missing; one and a half smoothing lengths inside it, 7 % are missing.
    valid = clean * (support > 0.8)
    return DepthSurface(camera, (u0, v0), fine, gradient_u, gradient_v, valid, parameters.min_cosine)


@compiled(nogil=True)
def _away_from_edges(z: np.ndarray, edge: np.float32) -> np.ndarray:
    """(h, w) float32: 1 where depth z (h, w) was measured, and spans at most ``edge`` mm over its neighbours; else 0."""
    height, width = z.shape
    far = np.float32(1e6)
    clean, low, high = (
        np.zeros((height, width), np.float32),
        np.full(width + 2, far, np.float32),
        np.zeros(width + 2, np.float32),
    )
    for i in range(height):
        above, here, below = z[max(i - 1, 0)], z[i], z[min(i + 1, height - 1)]
        for j in range(width):
            a, b, c = above[j], here[j], below[j]
            top = b if b > a else a
            high[j + 1] = c if c > top else top
            a, b, c = a if a > 0 else far, b if b > 0 else far, c if c > 0 else far
            bottom = b if b < a else a
            low[j + 1] = c if c < bottom else bottom
        for j in range(width):
            top = high[j + 1] if high[j + 1] > high[j] else high[j]
            top = high[j + 2] if high[j + 2] > top else top
            bottom = low[j + 1] if low[j + 1] < low[j] else low[j]
            bottom = low[j + 2] if low[j + 2] < bottom else bottom
            clean[i, j] = np.float32(here[j] > 0 and top - bottom <= edge)
    return clean


def occluded_share(surface: DepthSurface, points: np.ndarray, normals: np.ndarray, margin: float) -> float:
    """Measure how much of the face something else hides, such as a hand or hair.

    Points that do not face the camera are ignored, because the face itself hides them.

    Parameters
    ----------
    surface : DepthSurface
        The depth map.
    points, normals : (n, 3)
        Points, mm, and their unit normals, camera frame.
    margin : float
        The depth map hides a point if it lies at least this far in front of it, mm.

    Returns
    -------
    float
        Share of the measured points that are hidden; 0 if none is measured.
    """
    camera = surface.camera
    intrinsics = (camera.fx, camera.fy, camera.cx, camera.cy, float(surface.origin[0]), float(surface.origin[1]))
    measured, hidden = _count_hidden(surface.depth, surface.valid, intrinsics, points, normals, float(margin))
    return hidden / max(measured, 1)


@compiled
def _count_hidden(
    depth: np.ndarray,
    valid: np.ndarray,
    intrinsics: tuple[float, ...],
    points: np.ndarray,
    normals: np.ndarray,
    margin: float,
) -> tuple[int, int]:
    """Count the measured points that face the camera, and those of them that lie over ``margin`` mm behind the depth map."""
    fx, fy, cx, cy, u0, v0 = intrinsics
    height, width = depth.shape
    measured, hidden = 0, 0
    for i in range(len(points)):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        towards = -(normals[i, 0] * x + normals[i, 2] * z + normals[i, 1] * y)
        if not (z > 1.0 and towards > 0.3 * np.sqrt(x * x + y * y + z * z)):
            continue
        u, v = np.rint(fx * x / z + cx - u0), np.rint(fy * y / z + cy - v0)
        if not (0 <= u < width and 0 <= v < height) or valid[int(v), int(u)] == 0:
            continue
        measured += 1
        if depth[int(v), int(u)] < z - margin:
            hidden += 1
    return measured, hidden
