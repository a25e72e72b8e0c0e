"""Rigid motion tracking (section 4.1): fast projective point-to-plane ICP (Rusinkiewicz & Levoy 2001)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..caches.compiled import compiled
from ..mesh import rotation_vector_matrix, transform_points
from ..parameters import RigidParameters
from .depth_surface import Correspondences, DepthSurface, find_correspondences

#: A rotation moves the face by about this much per radian, mm.
FACE_RADIUS = 100.0


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


@compiled
def _point_to_plane_equations(points, normals, distances, weights, centre):
    """Normal equations of :func:`rigid_jacobian` without storing it (tested equal to the NumPy form)."""
    h, g, row = np.zeros((6, 6)), np.zeros(6), np.zeros(6)
    for i in range(len(points)):
        if weights[i] == 0.0:
            continue
        x, y, z = points[i, 0] - centre[0], points[i, 1] - centre[1], points[i, 2] - centre[2]
        a, b, c = normals[i, 0], normals[i, 1], normals[i, 2]
        row[0], row[1], row[2] = y * c - z * b, z * a - x * c, x * b - y * a
        row[3], row[4], row[5] = a, b, c
        for j in range(6):
            weighted = weights[i] * row[j]
            g[j] -= weighted * distances[i]
            for k in range(j, 6):
                h[j, k] += weighted * row[k]
    for j in range(6):
        for k in range(j):
            h[j, k] = h[k, j]
    return h, g


def point_to_plane_step(
    points: np.ndarray, correspondences: Correspondences, centre: np.ndarray, vertex_weights: np.ndarray
) -> np.ndarray:
    """(6,) rotation and translation that minimise sum w_i (n_i^T (v_i - p_i))^2, linearised (Chen & Medioni 1991).

    With J of :func:`rigid_jacobian` and W the product of match and vertex weights: (J^T W J) step = -J^T W distances.
    """
    weights = correspondences.weights * vertex_weights
    h, g = _point_to_plane_equations(points, correspondences.normals, correspondences.distances, weights, centre)
    return np.linalg.solve(h + np.trace(h) * 1e-12 * np.eye(6), g)


class RigidTracker:
    """Aligns a head-frame shape to the depth map by a few ICP steps, until they move it no more.

    ``vertex_weights`` (n,): how much each vertex counts; those that move least in expressions should lead.
    """

    def __init__(self, vertex_weights: np.ndarray, parameters: RigidParameters) -> None:
        self.vertex_weights = vertex_weights
        self.parameters = parameters

    def align(self, surface: DepthSurface, shape: np.ndarray, normals: np.ndarray, pose: np.ndarray) -> RigidFit:
        """Refine ``pose`` for a shape (n, 3) with unit normals (n, 3) in the head frame."""
        reach, middle = self.parameters.prune, shape.mean(axis=0)
        for _ in range(self.parameters.iterations):
            matches = find_correspondences(surface, shape, normals, reach, pose)
            if matches.count < self.parameters.min_matches:
                return RigidFit(pose, matches, float("inf"))
            centre = transform_points(pose, middle)
            robust = self.vertex_weights / (1.0 + (matches.distances / self.parameters.outlier) ** 2)
            step = point_to_plane_step(matches.points, matches, centre, robust)
            pose = apply_rigid_update(pose, step, centre)
            if FACE_RADIUS * np.linalg.norm(step[:3]) + np.linalg.norm(step[3:]) < self.parameters.converged:
                break
        matches = find_correspondences(surface, shape, normals, reach, pose)
        return RigidFit(pose, matches, matches.mean_distance)
