"""Find the head pose from the 2D features alone, at the start and after a loss (section 4.1)."""

from __future__ import annotations

import cv2
import numpy as np

from ..geometry.frame import RgbdFrame
from ..geometry.mesh import rigid_alignment, transform_points
from .feature_rows import reprojection_errors

#: Number of features with depth that is needed to measure a face's size, and the smallest useful distance of a pair, mm.
MIN_LIFTED, FAR_APART = 12, 25.0


def lift_features(frame: RgbdFrame, radius: int = 2) -> tuple[np.ndarray, np.ndarray]:
    """Lift the 2D features that have depth into space.

    Parameters
    ----------
    frame : RgbdFrame
        With features.
    radius : int
        The depth of a feature is the median of the measured pixels within this distance, pixels.

    Returns
    -------
    indices : (f,) int
        Numbers of the features that could be lifted.
    points : (f, 3)
        Their places in the camera frame, mm.
    """
    indices, points = [], []
    height, width = frame.depth.shape
    features = frame.seen
    for index in np.flatnonzero(features.valid):
        u, v = features.pixels[index]
        iu, iv = int(round(u)), int(round(v))
        if not (0 <= iu < width and 0 <= iv < height):
            continue
        patch = frame.depth[max(iv - radius, 0) : iv + radius + 1, max(iu - radius, 0) : iu + radius + 1]
        measured = patch[patch > 0]
        if len(measured) >= 3:
            indices.append(index)
            points.append(frame.camera.back_project(np.array([u, v]), np.median(measured)))
    return np.array(indices, int), np.array(points).reshape(-1, 3)


def pose_from_features(frame: RgbdFrame, feature_points: np.ndarray, max_error: float = 25.0) -> np.ndarray | None:
    """Find the pose that brings the head's features onto those of the frame (section 4.1: start and recovery).

    The features that have depth are aligned rigidly, and the worst ones (in holes or hair) are dropped. If most features lack
    depth, perspective-n-point from the pixels alone is used instead (SQPnP of OpenCV).

    Parameters
    ----------
    frame : RgbdFrame
        With or without features.
    feature_points : (40, 3)
        The features on the head, head frame, mm.
    max_error : float
        Lifted features with larger errors are dropped, mm.

    Returns
    -------
    (4, 4) or None
        Head frame to camera frame, mm. None if no pose is found.
    """
    if frame.features is None or frame.features.valid.sum() < 6:
        return None
    indices, points = lift_features(frame)
    if len(indices) >= 8:
        keep = np.ones(len(indices), bool)
        for _ in range(3):
            pose = rigid_alignment(feature_points[indices[keep]], points[keep])
            error = np.linalg.norm(transform_points(pose, feature_points[indices]) - points, axis=1)
            keep = error <= max(2.0 * np.median(error), 3.0)
        if np.median(error) < max_error:
            return pose
    seen = frame.features.valid
    found, turn, shift = cv2.solvePnP(
        feature_points[seen], frame.features.pixels[seen], frame.camera.matrix, None, flags=cv2.SOLVEPNP_SQPNP
    )
    if not found or not 100.0 < float(shift[2, 0]) < 5000.0:
        return None
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = cv2.Rodrigues(turn)[0], shift.ravel()
    error = reprojection_errors(frame.features, frame.camera, transform_points(pose, feature_points))
    return pose if np.median(error) < 20.0 else None


def measured_size(frame: RgbdFrame, feature_points: np.ndarray) -> float:
    """Compare the size of the face in the depth map with that of a head.

    The result is the median ratio of the distances between features, which are measured in the depth map and on the head. It
    needs no pose, and a wrong unit of depth multiplies it.

    Parameters
    ----------
    frame : RgbdFrame
        With or without features.
    feature_points : (40, 3)
        The features on the head, mm.

    Returns
    -------
    float
        Size of the face divided by that of the head; NaN if it is unknown.
    """
    if frame.features is None or frame.depth.shape != (frame.camera.height, frame.camera.width):
        return float("nan")
    indices, points = lift_features(frame)
    if len(indices) < MIN_LIFTED:
        return float("nan")
    expected, measured = (np.linalg.norm(p[:, None] - p[None], axis=2) for p in (feature_points[indices], points))
    far = np.triu(expected > FAR_APART)
    if far.sum() < MIN_LIFTED:
        return float("nan")
    return float(np.median(measured[far] / expected[far]))
