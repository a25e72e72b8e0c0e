"""Register one depth frame rigidly to a model surface by fast ICP (Rusinkiewicz & Levoy 2001; paper, section 3).

It is fast because of projective data association: a model point is matched with the depth pixel to which it projects, so that
no search tree is needed. The metric is point-to-plane. Poses are (4, 4) matrices from the model frame to the camera frame, mm.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from ..geometry.camera import Camera
from ..geometry.frame import Features2D, RgbdFrame
from ..geometry.mesh import rotation_vector_matrix, transform_points
from ..parameters import FusionParameters
from ..registration.icp import icp, last
from ..registration.step import motion_of, rigid_jacobian

MIN_CORRESPONDENCES = 200
_CONVERGED = 0.05  # mm; smaller changes of the nearest pixels are random
_DEPTH_JUMP = 10.0  # mm between neighbouring pixels; a larger step is an occlusion boundary with unreliable depth and normals


@dataclass(frozen=True)
class DepthView:
    """The head's part of a depth frame, which registration and integration read.

    Attributes
    ----------
    camera : Camera
        Of the cropped image (h, w).
    points : (h, w, 3)
        From the measured depth, camera frame, mm.
    normals : (h, w, 3)
        Unit normals towards the camera, from the smoothed depth.
    valid : (h, w) bool
        Measured, with a normal, and away from depth boundaries.
    """

    camera: Camera
    points: np.ndarray
    normals: np.ndarray
    valid: np.ndarray

    @property
    def noise(self) -> float:
        """Median of the second differences along the rows, mm, which is the noise of a pixel; 0 without three neighbours."""
        depth, valid = self.points[..., 2], self.valid
        together = valid[:, 2:] & valid[:, 1:-1] & valid[:, :-2]
        bends = (depth[:, 2:] - 2.0 * depth[:, 1:-1] + depth[:, :-2])[together]
        return float(np.median(np.abs(bends - np.median(bends))) / np.sqrt(6.0)) if len(bends) else 0.0


@dataclass(frozen=True)
class Registration:
    """The result of :func:`align`.

    Attributes
    ----------
    pose : (4, 4)
        Model frame to camera frame, mm.
    residual : float
        Median absolute point-to-plane distance, mm.
    overlap : float
        Share of the model points turned to the camera that have a match.
    correspondences : int
        Number of matches.
    """

    pose: np.ndarray
    residual: float
    overlap: float
    correspondences: int


@dataclass(frozen=True)
class Pairs:
    """Correspondences of n model points, camera frame.

    Attributes
    ----------
    points, normals : (n, 3)
        Points of the model, mm, and their unit normals.
    distances : (n,)
        Signed distances from the depth along the model's normals, mm.
    cosines : (n,)
        Of the viewing angle.
    visible : int
        Number of model points that are turned to the camera.
    """

    points: np.ndarray
    normals: np.ndarray
    distances: np.ndarray
    cosines: np.ndarray
    visible: int


def depth_view(frame: RgbdFrame, pose: np.ndarray, box: np.ndarray) -> DepthView | None:
    """Crop a frame to the pixels inside ``box`` (2, 3), whose corners are in the model frame, mm, at ``pose``.

    The result is None if the box lies outside the image or contains no depth.
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
    # A steep but continuous surface also makes large steps, so steps that its slope explains are allowed.
    step = 2.0 * depth / camera.fx / np.maximum(slope, 0.1)
    valid = (nearest > 0) & (farthest - nearest < np.maximum(_DEPTH_JUMP, 1.5 * step)) & (length > 0)
    return (rays * depth[..., None]).astype(np.float32), normals.astype(np.float32), valid


