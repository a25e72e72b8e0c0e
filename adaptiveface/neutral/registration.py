"""Rigid registration of one depth frame to a model surface by fast ICP (Rusinkiewicz & Levoy 2001; paper, section 3).

"Fast" is projective data association: a model point meets the depth pixel it projects to, so no search tree is needed;
the metric is point-to-plane. Poses are (4, 4) matrices that bring model points into the camera frame, millimetres.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from ..camera import Camera
from ..frame import Features2D, RgbdFrame
from ..mesh import rotation_vector_matrix, transform_points
from ..parameters import FusionParameters

MIN_CORRESPONDENCES = 200
_DEPTH_JUMP = 10.0  # mm between neighbouring pixels: an occlusion boundary, where depth and normal are unreliable


@dataclass(frozen=True)
class DepthView:
    """The head's part of a depth frame: what registration and integration read.

    camera: of the cropped image (h, w); points (h, w, 3) mm, from the measured depth; normals (h, w, 3) unit, towards
    the camera, from the smoothed depth; valid (h, w) bool: measured, with a normal, away from depth boundaries.
    """

    camera: Camera
    points: np.ndarray
    normals: np.ndarray
    valid: np.ndarray


@dataclass(frozen=True)
class Registration:
    """Result of :func:`align`.

    pose (4, 4); residual: median absolute point-to-plane distance, mm; overlap: share of the model points turned to the
    camera that found a partner; correspondences: their number.
    """

    pose: np.ndarray
    residual: float
    overlap: float
    correspondences: int


def depth_view(frame: RgbdFrame, pose: np.ndarray, box: np.ndarray) -> DepthView | None:
    """The pixels of ``frame`` that lie in ``box`` (2, 3) (corners in the model frame, mm) under ``pose``.

    None when the box falls outside the image or holds no depth.
    """
    corners = np.array([[box[i, 0], box[j, 1], box[k, 2]] for i in (0, 1) for j in (0, 1) for k in (0, 1)])
    corners = transform_points(pose, corners)
    if corners[:, 2].min() <= 1.0:
        return None
    camera, pixels = frame.camera, frame.camera.project(corners)
    left, top = np.maximum(np.floor(pixels.min(axis=0)).astype(int), 0)
    right, bottom = np.minimum(np.ceil(pixels.max(axis=0)).astype(int) + 1, [camera.width, camera.height])
    if right - left < 8 or bottom - top < 8:
        return None
    depth = frame.depth[top:bottom, left:right].astype(np.float32)
    depth = np.where((depth > corners[:, 2].min()) & (depth < corners[:, 2].max()), depth, np.float32(0.0))
    crop = Camera(right - left, bottom - top, camera.fx, camera.fy, camera.cx - left, camera.cy - top)
    points, normals, valid = _surface(depth, crop)
    head = (transform_points(np.linalg.inv(pose), points.reshape(-1, 3)) - box[0]) / (box[1] - box[0])
    valid &= ((head > 0) & (head < 1)).all(axis=1).reshape(valid.shape)
    return DepthView(crop, points, normals, valid) if valid.any() else None


def _surface(depth: np.ndarray, camera: Camera) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points (h, w, 3), normals (h, w, 3) and validity (h, w) of a cropped depth image (h, w), 0 = no measurement."""
    rays = camera.rays()
    smooth = cv2.bilateralFilter(depth, d=7, sigmaColor=4.0, sigmaSpace=2.0).astype(float)
    surface = rays * smooth[..., None]
    across, down = np.zeros_like(surface), np.zeros_like(surface)
    across[:, 1:-1] = surface[:, 2:] - surface[:, :-2]
    down[1:-1] = surface[2:] - surface[:-2]
    normals = np.cross(down, across)
    length = np.linalg.norm(normals, axis=2)
    normals /= np.maximum(length, 1e-12)[..., None]
    kernel = np.ones((3, 3), np.uint8)
    nearest = cv2.erode(depth, kernel, borderValue=0)
    farthest = cv2.dilate(depth, kernel)
    slope = np.abs((normals * rays).sum(axis=2)) / np.linalg.norm(rays, axis=2)
    # A steep but continuous surface also makes large steps: allow what its slope explains.
    step = 2.0 * depth / camera.fx / np.maximum(slope, 0.1)
    valid = (nearest > 0) & (farthest - nearest < np.maximum(_DEPTH_JUMP, 1.5 * step)) & (length > 0)
    return rays * depth[..., None].astype(float), normals, valid


