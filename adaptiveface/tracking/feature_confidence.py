"""Judge by a frame's depth how far its 2D features can be trusted, so that a covered mouth does not pull at the face.

Detectors guess hidden features without saying so. The depth map shows the difference. If something is measured well in front
of the tracked skin, a hand or a cup hides the feature (a limitation that the paper states in section 8).
"""

from __future__ import annotations

import dataclasses

import numpy as np

from ..caches.compiled import compiled
from ..geometry.camera import Camera
from ..geometry.frame import FEATURE_REGIONS, RgbdFrame

#: Depth in front of the predicted skin, mm: up to the first distance it may be an expression, from the second on it covers it.
#: Lips move forward by less than this between two frames, and a finger is thicker.
COVER_FROM, COVER_TO = 8.0, 16.0


def uncovered(depth: np.ndarray, camera: Camera, points: np.ndarray, radius: int = 1) -> np.ndarray:
    """Confidences (n,) in [0, 1] of points (n, 3) mm in the camera frame: 1 if nothing lies in front of them.

    The median of the measured depth (H, W) mm in the (2 ``radius`` + 1)^2 pixels around a point decides. The confidence is 1
    if nothing is measured there, and outside the picture.
    """
    behind = _behind(depth, np.rint(camera.project(points)).astype(int), points[:, 2], radius)
    return 1.0 - np.clip((behind - COVER_FROM) / (COVER_TO - COVER_FROM), 0.0, 1.0)


@compiled
def _behind(depth: np.ndarray, pixels: np.ndarray, z: np.ndarray, radius: int) -> np.ndarray:
    """How far depths ``z`` (n,) lie behind the median of the depth around ``pixels`` (n, 2), mm; 0 if nothing is measured."""
    height, width = depth.shape
    patch, out = np.empty((2 * radius + 1) ** 2, depth.dtype), np.zeros(len(pixels))
    for i in range(len(pixels)):
        u, v, count = pixels[i, 0], pixels[i, 1], 0
        if u < 0 or v < 0 or u >= width or v >= height:
            continue
        for row in range(v - radius, v + radius + 1):
            for column in range(u - radius, u + radius + 1):
                measured = depth[min(max(row, 0), height - 1), min(max(column, 0), width - 1)]
                if measured > 0:
                    patch[count] = measured
                    count += 1
        if count:
            out[i] = z[i] - np.sort(patch[:count])[count // 2]
    return out


def weigh_features(frame: RgbdFrame, points: np.ndarray) -> RgbdFrame:
    """Lower the confidences of a frame's features that are covered.

    ``points`` (40, 3) mm are the expected places of the features in the camera frame. The uncovered features of a region also
    count less, and not at all if half of the region is covered, because a detector moves them along with those that it guesses.
    Measured with a blob 25 mm before a mouth (``tests/test_live_features.py``): the lips go astray by at most 2.8 mm,
    by 7.2 mm with the detector's own confidences.
    """
    if frame.features is None:
        return frame
    seen = uncovered(frame.depth, frame.camera, points)
    if seen.min() == 1.0:
        return frame
    weight = seen.copy()
    for region in np.unique(FEATURE_REGIONS):
        mine = FEATURE_REGIONS == region
        weight[mine] *= np.clip(1.0 - 2.0 * (1.0 - seen[mine].mean()), 0.0, 1.0)
    features = dataclasses.replace(frame.features, confidence=frame.features.confidence * weight)
    return dataclasses.replace(frame, features=features)
