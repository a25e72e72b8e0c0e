"""Remove hair, hands and scarves from the scan: things that hang into the face must not become part of the neutral.

The head of the identity modes lies within a millimetre or two of skin wherever people have been measured; hair stands out
from it by a centimetre. So points of the scan that stand out far are not skin where they hang together with what lies
around the face. A nose that stands out is an island in the face, and stays.
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

#: Points nearer to each other than this are connected and averaged, mm.
TOGETHER = 6.0
#: Hair thins out into the skin: near points that stand out far, within the second number of mm, those that stand out by
#: this share of what counts as far belong to it.
THIN, SEAM = 0.4, 15.0
#: Vertices within this many rings of hair count as lying under it, because hair is sparse.
SHADOW = 3
#: The face's rim is this many rings of vertices wide. Of what is left out at least this share must lie on the face: a neck
#: that is held in another way than the model's does no harm.
RIM, ON_FACE = 3, 0.05
#: Points farther from the head than this are another thing altogether, mm; they are left to the limits of the searches.
FARTHEST = 40.0


def without_hair(scan: FusedScan, model: FaceModel, head: np.ndarray, limit: float) -> tuple[FusedScan, np.ndarray]:
    """The scan without its hair, and the vertices (V,) bool of ``head`` (V, 3), in the scan's frame, that lie under it.

    Hair stands out from the head by more than ``limit`` mm. The very same scan where there is none, or for a limit of 0.
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
    """(P,) bool: which of the scan's ``points`` (P, 3) :func:`without_hair` leaves out; (P,) int: the nearest vertex of each.

    Those that stand out far, those around them that stand out less, and only where they reach beyond the face's rim.
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
    """(P,) bool: ``loose`` points whose connected part holds a ``far`` one, one at the ``rim``, and enough on the ``face``."""
    rows = np.flatnonzero(loose)
    count, part = connected_components(joined[rows][:, rows], directed=False)
    kept = np.bincount(part, far[rows], count) > 0
    kept &= np.bincount(part, rim[rows], count) > 0
    kept &= np.bincount(part, face[rows], count) > ON_FACE * np.bincount(part, minlength=count)
    hair = np.zeros(len(loose), bool)
    hair[rows[kept[part]]] = True
    return hair