def align(
    view: DepthView, points: np.ndarray, normals: np.ndarray, pose: np.ndarray, parameters: FusionParameters
) -> Registration:
    """Register the model surface to a depth view.

    Each iteration pairs every model point that is turned to the camera with the pixel to which it projects. It rejects pairs
    by distance, normal and boundary, and takes one Gauss-Newton step on the robust point-to-plane energy.

    Parameters
    ----------
    view : DepthView
        The measured depth.
    points, normals : (n, 3)
        Points of the model surface in the model frame, mm, and their unit normals.
    pose : (4, 4)
        The start, model frame to camera frame, mm.
    parameters : FusionParameters
        Limits and the number of iterations.

    Returns
    -------
    Registration
        The last pose, and how well it fits.
    """
    limit = parameters.max_correspondence_distance

    def associate(pose: np.ndarray) -> Pairs:
        return correspondences(view, points, normals, pose, limit, parameters)

    def advance(pose: np.ndarray, pairs: Pairs) -> tuple[np.ndarray, float]:
        nonlocal limit
        scale = max(3.0 * 1.4826 * float(np.median(np.abs(pairs.distances))), 1.0)
        step, motion = _point_to_plane_step(pairs, scale)
        limit = float(np.clip(4.0 * scale, 5.0, parameters.max_correspondence_distance))
        return step @ pose, motion

    found = last(icp(pose, associate, advance, _count, MIN_CORRESPONDENCES, parameters.iterations, _CONVERGED))
    return evaluate(view, found.pose, points, normals, parameters)


def _count(pairs: Pairs) -> int:
    return len(pairs.distances)


def evaluate(
    view: DepthView, pose: np.ndarray, points: np.ndarray, normals: np.ndarray, parameters: FusionParameters
) -> Registration:
    """Measure how well a pose fits the model surface to a depth view."""
    pairs = correspondences(view, points, normals, pose, parameters.max_correspondence_distance, parameters)
    count = len(pairs.distances)
    overlap = count / max(pairs.visible, 1)
    if count < MIN_CORRESPONDENCES:
        return Registration(pose, float("inf"), overlap, count)
    return Registration(pose, float(np.median(np.abs(pairs.distances))), overlap, count)


def correspondences(
    view: DepthView, points: np.ndarray, normals: np.ndarray, pose: np.ndarray, limit: float, parameters: FusionParameters
) -> Pairs:
    """Projective data association of model points, normals (n, 3) with the pixels of a view.

    Matches farther than ``limit`` mm, invalid pixels, boundary pixels and normals that disagree are rejected.
    """
    turned = normals @ pose[:3, :3].T
    moved = transform_points(pose, points)
    cosine = -_dot(moved, turned) / np.sqrt(_dot(moved, moved))
    facing = np.flatnonzero(cosine > parameters.min_cosine)
    moved, turned, cosine = moved[facing], turned[facing], cosine[facing]
    column, row = np.rint(view.camera.project(moved)).astype(int).T
    inside = (column >= 0) & (row >= 0) & (column < view.camera.width) & (row < view.camera.height)
    inside[inside] = view.valid[row[inside], column[inside]]
    moved, turned, row, column = moved[inside], turned[inside], row[inside], column[inside]
    offset = moved - view.points[row, column]
    agree = _dot(view.normals[row, column], turned) > np.cos(np.radians(parameters.max_normal_angle))
    keep = agree & (_dot(offset, offset) < limit**2)
    return Pairs(moved[keep], turned[keep], _dot(offset[keep], turned[keep]), cosine[inside][keep], len(facing))


def _dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    products: np.ndarray = np.einsum("nd,nd->n", a, b)
    return products


def _point_to_plane_step(pairs: Pairs, scale: float) -> tuple[np.ndarray, float]:
    """Find the small motion (4, 4) that minimises sum w (n . (omega x p + t) + d)^2 (Chen & Medioni 1992), and its size, mm.

    The weight w is the cosine of the viewing angle, because grazing depth is noisy, times Tukey's weight for ``scale``.
    """
    weight = pairs.cosines * np.clip(1.0 - (pairs.distances / (1.5 * scale)) ** 2, 0.0, None) ** 2
    centre = pairs.points.mean(axis=0)
    rows = rigid_jacobian(pairs.points, pairs.normals, centre)
    lhs = rows.T @ (rows * weight[:, None])
    lhs[np.diag_indices(6)] += 1e-9 * np.trace(lhs)
    solution = np.linalg.solve(lhs, -rows.T @ (weight * pairs.distances))
    step = np.eye(4)
    step[:3, :3] = rotation_vector_matrix(solution[:3])
    step[:3, 3] = centre + solution[3:] - step[:3, :3] @ centre
    return step, motion_of(solution)


def feature_pose(frame: RgbdFrame, feature_points: np.ndarray, features: Features2D | None = None) -> np.ndarray | None:
    """Find the pose (4, 4) of a head with features at ``feature_points`` (40, 3) mm from 2D features; None if unseen.

    Perspective-n-point gives the rotation. The measured depth then gives the distance, because the size of the head is
    unknown.
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
