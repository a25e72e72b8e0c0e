"""Factorise the constant matrix of the Laplacian deformation (section 4.3), and make the products for every frame."""

from __future__ import annotations

import copy
from collections.abc import Callable

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from ..caches.compiled import compiled
from ..geometry.mesh import cotangent_laplacian
from .lanes import LANES, less, put, row
from .packed_factor import PackedFactor

#: ``laplacian(vertices (N, 3), triangles (T, 3))`` -> L (N, N) of a mesh.
LaplacianOperator = Callable[[np.ndarray, np.ndarray], sp.spmatrix]


class PrefactoredSystem:
    """A0 = w1 I + w2 L^T L on the frontal vertices, factorised once: A0 = P^T G D G^T P with G unit lower triangular.

    Parameters
    ----------
    vertices, triangles : (N, 3)
        The surface, mm, and its triangles.
    frontal : (N,) bool
        Vertices of the frontal region.
    w1 : float or (n,)
        One weight for all frontal vertices, or one for each.
    w2 : float
        Weight of the smoothness.
    laplacian : callable
        ``laplacian(vertices, triangles)`` -> L (N, N).

    Raises
    ------
    RuntimeError
        A0 is singular, because w1 is 0 and no vertex lies outside the frontal region.
    """

    def __init__(
        self,
        vertices: np.ndarray,
        triangles: np.ndarray,
        frontal: np.ndarray,
        w1: float | np.ndarray,
        w2: float,
        laplacian: LaplacianOperator = cotangent_laplacian,
    ) -> None:
        rows = laplacian(vertices, triangles)[:, np.flatnonzero(frontal)]
        self._bending = (rows.T @ rows).tocsr()
        self._factorise(w1, w2)

    def reweighted(self, w1: float | np.ndarray, w2: float) -> PrefactoredSystem:
        """Return a system for the same surface with other energy weights. Only the factor is made again."""
        out = copy.copy(self)
        out._factorise(w1, w2)
        return out

    def _factorise(self, w1: float | np.ndarray, w2: float) -> None:
        self.smoothing = w2 * self._bending
        matrix = (self.smoothing + sp.diags(np.broadcast_to(np.asarray(w1, float), self._bending.shape[0]))).tocsc()
        # The matrix is symmetric positive definite, so that diagonal pivots and a symmetric ordering keep the factor sparse.
        factor = splu(matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
        self.factor = PackedFactor(factor.L, factor.U.diagonal(), factor.perm_r)

    def solve(self, right_hand_side: np.ndarray) -> np.ndarray:
        """Solve A0 x = b for b (n, c)."""
        solution = np.empty_like(right_hand_side, order="C", dtype=float)
        for first in range(0, right_hand_side.shape[1], 3):
            block = np.zeros((len(solution), 3))
            block[:, : right_hand_side.shape[1] - first] = right_hand_side[:, first : first + 3]
            solved = self.factor.solve(block)
            solution[:, first : first + 3] = solved[:, : right_hand_side.shape[1] - first]
        return solution

    def precondition(self, residual: np.ndarray) -> np.ndarray:
        """A0^-1 r for r (n, 3) in single precision, which is faster to stream and accurate enough for a search direction."""
        return self.factor.solve(residual, single=True)

    def apply(self, d: np.ndarray, strength: np.ndarray, normals: np.ndarray) -> np.ndarray:
        """w2 L^T L d plus the pull along the ``normals`` (n, 3) by ``strength`` (n,), for a displacement d (n, 3)."""
        image: np.ndarray = _apply_with_planes(
            self.smoothing.indptr, self.smoothing.indices, self.smoothing.data, strength, normals, d
        )
        return image


@compiled
def _apply_with_planes(
    starts: np.ndarray, columns: np.ndarray, values: np.ndarray, strength: np.ndarray, normals: np.ndarray, d: np.ndarray
) -> np.ndarray:
    """S d + strength (n^T d) n, (n, 3), for a sparse S stored by rows, in one pass over the arrays instead of five.

    n^T d is summed in the order of NumPy's ``einsum`` on pairs.
    """
    count = len(strength)
    image, places = np.empty((count, 3)), np.zeros((count, LANES))
    zeros, less_smooth = np.zeros((1, LANES)), np.empty((1, LANES))  # the latter: -S d of one vertex
    for i in range(count):
        places[i, 0], places[i, 1], places[i, 2] = d[i, 0], d[i, 1], d[i, 2]
    for i in range(count):
        left = row(zeros, 0)
        for k in range(np.uint32(starts[i]), np.uint32(starts[i + 1])):
            left = less(left, values[k], row(places, np.uint32(columns[k])))
        put(less_smooth, 0, left)
        a, b, c = less_smooth[0, 0], less_smooth[0, 1], less_smooth[0, 2]
        x, y, z = normals[i, 0], normals[i, 1], normals[i, 2]
        along = strength[i] * (x * d[i, 0] + z * d[i, 2] + y * d[i, 1])
        image[i, 0], image[i, 1], image[i, 2] = along * x - a, along * y - b, along * z - c
    return image