def align(
    view: DepthView, points: np.ndarray, normals: np.ndarray, pose: np.ndarray, parameters: FusionParameters
) -> Registration:
    """Register the model surface ``points``, ``normals`` (n, 3) to a depth view, from the starting ``pose``.

    Each iteration pairs every model point turned to the camera with the pixel it projects to, rejects pairs by distance,
    normal and boundary, and takes one Gauss-Newton step on the robust point-to-plane energy.
    """
    limit = parameters.prune
    residual, overlap, count = float("inf"), 0.0, 0
    for _ in range(parameters.iterations):
        moved, turned, found, distance, weight = correspondences(view, points, normals, pose, limit, parameters)
        visible = int((turned[:, 2] < 0).sum())
        count, overlap = len(found), len(found) / max(visible, 1)
        if count < MIN_CORRESPONDENCES:
            return Registration(pose, float("inf"), overlap, count)
        residual = float(np.median(np.abs(distance)))
        # Outliers beyond three robust standard deviations lose their say as the alignment settles (Tukey 1977).
        scale = max(3.0 * 1.4826 * residual, 1.0)
        weight = weight * np.clip(1.0 - (distance / (1.5 * scale)) ** 2, 0.0, None) ** 2
        step = _point_to_plane_step(moved[found], turned[found], distance, weight)
        pose = step @ pose
        limit = float(np.clip(4.0 * scale, 5.0, parameters.prune))
        if np.abs(step - np.eye(4)).max() < 2e-4:
            break
    return Registration(pose, residual, overlap, count)


def correspondences(view: DepthView, points, normals, pose, limit: float, parameters: FusionParameters):
    """Projective data association of model points (n, 3) with the pixels of a view.

    Returns the moved points and normals (n, 3), the numbers of those that found a partner, their signed distances to
    the partner along the normal (mm) and their weights (the cosine of the viewing angle: grazing depth is noisy).
    """
    moved, turned = transform_points(pose, points), normals @ pose[:3, :3].T
    pixels = np.rint(view.camera.project(moved)).astype(int)
    cosine = -(moved * turned).sum(axis=1) / np.linalg.norm(moved, axis=1)
    inside = (pixels >= 0).all(axis=1) & (pixels < [view.camera.width, view.camera.height]).all(axis=1)
    found = np.flatnonzero(inside & (cosine > parameters.min_cosine))
    column, row = pixels[found].T
    partner, partner_normal = view.points[row, column], view.normals[row, column]
    offset = moved[found] - partner
    agree = (partner_normal * turned[found]).sum(axis=1) > np.cos(np.radians(parameters.normal_angle))
    keep = view.valid[row, column] & agree & ((offset**2).sum(axis=1) < limit**2)
    found = found[keep]
    return moved, turned, found, (offset[keep] * turned[found]).sum(axis=1), cosine[found]


def _point_to_plane_step(points, normals, distance, weight) -> np.ndarray:
    """(4, 4) small motion that minimises sum w (n . (omega x p + t) + d)^2 (Chen & Medioni 1992), about the centroid."""
    centre = points.mean(axis=0)
    rows = np.concatenate([np.cross(points - centre, normals), normals], axis=1)
    lhs = rows.T @ (rows * weight[:, None])
    lhs[np.diag_indices(6)] += 1e-9 * np.trace(lhs)
    solution = np.linalg.solve(lhs, -rows.T @ (weight * distance))
    step = np.eye(4)
    step[:3, :3] = rotation_vector_matrix(solution[:3])
    step[:3, 3] = centre + solution[3:] - step[:3, :3] @ centre
    return step


def feature_pose(frame: RgbdFrame, feature_points: np.ndarray, features: Features2D | None = None) -> np.ndarray | None:
    """(4, 4) pose of a head whose features sit at ``feature_points`` (40, 3), from one frame's 2D features; None if unseen.

    Perspective-n-point gives the rotation; measured depth then fixes the distance, which the unknown size of the head
    leaves open.
    """
    features = frame.features if features is None else features
    if features is None or features.valid.sum() < 8:
        return None
    seen = features.valid
    camera = frame.camera
    ok, rotation, translation = cv2.solvePnP(
        feature_points[seen], features.pixels[seen], camera.matrix, None, flags=cv2.SOLVEPNP_SQPNP
    )
    if not ok or not np.isfinite(translation).all() or translation[2, 0] <= 0:
        return None
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = cv2.Rodrigues(rotation)[0], translation[:, 0]
    pixels = np.clip(np.rint(features.pixels[seen]).astype(int), 0, [camera.width - 1, camera.height - 1])
    depth = frame.depth[pixels[:, 1], pixels[:, 0]]
    measured = depth > 0
    if measured.sum() >= 5:
        expected = transform_points(pose, feature_points[seen])[measured, 2]
        pose[:3, 3] += np.median(depth[measured] - expected) * pose[:3, 3] / pose[2, 3]
    return pose
