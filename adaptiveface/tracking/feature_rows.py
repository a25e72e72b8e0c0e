"""The 2D features as linear constraints on points of the mesh (equations 2 and 5)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..caches.compiled import compiled
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

    def at(self, pose: np.ndarray) -> FeatureRows:
        """From rows in the camera frame those at a ``pose`` (4, 4), head to camera: of points in the head frame."""
        return FeatureRows(self.index, self.rows @ pose[:3, :3], self.offsets + self.rows @ pose[:3, 3], self.weights)


def camera_rows(features: Features2D | None, camera: Camera) -> FeatureRows:
    """[1 0 -u_x; 0 1 -u_y] P for every seen feature: equation (2)'s rows of points in the camera frame."""
    if features is None:
        return FeatureRows(np.zeros(0, int), np.zeros((0, 2, 3)), np.zeros((0, 2)), np.zeros(0))
    index = np.flatnonzero(features.valid)
    selector = np.zeros((len(index), 2, 3))
    selector[:, 0, 0] = selector[:, 1, 1] = 1.0
    selector[:, :, 2] = -features.pixels[index]
    rows = selector @ camera.matrix
    return FeatureRows(index, rows, np.zeros((len(index), 2)), features.confidence[index].astype(float))


def feature_rows(features: Features2D | None, camera: Camera, pose: np.ndarray) -> FeatureRows:
    """Equation (2): [1 0 -u_x; 0 1 -u_y] P (R v + t) for every seen feature; ``pose`` (4, 4) head to camera."""
    return camera_rows(features, camera).at(pose)


@compiled
def turns(levers: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """(f, r, 3) ``levers`` (f, 3) x ``directions`` (f, r, 3): how far a turn moves the levers' ends along the directions."""
    out = np.empty(directions.shape)
    for f in range(directions.shape[0]):
        x, y, z = levers[f, 0], levers[f, 1], levers[f, 2]
        for r in range(directions.shape[1]):
            a, b, c = directions[f, r, 0], directions[f, r, 1], directions[f, r, 2]
            out[f, r, 0], out[f, r, 1], out[f, r, 2] = y * c - z * b, z * a - x * c, x * b - y * a
    return out


def reprojection_errors(features: Features2D, camera: Camera, points: np.ndarray) -> np.ndarray:
    """(f,) pixel distances between the seen features and their points (40, 3), camera frame mm."""
    seen = features.valid
    errors: np.ndarray = np.linalg.norm(camera.project(points[seen]) - features.pixels[seen], axis=1)
    return errors
