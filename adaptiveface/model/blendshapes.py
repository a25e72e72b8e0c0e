"""Personal blendshapes by deformation transfer (Sumner & Popovic 2004; paper, section 3).

Every source triangle's change from the neutral to an expression is a (3, 3) affine map S: it takes the two edges and
the scaled normal (towards the fourth vertex of Sumner & Popovic) to their deformed counterparts. The target's
expression is the mesh whose triangles change alike: min sum_t area_t |G_t x - S_t P_t|^2, with G_t x the tangential
gradient of the unknown vertex positions x and P_t the projection on the triangle's plane. The fourth vertices are
thereby eliminated, and the matrix depends on the target's neutral alone: one factorisation serves every expression.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from ..geometry.mesh import triangle_normals

#: mm; a vertex whose source displacement stays below this in every expression is held where it is.
STILL = 1e-6
# Pull towards the source's displacement, against the squared cotangent weights of order 1. It only decides what the
# gradients leave open (a part without any still vertex), and keeps the transfer exact where target and source agree.
_ANCHOR = 1e-6


def deformation_transfer(
    source: np.ndarray, target: np.ndarray, triangles: np.ndarray, displacements: np.ndarray
) -> np.ndarray:
    """Displacements (A, V, 3) mm of the ``target`` (V, 3) that mimic the ``source``'s.

    source (V, 3): neutral of the head that ``displacements`` (A, V, 3) belong to; triangles (T, 3): of both. Vertices
    that no source expression moves do not move. Exact (to rounding) when target and source agree.
    """
    moving = np.flatnonzero(np.linalg.norm(displacements, axis=2).max(axis=0, initial=0.0) > STILL)
    result = np.zeros_like(displacements, dtype=float)
    if len(moving) == 0:
        return result
    touched = triangles[np.isin(triangles, moving).any(axis=1)]
    gradient, area = gradient_operator(target, touched)
    weighted = gradient.T @ sp.diags(np.repeat(area, 3))
    system = (weighted @ gradient)[moving][:, moving] + _ANCHOR * sp.identity(len(moving))
    solver = splu(system.tocsc(), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
    rhs = np.empty((len(moving), len(displacements), 3))
    for number, displacement in enumerate(displacements):
        change = deformation_gradients(source, source + displacement, touched) - np.eye(3)
        wanted = change @ _plane_projections(target, touched)
        # gradient rows hold (d/dx, d/dy, d/dz) of each coordinate: the transpose of the affine map.
        rhs[:, number] = (weighted @ wanted.transpose(0, 2, 1).reshape(-1, 3))[moving]
        rhs[:, number] += _ANCHOR * displacement[moving]
    solved = solver.solve(rhs.reshape(len(moving), -1)).reshape(rhs.shape)
    result[:, moving] = solved.transpose(1, 0, 2)
    return result


def deformation_gradients(neutral: np.ndarray, deformed: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """(T, 3, 3) affine maps that take each neutral triangle's frame to its deformed one."""
    return _frames(deformed, triangles) @ np.linalg.inv(_frames(neutral, triangles))


def _frames(vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """(T, 3, 3): columns are two edges and the normal, scaled by the root of its length (Sumner & Popovic, eq. 1)."""
    a, b, c = (vertices[triangles[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    scaled = normal / np.sqrt(np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12))
    return np.stack([b - a, c - a, scaled], axis=2)


def _plane_projections(vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """(T, 3, 3) projections I - n n^T on the triangles' planes."""
    normal = triangle_normals(vertices, triangles)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    return np.eye(3) - normal[:, :, None] * normal[:, None, :]


def gradient_operator(vertices: np.ndarray, triangles: np.ndarray) -> tuple[sp.csr_matrix, np.ndarray]:
    """(3 T, V) operator: values at the vertices -> their gradient in every triangle (per mm); areas (T,) mm^2."""
    normal = triangle_normals(vertices, triangles)
    double_area = np.maximum(np.linalg.norm(normal, axis=1), 1e-12)
    normal = normal / double_area[:, None]
    rows = np.arange(3 * len(triangles)).reshape(-1, 3)
    parts = []
    for k in range(3):
        opposite = vertices[triangles[:, (k + 2) % 3]] - vertices[triangles[:, (k + 1) % 3]]
        parts.append(np.cross(normal, opposite) / double_area[:, None])
    data = np.stack(parts, axis=2)  # (T, xyz, corner)
    columns = np.broadcast_to(triangles[:, None, :], data.shape)
    row_index = np.broadcast_to(rows[:, :, None], data.shape)
    shape = (3 * len(triangles), len(vertices))
    return sp.coo_matrix((data.ravel(), (row_index.ravel(), columns.ravel())), shape).tocsr(), 0.5 * double_area
