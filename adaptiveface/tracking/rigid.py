"""Rigid motion tracking (section 4.1): fast projective point-to-plane ICP (Rusinkiewicz & Levoy 2001)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..mesh import rotation_vector_matrix, transform_points
from ..parameters import RigidParameters
from .depth_surface import Correspondences, DepthSurface, find_correspondences


@dataclass(frozen=True)
class RigidFit:
    """``pose`` (4, 4) head to camera; ``correspondences`` at that pose; ``residual`` their mean distance, mm."""

    pose: np.ndarray
    correspondences: Correspondences
    residual: float


def rigid_jacobian(points: np.ndarray, normals: np.ndarray, centre: np.ndarray) -> np.ndarray:
    """(n, 6) derivative of n_i^T v_i by a rotation vector about ``centre`` (first three) and a translation, camera frame."""
    return np.hstack([np.cross(points - centre, normals), normals])


def apply_rigid_update(pose: np.ndarray, update: np.ndarray, centre: np.ndarray) -> np.ndarray:
    """Turn a pose (4, 4) about ``centre`` by ``update[:3]`` (rad) and move it by ``update[3:]`` (mm)."""
    rotation = rotation_vector_matrix(update[:3])
    moved = np.eye(4)
    moved[:3, :3] = rotation @ pose[:3, :3]
    moved[:3, 3] = rotation @ (pose[:3, 3] - centre) + centre + update[3:]
    return moved


def point_to_plane_step(points: np.ndarray, correspondences: Correspondences, centre: np.ndarray,
                        vertex_weights: np.ndarray) -> np.ndarray:
    """(6,) rotation and translation that minimise sum w_i (n_i^T (v_i - p_i))^2, linearised (Chen & Medioni 1991)."""
    weights = correspondences.weights * vertex_weights
    jacobian = rigid_jacobian(points, correspondences.normals, centre)
    weighted = jacobian * weights[:, None]
    scale = np.trace(weighted.T @ jacobian) * 1e-9
    return np.linalg.solve(weighted.T @ jacobian + scale * np.eye(6), -weighted.T @ correspondences.distances)


class RigidTracker:
    """Aligns a head-frame shape to the depth map with a fixed number of ICP steps.

    ``vertex_weights`` (n,): how much each vertex counts; those that move least in expressions should lead.
    """

    def __init__(self, vertex_weights: np.ndarray, parameters: RigidParameters) -> None:
        self.vertex_weights = vertex_weights
        self.parameters = parameters

    def align(self, surface: DepthSurface, shape: np.ndarray, normals: np.ndarray, pose: np.ndarray) -> RigidFit:
        """Refine ``pose`` for a shape (n, 3) with unit normals (n, 3) in the head frame."""
        reach = self.parameters.prune
        for _ in range(self.parameters.iterations):
            points, turned = transform_points(pose, shape), normals @ pose[:3, :3].T
            matches = find_correspondences(surface, points, turned, reach)
            if matches.count < self.parameters.min_matches:
                return RigidFit(pose, matches, float("inf"))
            centre = points.mean(axis=0)
            pose = apply_rigid_update(pose, point_to_plane_step(points, matches, centre, self.vertex_weights), centre)
        matches = find_correspondences(surface, transform_points(pose, shape), normals @ pose[:3, :3].T, reach)
        return RigidFit(pose, matches, matches.mean_distance)
