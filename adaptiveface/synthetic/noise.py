"""Sensor noise on clean depth images: structured light (Kinect v1, Carmine) and TrueDepth-like.

Structured light: depth comes from the disparity to a projector 75 mm beside the camera, in steps of 1/8 pixel
(Khoshelham & Elberink 2012, "Accuracy and Resolution of Kinect Depth Data": steps and random error grow with the
square of the distance); pixels take the depth of a neighbour half a pixel away (Barron & Malik 2013, "Intrinsic Scene
Properties from a Single RGB-D Image"; Handa et al. 2014, "A Benchmark for RGB-D Visual Odometry, 3D Reconstruction
and SLAM"; Nguyen et al. 2012, "Modeling Kinect Sensor Noise", measure 0.8 px of lateral noise, and holes at grazing
angles); what the projector does not see is a hole.

TrueDepth-like: a dense, smoothed depth map with sub-millimetre noise that neighbouring pixels share (Breitbarth et
al. 2019, "Measurement accuracy and dependence on external influences of the iPhone X TrueDepth sensor"; Vogt et al.
2021, "Comparison of iPad Pro's LiDAR and TrueDepth Capabilities with an Industrial 3D Scanning Solution"). Checked
against a recording of a mannequin's head: without a quadratic fit to 11 x 11 pixels, its noise at 0.26 to 0.31 m is
0.20 to 0.25 mm with correlation 0.55 and 0.18 at one and two pixels; the model's at 0.32 m is 0.23 mm with 0.51 and
0.16.

Depth is rounded at last to what the sensor's driver stores: whole millimetres for structured light (OpenNI's unit; the
disparity step at 0.6 m is 1.1 mm), tenths for TrueDepth (its noise must not drown in the rounding).
"""

from __future__ import annotations

import cv2
import numpy as np

from ..errors import ParameterError
from ..geometry.camera import Camera

#: Units per metre in which each kind of sensor stores its depth.
DEPTH_SCALES = {"structured-light": 1000.0, "truedepth": 10000.0, "none": 10000.0}

#: Distance between projector and camera, mm, and step of the disparity, pixels.
BASELINE = 75.0
DISPARITY_STEP = 0.125
#: Standard deviation of the matched disparity, in steps (Khoshelham & Elberink 2012, section 4.2).
DISPARITY_NOISE = 0.5
#: Standard deviation of the lateral jitter, pixels (Barron & Malik 2013; Handa et al. 2014).
LATERAL_NOISE = 0.5
#: Standard deviation of TrueDepth noise in mm: a constant part and one that grows with (z / 600 mm)^2.
TRUEDEPTH_NOISE = (0.3, 0.25)


def add_noise(kind: str, depth: np.ndarray, camera: Camera, rng: np.random.Generator) -> np.ndarray:
    """Turn clean depth into the depth that the sensor would report.

    Parameters
    ----------
    kind : str
        "structured-light", "truedepth" or "none". With "none", the depth is not changed.
    depth : (h, w) array
        Clean depth of any window of the camera's image, mm. It is 0 where nothing is seen.
    camera : Camera
    rng : numpy.random.Generator

    Returns
    -------
    (h, w) float32 array
        Noisy depth, mm. It is 0 where nothing is measured.

    Raises
    ------
    ParameterError
        ``kind`` is unknown.
    """
    if kind == "none":
        return depth.astype(np.float32)
    if kind not in DEPTH_SCALES:
        raise ParameterError(f"noise = {kind!r}: one of {', '.join(DEPTH_SCALES)} is expected")
    depth = np.asarray(depth, np.float32)
    noisy = (_structured_light if kind == "structured-light" else _truedepth)(depth, camera, rng)
    unit = 1000.0 / DEPTH_SCALES[kind]
    return (np.round(noisy / unit) * unit).astype(np.float32)


def _structured_light(depth: np.ndarray, camera: Camera, rng: np.random.Generator) -> np.ndarray:
    hidden = projector_shadow(depth, camera) | _ragged_edges(depth, rng) | (incidence(depth, camera) > np.radians(80))
    jittered = _lateral_jitter(depth, rng)
    steps = camera.fx * BASELINE / np.maximum(jittered, 1.0) / DISPARITY_STEP
    # Half of the variance is shared by neighbours: the matching windows of the sensor overlap.
    noise = np.sqrt(0.5) * (rng.standard_normal(depth.shape, np.float32) + _correlated(depth.shape, 1.5, rng))
    steps = np.round(steps + DISPARITY_NOISE * noise)
    measured = camera.fx * BASELINE / np.maximum(steps * DISPARITY_STEP, 1.0)
    return np.where(hidden | (jittered <= 0), 0.0, measured)


