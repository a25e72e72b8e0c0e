"""Make the terms of equations (3) to (5) and (7) as the paper prints them, or in the nearest readings that work.

The parameters of ``laplacian`` choose. All choices lead to the matrix A0 = w1 I + w2 L^T L, which is factorised once, and to
the features' rows, which the Woodbury identity adds exactly (``laplacian.py``).

* ``depth_term`` = "point-to-point" is equation (3). It also holds the skin along the surface, about which depth knows nothing.
* ``feature_rows`` = "printed" is equation (4). It moves a feature sideways only in proportion to its change of depth:
  if the depth must not change, as in the final deformation, no vertex moves at all. "consistent" is the weak projection
  that must be meant: the displaced point lies on the feature's viewing ray, at its depth.
* ``weights`` = "rows" multiplies the rows of equation (7) by w1 and w2, and therefore their energies by the squares.
  "pseudo-inverse" is the printed solution. Because K is tall, it is read as (K^T K)^-1 K^T G^-1 a. G^-1 removes the
  weights from ``a``, so that w1, w2 and the scale of the feature rows have no influence.

The features' points are barycentric combinations of vertices instead of vertices. Pixels are counted from the principal point,
so that P = diag(f_x, f_y, 1). With the principal point in P, equation (4) would depend on the place of the picture's corner.
"""

from __future__ import annotations

import numpy as np

from ..geometry.camera import Camera
from ..geometry.frame import Features2D
from ..geometry.mesh import transform_points
from ..parameters import LaplacianParameters
from ..registration.association import Correspondences
from .laplacian import FeatureTerm


def depth_offsets(matches: Correspondences, pose: np.ndarray, held: np.ndarray) -> np.ndarray:
    """p_i - v_i of equation (3), (n, 3) in the head frame, mm: p_i lies on the viewing ray of v_i.

    The paper does not say what happens to a vertex without depth. Its row must stay, or the matrix would change. Its target
    is ``held`` (n, 3), the displacement of the last frame, mm. ``pose`` (4, 4) is head to camera.
    """
    matched = matches.weights > 0
    points, normals = matches.points[matched], matches.normals[matched]
    gap = matches.distances[matched] / np.einsum("nd,nd->n", normals, points)
    offsets = held.copy()
    offsets[matched] = -gap[:, None] * points @ pose[:3, :3]
    return offsets


def offsets_at_features(matches: Correspondences, pose: np.ndarray, corners: np.ndarray, shares: np.ndarray) -> np.ndarray:
    """p_j - v_j (f, 3) in the head frame, mm, of features between ``corners`` (f, 3) with ``shares`` (f, 3).

    It is zero if not all three corners have depth.
    """
    offsets = depth_offsets(matches, pose, np.zeros_like(matches.points))
    seen = (matches.weights[corners] > 0).all(axis=1)
    at_features: np.ndarray = np.einsum("fk,fkd->fd", shares * seen[:, None], offsets[corners])
    return at_features


def weak_projection(u: np.ndarray) -> np.ndarray:
    """H of equation (4), (f, 3, 3): the rows (1, 0, -u_x), (0, 1, -u_y) and (0, 0, 1); ``u`` (f, 2) px."""
    h = np.tile(np.eye(3), (len(u), 1, 1))
    h[:, :2, 2] = -u
    return h


def printed_term(
    features: Features2D | None,
    camera: Camera,
    pose: np.ndarray,
    points: np.ndarray,
    rise: np.ndarray | float,
    parameters: LaplacianParameters,
) -> FeatureTerm:
    """Make the rows of equation (5), H_j P dv_j - d_j, for the visible features in the head frame.

    Parameters
    ----------
    features : Features2D or None
        The 2D features.
    camera : Camera
        Of the frame.
    pose : (4, 4)
        Head frame to camera frame, mm.
    points : (40, 3)
        Current places of the features on the mesh, head frame, mm.
    rise : (40,) or float
        p_z - v_z, the wanted change of their depth, mm.
    parameters : LaplacianParameters
        ``feature_rows`` chooses H_j and d_j, and ``weights`` chooses between H_j P dv = d_j and P dv = H_j^-1 d_j.

    Returns
    -------
    FeatureTerm
        Its first two rows are in px mm, and the third is in mm. All rows are weighted by the features' confidences.
    """
    if features is None:
        return FeatureTerm(np.zeros(0, int), np.zeros((0, 3, 3)), np.zeros((0, 3)), np.zeros((0, 3)))
    index = np.flatnonzero(features.valid)
    at = transform_points(pose, points[index])
    seen = features.pixels[index] - [camera.cx, camera.cy]
    offset = features.pixels[index] - camera.project(at)
    rise = np.broadcast_to(rise, len(points))[index]
    if parameters.feature_rows == "printed":
        h, d = weak_projection(offset), np.column_stack([np.zeros_like(offset), rise])
    else:
        h, d = weak_projection(seen), np.column_stack([offset * at[:, 2:], rise])
    rows = np.broadcast_to(np.diag([camera.fx, camera.fy, 1.0]) @ pose[:3, :3], h.shape)
    if parameters.weights == "pseudo-inverse":
        d = np.linalg.solve(h, d[:, :, None])[:, :, 0]
    else:
        rows = h @ rows
    confidence = features.confidence[index].astype(float)
    return FeatureTerm(index, rows, d, np.repeat(confidence[:, None], 3, axis=1))
