"""Judge a live frame of a face for the neutral scan: head angles, expression, sharpness, depth.

The 2D features are compared with those of the model's neutral face in the same pose, so that turning the head alone changes
nothing. Lengths in pictures are given in eye distances, from outer corner to outer corner.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from ..geometry.camera import Camera
from ..geometry.frame import FEATURE_IDS, Features2D, RgbdFrame

#: The mouth is open if the gap of the lips exceeds the neutral one by this, in eye distances.
MOUTH_OPEN = 0.06
#: Tolerance of the mouth's width, as a share of the neutral one.
MOUTH_WIDTH = 0.25
#: The eyes are shut if the gap of the lids is less than this share of the neutral one.
EYES_SHUT = 0.45
#: Tolerance of the brows' distance from the eyes, in eye distances.
BROWS = 0.10


def _rows(*ids: int) -> np.ndarray:
    return np.searchsorted(FEATURE_IDS, ids)


_UPPER_LIP, _LOWER_LIP, _MOUTH = _rows(61, 62, 63), _rows(67, 66, 65), _rows(48, 54)
_UPPER_LIDS, _LOWER_LIDS, _CORNERS = _rows(37, 38, 43, 44), _rows(41, 40, 47, 46), _rows(36, 45)
_BROWS, _BROW_EYES = _rows(18, 19, 20, 23, 24, 25), _rows(36, 36, 39, 42, 45, 45)


@dataclass(frozen=True)
class Expression:
    """Deviations of a face from the neutral one, each 1 at its tolerance; the text names the worst beyond it."""

    mouth_open: float
    mouth_width: float
    eyes: float
    brows: float

    @property
    def worst(self) -> float:
        """The largest deviation."""
        return max(self.mouth_open, self.mouth_width, self.eyes, self.brows)

    @property
    def warning(self) -> str:
        """Advice on what to change, or ""."""
        texts = {
            "mouth_open": "close your mouth",
            "mouth_width": "relax your mouth",
            "eyes": "keep your eyes open",
            "brows": "relax your brows",
        }
        name = max(texts, key=lambda key: getattr(self, key))
        return texts[name] if self.worst > 1 else ""


def eye_distance(pixels: np.ndarray) -> float:
    """Distance between the outer corners of the eyes of features (40, 2), px; NaN if they are not visible."""
    return float(np.linalg.norm(np.subtract(*pixels[_CORNERS])))


def expression(features: Features2D, neutral_pixels: np.ndarray) -> Expression:
    """Compare detected features with the model's neutral ones (40, 2) projected by the frame's pose.

    Invisible features are ignored.
    """
    seen, unit = np.where(features.valid[:, None], features.pixels, np.nan), max(eye_distance(neutral_pixels), 1.0)

    def both(a: np.ndarray, b: np.ndarray) -> tuple[float, float]:
        """The gaps of the visible and of the neutral features."""
        return _gap(seen, a, b), _gap(neutral_pixels, a, b)

    lips, lips_neutral = both(_UPPER_LIP, _LOWER_LIP)
    width, width_neutral = both(_MOUTH[:1], _MOUTH[1:])
    lids, lids_neutral = both(_UPPER_LIDS, _LOWER_LIDS)
    brows, brows_neutral = both(_BROWS, _BROW_EYES)
    deviations = (
        (lips - lips_neutral) / unit / MOUTH_OPEN,
        abs(width / max(width_neutral, 1e-6) - 1) / MOUTH_WIDTH,
        (1 - lids / max(lids_neutral, 1e-6)) / (1 - EYES_SHUT),
        abs(brows - brows_neutral) / unit / BROWS,
    )
    return Expression(*(max(float(d), 0.0) if np.isfinite(d) else 0.0 for d in deviations))


def _gap(pixels: np.ndarray, a: np.ndarray, b: np.ndarray) -> float:
    """Mean distance of the features ``a`` from ``b``, px; NaN if none is visible."""
    lengths = np.linalg.norm(pixels[a] - pixels[b], axis=1)
    lengths = lengths[np.isfinite(lengths)]
    return float(lengths.mean()) if len(lengths) else float("nan")


def sharpness(frame: RgbdFrame) -> float:
    """Variance of the Laplacian of the colour image around the features; NaN without colour.

    Pech-Pacheco et al. 2000; meaningful only against other frames of the same scene.
    """
    if frame.colour is None or frame.features is None or not frame.features.valid.any():
        return float("nan")
    height, width = frame.colour.shape[:2]
    left, top, right, bottom = np.round(frame.features.bounding_box).astype(int)
    crop = frame.colour[max(top, 0) : min(bottom + 1, height), max(left, 0) : min(right + 1, width)]
    if min(crop.shape[:2]) < 8:
        return float("nan")
    return float(cv2.Laplacian(cv2.cvtColor(crop, cv2.COLOR_RGB2GRAY), cv2.CV_32F).var())


def head_angles(pose: np.ndarray) -> tuple[float, float]:
    """Angles of a head-to-camera pose (4, 4) to the person's left and upwards from the line to the camera, degrees."""
    out, towards = pose[:3, 2], -pose[:3, 3] / max(np.linalg.norm(pose[:3, 3]), 1e-9)
    yaw = np.arctan2(out[0], -out[2]) - np.arctan2(towards[0], -towards[2])
    pitch = np.arcsin(np.clip(-out[1], -1, 1)) - np.arcsin(np.clip(-towards[1], -1, 1))
    return float(np.degrees(yaw)), float(np.degrees(pitch))


def seen_by_depth(depth: np.ndarray, camera: Camera, points: np.ndarray, normals: np.ndarray, reach: float) -> np.ndarray:
    """Which camera-frame points face the camera and have measured depth within ``reach`` mm of their own, (n,) bool."""
    facing = np.einsum("nd,nd->n", points, normals) < -0.25 * np.linalg.norm(points, axis=1)
    u, v = np.rint(camera.project(points)).astype(int).T
    inside: np.ndarray = facing & (u >= 0) & (v >= 0) & (u < camera.width) & (v < camera.height)
    measured = depth[v[inside], u[inside]]
    inside[inside] = (measured > 0) & (np.abs(measured - points[inside, 2]) < reach)
    return inside