def _truedepth(depth: np.ndarray, camera: Camera, rng: np.random.Generator) -> np.ndarray:
    smooth = _masked_blur(depth, 0.8)
    size = TRUEDEPTH_NOISE[0] + TRUEDEPTH_NOISE[1] * (smooth / 600.0) ** 2
    noise = 0.8 * _correlated(depth.shape, 1.5, rng) + 0.5 * _correlated(depth.shape, 8.0, rng)
    noise += 0.33 * rng.standard_normal(depth.shape, np.float32)
    angle = incidence(depth, camera)
    hidden = (angle > np.radians(82)) | (_ragged_edges(depth, rng) & (rng.random(depth.shape, np.float32) < 0.5))
    size = size * (1 + 1.5 * np.clip(angle - np.radians(50), 0, None))
    return np.where(hidden | (depth <= 0), 0.0, smooth + size * noise)


def _correlated(shape: tuple[int, int], sigma: float, rng: np.random.Generator) -> np.ndarray:
    """Return Gaussian noise of unit variance that is correlated over ``sigma`` pixels."""
    coarse = max(int(sigma / 2), 1)  # wide noise is made on a coarser grid
    h, w = (-(-n // coarse) + 1 for n in shape)
    pad = int(np.ceil(3 * sigma / coarse))
    white = rng.standard_normal((h + 2 * pad, w + 2 * pad), np.float32)
    kernel = cv2.getGaussianKernel(2 * pad + 1, sigma / coarse)
    noise = cv2.sepFilter2D(white, -1, kernel, kernel)[pad : pad + h, pad : pad + w] / float((kernel**2).sum())
    if coarse > 1:
        noise = cv2.resize(np.asarray(noise, np.float32), None, fx=coarse, fy=coarse, interpolation=cv2.INTER_CUBIC)
    return noise[: shape[0], : shape[1]]


def _masked_blur(depth: np.ndarray, sigma: float) -> np.ndarray:
    """Gaussian blur that does not mix a surface with the void, nor with surfaces more than 12 mm apart."""
    out, weight = np.zeros_like(depth), np.zeros_like(depth)
    padded = np.pad(depth, 1, mode="edge")
    for dv in (-1, 0, 1):
        for du in (-1, 0, 1):
            near = padded[1 + dv : 1 + dv + depth.shape[0], 1 + du : 1 + du + depth.shape[1]]
            bell = np.float32(np.exp(-0.5 * (du * du + dv * dv) / sigma**2))
            w = bell * (np.abs(near - depth) < 12.0)
            out += w * near
            weight += w
    return out / weight


def _lateral_jitter(depth: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    h, w = depth.shape
    shift = np.round(LATERAL_NOISE * rng.standard_normal((2, h, w), np.float32)).astype(np.int32)
    v = np.clip(np.arange(h, dtype=np.int32)[:, None] + shift[0], 0, h - 1)
    u = np.clip(np.arange(w, dtype=np.int32) + shift[1], 0, w - 1)
    return depth.ravel()[v * w + u]


def incidence(depth: np.ndarray, camera: Camera) -> np.ndarray:
    """Return the (h, w) angle between surface normal and optical axis, rad. It is computed from differences of depth."""
    size = np.maximum(depth, 1.0) / camera.fx
    slope_u = np.gradient(depth, axis=1) / size
    slope_v = np.gradient(depth, axis=0) / size
    return np.where(depth > 0, np.arctan(np.hypot(slope_u, slope_v)), 0.0)


def projector_shadow(depth: np.ndarray, camera: Camera) -> np.ndarray:
    """Find the pixels that the camera sees and the projector, ``BASELINE`` mm to its left, does not. Return (h, w) bool.

    In a rectified pair the projector sees a point at column u + f b / z; going left to right, a column that does not
    come out right of all columns before lies behind something nearer.
    """
    columns = np.arange(depth.shape[1], dtype=np.float32)
    seen = depth > 0
    at_projector = np.where(seen, columns + camera.fx * BASELINE / np.maximum(depth, 1.0), -np.inf)
    reached = np.maximum.accumulate(at_projector, axis=1)
    before = np.concatenate([np.full((len(depth), 1), -np.inf), reached[:, :-1]], axis=1)
    return seen & (at_projector < before - 0.5)


def _ragged_edges(depth: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return the (h, w) bool holes along depth edges of more than 15 mm.

    A pixel next to an edge is lost with probability 0.6.
    """
    jump = cv2.dilate(depth, np.ones((3, 3), np.uint8)) - cv2.erode(depth, np.ones((3, 3), np.uint8)) > 15.0
    return jump & (rng.random(depth.shape, np.float32) < 0.6)
