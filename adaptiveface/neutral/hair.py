"""Remove hair, hands and scarves from the scan, so that they do not become part of the neutral.

On all measured people, the head of the identity modes lies within a millimetre or two of the skin, and hair stands out from it
by a centimetre. Points of the scan that stand out far are therefore not skin if they are connected with the surroundings of the
face. A nose that stands out is an island in the face, and is kept.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import scipy.sparse as sp
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from ..geometry.mesh import grow, vertex_normals
from ..model.face_model import FaceModel
from .fuse import FusedScan

#: Points within this distance of each other are connected and averaged, mm.
TOGETHER = 6.0
#: Hair thins out towards the skin. Points that stand out by this share of the limit are also hair if they lie within the second
#: number (mm) of points beyond the limit.
THIN, SEAM = 0.4, 15.0
#: Vertices within this many rings of hair count as covered by it, because hair is sparse.
SHADOW = 3
#: Width of the face's rim in rings of vertices, and the smallest share of removed points that must lie on the face. A neck that
#: is bent unlike the model's is therefore not removed.
RIM, ON_FACE = 3, 0.05
#: Points farther from the head than this are something else, mm. The limits of the searches exclude them.
FARTHEST = 40.0


def without_hair(scan: FusedScan, model: FaceModel, head: np.ndarray, limit: float) -> tuple[FusedScan, np.ndarray]:
    """Remove the hair from a scan.

    Parameters
    ----------
    scan : FusedScan
        The merged scan.
    model : FaceModel
        Has the mesh of the head and the face's region.
    head : (V, 3)
        The fitted head in the scan's frame, mm.
    limit : float
        Hair stands out from the head by more than this, mm; 0 removes nothing.

    Returns
    -------
    scan : FusedScan
        Without hair; the same object if there is none.
    under : (V,) bool
        Vertices of the head under hair.
    """
    under = np.zeros(len(head), bool)
    if limit == 0:
        return scan, under
    hair, nearest = hair_points(scan.points, model, head, limit)
    if not hair.any():
        return scan, under
    under[nearest[hair]] = True
    skin = ~hair
    cleared = replace(scan, points=scan.points[skin], normals=scan.normals[skin], weights=scan.weights[skin])
    return cleared, grow(under, model.triangles, SHADOW)


def hair_points(points: np.ndarray, model: FaceModel, head: np.ndarray, limit: float) -> tuple[np.ndarray, np.ndarray]:
    """Which points (P, 3) :func:`without_hair` removes, (P,) bool, and the vertex nearest to each point, (P,) int.

    It removes points that stand out far and points around them that stand out less, if they reach beyond the face's rim.
    """
    away, nearest = cKDTree(head).query(points)
    normals = vertex_normals(head, model.triangles)
    near = away < FARTHEST
    out = np.where(near, ((points - head[nearest]) * normals[nearest]).sum(axis=1), 0.0)
    tree = cKDTree(points)
    joined = tree.sparse_distance_matrix(tree, TOGETHER, output_type="coo_matrix")
    joined = sp.coo_matrix((np.ones(joined.nnz), (joined.row, joined.col)), joined.shape).tocsr()
    joined = ((joined + sp.identity(len(points), format="csr")) > 0).astype(float)
    out = joined @ out / joined.sum(axis=1).A1
    far = near & (out > limit)
    if not far.any():
        return far, nearest
    seam, _ = cKDTree(points[far]).query(points, distance_upper_bound=SEAM)
    loose = far | (near & (out > THIN * limit) & np.isfinite(seam))
    rim = grow(~model.frontal, model.triangles, RIM)
    return _hanging_in(joined, loose, far, rim[nearest], model.frontal[nearest]), nearest


def _hanging_in(joined: sp.csr_matrix, loose: np.ndarray, far: np.ndarray, rim: np.ndarray, face: np.ndarray) -> np.ndarray:
    """Which ``loose`` points have a ``far`` one, one at the ``rim`` and enough on the ``face`` in their connected part."""
    rows = np.flatnonzero(loose)
    count, part = connected_components(joined[rows][:, rows], directed=False)
    kept = np.bincount(part, far[rows], count) > 0
    kept &= np.bincount(part, rim[rows], count) > 0
    kept &= np.bincount(part, face[rows], count) > ON_FACE * np.bincount(part, minlength=count)
    hair = np.zeros(len(loose), bool)
    hair[rows[kept[part]]] = True
    return hair
