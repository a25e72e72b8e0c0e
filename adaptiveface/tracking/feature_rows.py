"""Turn the 2D features into linear constraints on points of the mesh (equations 2 and 5)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..caches.compiled import compiled
from ..geometry.camera import Camera
from ..geometry.frame import Features2D


@dataclass(frozen=True)
class FeatureRows:
    """Two rows per visible feature f: value = rows[f] @ v + offsets[f], with the feature's point v in the head frame, mm.

    The value is in px mm as in equation (2): the point's depth times its distance from the feature in pixels.

    Attributes
    ----------
    index : (f,) int
        Numbers of the visible features among the 40.
    rows : (f, 2, 3)
        Coefficients of the points.
    offsets : (f, 2)
        Constant part.
    weights : (f,)
        The confidences.
    """

    index: np.ndarray
    rows: np.ndarray
    offsets: np.ndarray
    weights: np.ndarray

    def at(self, pose: np.ndarray) -> FeatureRows:
        """Turn rows of camera-frame points into rows of head-frame points, for a ``pose`` (4, 4) head to camera."""
        return FeatureRows(self.index, self.rows @ pose[:3, :3], self.offsets + self.rows @ pose[:3, 3], self.weights)


def camera_rows(features: Features2D | None, camera: Camera) -> FeatureRows:
    """Rows of equation (2) for points in the camera frame: [1 0 -u_x; 0 1 -u_y] P for every visible feature."""
    if features is None:
        return FeatureRows(np.zeros(0, int), np.zeros((0, 2, 3)), np.zeros((0, 2)), np.zeros(0))
    index = np.flatnonzero(features.valid)
    projection = camera.matrix
    rows = projection[:2] - features.pixels[index][:, :, None] * projection[2]
    return FeatureRows(index, rows, np.zeros((len(index), 2)), features.confidence[index].astype(float))


def feature_rows(features: Features2D | None, camera: Camera, pose: np.ndarray) -> FeatureRows:
    """Rows of equation (2): [1 0 -u_x; 0 1 -u_y] P (R v + t) for every visible feature; ``pose`` (4, 4) head to camera."""
    return camera_rows(features, camera).at(pose)


@compiled
def turns(levers: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """How far a turn moves the ends of ``levers`` (f, 3) along ``directions`` (f, r, 3): their cross products (f, r, 3)."""
    out = np.empty(directions.shape)
    for f in range(directions.shape[0]):
        x, y, z = levers[f, 0], levers[f, 1], levers[f, 2]
        for r in range(directions.shape[1]):
            a, b, c = directions[f, r, 0], directions[f, r, 1], directions[f, r, 2]
            out[f, r, 0], out[f, r, 1], out[f, r, 2] = y * c - z * b, z * a - x * c, x * b - y * a
    return out


def reprojection_errors(features: Features2D, camera: Camera, points: np.ndarray) -> np.ndarray:
    """Distances (f,) of the visible features from the projections of their points (40, 3) mm in the camera frame, px."""
    seen = features.valid
    errors: np.ndarray = np.linalg.norm(camera.project(points[seen]) - features.pixels[seen], axis=1)
    return errors
