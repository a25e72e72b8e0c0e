"""Make the point-to-plane step of rigid ICP (Chen & Medioni 1991), for every alignment of a shape with a depth map."""

from __future__ import annotations

import numpy as np

from ..caches.compiled import compiled
from ..geometry.mesh import rotation_vector_matrix
from .association import Correspondences

#: A rotation moves the face by about this much per radian, mm.
FACE_RADIUS = 100.0


def motion_of(update: np.ndarray) -> float:
    """How far an update (6,), rotation vector (rad) and translation (mm), moves the skin, mm."""
    return float(FACE_RADIUS * np.linalg.norm(update[:3]) + np.linalg.norm(update[3:]))


def rigid_jacobian(points: np.ndarray, normals: np.ndarray, centre: np.ndarray) -> np.ndarray:
    """Derivatives (n, 6) of n_i^T v_i by a rotation vector about ``centre`` and by a translation, camera frame."""
    return np.hstack([np.cross(points - centre, normals), normals])


def apply_rigid_update(pose: np.ndarray, update: np.ndarray, centre: np.ndarray) -> np.ndarray:
    """Turn a pose (4, 4) about ``centre`` by ``update[:3]`` (rad) and move it by ``update[3:]`` (mm)."""
    rotation = rotation_vector_matrix(update[:3])
    moved = np.eye(4)
    moved[:3, :3] = rotation @ pose[:3, :3]
    moved[:3, 3] = rotation @ (pose[:3, 3] - centre) + centre + update[3:]
    return moved


@compiled
def _point_to_plane_equations(
    points: np.ndarray, normals: np.ndarray, distances: np.ndarray, weights: np.ndarray, centre: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Normal equations of :func:`rigid_jacobian`, without storing it. A test compares them with the NumPy form."""
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
    """One step of point-to-plane ICP, linearised (Chen & Medioni 1991).

    It minimises sum w_i (n_i^T (v_i - p_i))^2. With J of :func:`rigid_jacobian`, and W the product of match and vertex
    weights, the step solves (J^T W J) step = -J^T W distances.

    Parameters
    ----------
    points : (n, 3)
        The v_i, camera frame, mm.
    correspondences : Correspondences
        Distances, normals n_i and weights of the matches.
    centre : (3,)
        Centre of the rotation, mm.
    vertex_weights : (n,)
        Weight of each vertex.

    Returns
    -------
    (6,)
        Rotation vector, rad, and translation, mm.
    """
    weights = correspondences.weights * vertex_weights
    h, g = _point_to_plane_equations(points, correspondences.normals, correspondences.distances, weights, centre)
    return np.linalg.solve(h + np.trace(h) * 1e-12 * np.eye(6), g)
