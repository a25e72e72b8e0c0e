"""How far the 2D features of a frame can be trusted, judged by its depth: a covered mouth must not pull at the face.

Detectors guess what is hidden, and say nothing. The depth map knows better: where something is measured well in front
of the tracked skin, a hand or a cup is seen instead of the feature (the paper's stated limitation, section 8).
"""

from __future__ import annotations

import dataclasses

import numpy as np

from ..geometry.camera import Camera
from ..geometry.frame import FEATURE_REGIONS, RgbdFrame

#: Depth in front of the predicted skin: up to the first it may be an expression, from the second on it covers it, mm.
#: Between two frames lips come forward by less; a finger is thicker.
COVER_FROM, COVER_TO = 8.0, 16.0


def uncovered(depth: np.ndarray, camera: Camera, points: np.ndarray, radius: int = 1) -> np.ndarray:
    """(n,) in [0, 1]: 1 where nothing lies in front of points (n, 3) mm, camera frame, in the depth map (H, W) mm.

    The median of what is measured in the (2 ``radius`` + 1)^2 pixels about the point decides; where nothing is, or
    outside the picture, 1.
    """
    step = np.arange(-radius, radius + 1)
    pixels = np.rint(camera.project(points)).astype(int)
    u = np.clip(pixels[:, 0, None, None] + step, 0, depth.shape[1] - 1)
    v = np.clip(pixels[:, 1, None, None] + step[:, None], 0, depth.shape[0] - 1)
    inside = (pixels >= 0).all(axis=1) & (pixels < [depth.shape[1], depth.shape[0]]).all(axis=1)
    patch = np.sort(depth[v, u].reshape(len(points), -1), axis=1)
    missing = (patch == 0).sum(axis=1)  # sorted to the front
    middle = np.minimum(missing + (patch.shape[1] - missing) // 2, patch.shape[1] - 1)
    measured = patch[np.arange(len(points)), middle]
    behind = np.where(inside & (measured > 0), points[:, 2] - measured, 0.0)
    return 1.0 - np.clip((behind - COVER_FROM) / (COVER_TO - COVER_FROM), 0.0, 1.0)


def weigh_features(frame: RgbdFrame, points: np.ndarray) -> RgbdFrame:
    """The frame with its features' confidences lowered where they are covered.

    points (40, 3) mm, camera frame: where the features are expected. What of a region is left uncovered counts less as
    well, down to nothing when half of it is covered: a detector moves the seen part along with the part it guesses.
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
