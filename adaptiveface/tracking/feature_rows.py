"""The 2D features as linear constraints on points of the mesh (equations 2 and 5)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..geometry.camera import Camera
from ..geometry.frame import Features2D


@dataclass(frozen=True)
class FeatureRows:
    """Two rows per seen feature f: value = rows[f] @ v + offsets[f], with v the feature's point in the head frame (mm).

    ``index`` (f,) into the 40 features; ``rows`` (f, 2, 3); ``offsets`` (f, 2); ``weights`` (f,): the confidences. The
    value is in px mm as in eq. (2): the point's depth times its distance from the feature in pixels.
    """

    index: np.ndarray
    rows: np.ndarray
    offsets: np.ndarray
    weights: np.ndarray


def feature_rows(features: Features2D | None, camera: Camera, pose: np.ndarray) -> FeatureRows:
    """Equation (2): [1 0 -u_x; 0 1 -u_y] P (R v + t) for every seen feature; ``pose`` (4, 4) head to camera."""
    if features is None:
        return FeatureRows(np.zeros(0, int), np.zeros((0, 2, 3)), np.zeros((0, 2)), np.zeros(0))
    index = np.flatnonzero(features.valid)
    selector = np.zeros((len(index), 2, 3))
    selector[:, 0, 0] = selector[:, 1, 1] = 1.0
    selector[:, :, 2] = -features.pixels[index]
    projected = selector @ camera.matrix
    return FeatureRows(index, projected @ pose[:3, :3], projected @ pose[:3, 3], features.confidence[index].astype(float))


def reprojection_errors(features: Features2D, camera: Camera, points: np.ndarray) -> np.ndarray:
    """(f,) pixel distances between the seen features and their points (40, 3), camera frame mm."""
    seen = features.valid
    errors: np.ndarray = np.linalg.norm(camera.project(points[seen]) - features.pixels[seen], axis=1)
    return errors
