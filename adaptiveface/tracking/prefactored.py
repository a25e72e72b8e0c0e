"""The constant matrix of the Laplacian deformation (section 4.3), its factor, and the products that every frame needs."""

from __future__ import annotations

import copy
from collections.abc import Callable

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from ..caches.compiled import compiled
from ..mesh import cotangent_laplacian

#: L (N, N) of a mesh: ``laplacian(vertices (N, 3), triangles (T, 3))``.
LaplacianOperator = Callable[[np.ndarray, np.ndarray], sp.spmatrix]


class PrefactoredSystem:
    """A0 = w1 I + w2 L^T L on the frontal vertices, factorised once: A0 = P^T G D G^T P with G unit lower triangular.

    ``w1`` is one weight, or one for each frontal vertex; ``laplacian(vertices, triangles)`` gives L (N, N). Raises RuntimeError
    when A0 is singular (w1 = 0 and no vertex outside the frontal region).
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
        """The same surface with other energy weights: only the factorisation is made anew."""
        out = copy.copy(self)
        out._factorise(w1, w2)
        return out

    def _factorise(self, w1: float | np.ndarray, w2: float) -> None:
        self.smoothing = w2 * self._bending
        matrix = (self.smoothing + sp.diags(np.broadcast_to(np.asarray(w1, float), self._bending.shape[0]))).tocsc()
        # The matrix is symmetric positive definite: diagonal pivots and a symmetric ordering keep the factor sparse.
        factor = splu(matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
        lower = factor.L
        lower.sort_indices()
        below = np.ones(lower.nnz, bool)
        below[lower.indptr[:-1]] = False  # each column begins with its unit diagonal, which is not stored
        starts = lower.indptr - np.arange(len(lower.indptr))
        self._pattern = starts.astype(np.int32), lower.indices[below].astype(np.int32)
        self._alike = _alike_columns(*self._pattern)
        self._values = lower.data[below]
        self._single_values = self._values.astype(np.float32)
        self._inverse_diagonal, self._order = 1.0 / factor.U.diagonal(), factor.perm_r.astype(np.int32)

    def solve(self, right_hand_side: np.ndarray) -> np.ndarray:
        """A0^-1 b for b (n, c)."""
        solution = np.empty_like(right_hand_side, order="C", dtype=float)
        for first in range(0, right_hand_side.shape[1], 3):
            block = np.zeros((len(solution), 3))
            block[:, : right_hand_side.shape[1] - first] = right_hand_side[:, first : first + 3]
            solved = _solve_three(*self._pattern, self._alike, self._values, self._inverse_diagonal, self._order, block)
            solution[:, first : first + 3] = solved[:, : right_hand_side.shape[1] - first]
        return solution

    def precondition(self, residual: np.ndarray) -> np.ndarray:
        """A0^-1 r for r (n, 3) from the factor in single precision: enough for a search direction, and faster to stream."""
        single = self._single_values
        return _solve_three(
            *self._pattern, self._alike, single, self._inverse_diagonal, self._order, np.ascontiguousarray(residual)
        )

    def apply(self, d: np.ndarray, strength: np.ndarray, normals: np.ndarray) -> np.ndarray:
        """w2 L^T L d plus the pull along the ``normals`` (n, 3) by ``strength`` (n,), for a displacement d (n, 3)."""
        image: np.ndarray = _apply_with_planes(
            self.smoothing.indptr, self.smoothing.indices, self.smoothing.data, strength, normals, d
        )
        return image


@compiled
def _alike_columns(starts: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """(n,) how many columns from each one on have the same rows below them, up to their dense triangle: a supernode's rest."""
    n = len(starts) - 1
    alike = np.ones(n, np.int32)
    for j in range(n - 2, -1, -1):
        first, second, end = starts[j], starts[j + 1], starts[j + 2]
        same = second - first == end - second + 1 and rows[first] == j + 1
        for k in range(end - second):
            same = same and rows[first + 1 + k] == rows[second + k]
        if same:
            alike[j] = alike[j + 1] + 1
    return alike


@compiled
def _solve_three(
    starts: np.ndarray,
    rows: np.ndarray,
    alike: np.ndarray,
    values: np.ndarray,
    inverse_diagonal: np.ndarray,
    order: np.ndarray,
    right: np.ndarray,
) -> np.ndarray:
    """P^T G^-T D^-1 G^-1 P b for b (n, 3): the three coordinates share one pass over the factor (SuperLU makes three).

    Two neighbouring columns of a supernode, then two more, are eliminated in one pass over the rows that they share. Every
    sum is still taken column by column, so that this changes no result.
    """
    n = len(inverse_diagonal)
    y = np.empty((n, 3))
    for i in range(n):
        y[order[i], 0], y[order[i], 1], y[order[i], 2] = right[i, 0], right[i, 1], right[i, 2]
    j = 0
    while j < n:
        if alike[j] >= 4:
            _eliminate_four(starts, rows, values, y, j)
            j += 4
        elif alike[j] >= 2:
            _eliminate_two(starts, rows, values, y, j)
            j += 2
        else:
            a, b, c = y[j, 0], y[j, 1], y[j, 2]
            for k in range(starts[j], starts[j + 1]):
                row, value = np.uint32(rows[k]), values[k]
                y[row, 0] -= value * a
                y[row, 1] -= value * b
                y[row, 2] -= value * c
            j += 1
    for j in range(n - 1, -1, -1):
        scale = inverse_diagonal[j]
        a, b, c = y[j, 0] * scale, y[j, 1] * scale, y[j, 2] * scale
        for k in range(starts[j], starts[j + 1]):
            row, value = np.uint32(rows[k]), values[k]
            a -= value * y[row, 0]
            b -= value * y[row, 1]
            c -= value * y[row, 2]
        y[j, 0], y[j, 1], y[j, 2] = a, b, c
    solution = np.empty((n, 3))
    for i in range(n):
        solution[i, 0], solution[i, 1], solution[i, 2] = y[order[i], 0], y[order[i], 1], y[order[i], 2]
    return solution


@compiled(inline="always")
def _eliminate_two(starts: np.ndarray, rows: np.ndarray, values: np.ndarray, y: np.ndarray, j: int) -> None:
    """Columns j and j + 1 of the forward substitution, in place."""
    s0, s1, end = starts[j], starts[j + 1], starts[j + 2]
    a0, b0, c0 = y[j, 0], y[j, 1], y[j, 2]
    value = values[s0]
    a1, b1, c1 = y[j + 1, 0] - value * a0, y[j + 1, 1] - value * b0, y[j + 1, 2] - value * c0
    y[j + 1, 0], y[j + 1, 1], y[j + 1, 2] = a1, b1, c1
    for k in range(end - s1):
        i, v0, v1 = np.uint32(rows[s1 + k]), values[s0 + 1 + k], values[s1 + k]
        y[i, 0] = y[i, 0] - v0 * a0 - v1 * a1
        y[i, 1] = y[i, 1] - v0 * b0 - v1 * b1
        y[i, 2] = y[i, 2] - v0 * c0 - v1 * c1


@compiled(inline="always")
def _eliminate_four(starts: np.ndarray, rows: np.ndarray, values: np.ndarray, y: np.ndarray, j: int) -> None:
    """Columns j to j + 3 of the forward substitution, in place."""
    s0, s1, s2, s3, end = starts[j], starts[j + 1], starts[j + 2], starts[j + 3], starts[j + 4]
    for p, start in ((0, s0), (1, s1), (2, s2)):  # their own triangle
        for q in range(3 - p):
            value = values[start + q]
            for c in range(3):
                y[j + p + 1 + q, c] -= value * y[j + p, c]
    a0, b0, c0 = y[j, 0], y[j, 1], y[j, 2]
    a1, b1, c1 = y[j + 1, 0], y[j + 1, 1], y[j + 1, 2]
    a2, b2, c2 = y[j + 2, 0], y[j + 2, 1], y[j + 2, 2]
    a3, b3, c3 = y[j + 3, 0], y[j + 3, 1], y[j + 3, 2]
    for k in range(end - s3):
        i = np.uint32(rows[s3 + k])
        v0, v1, v2, v3 = values[s0 + 3 + k], values[s1 + 2 + k], values[s2 + 1 + k], values[s3 + k]
        y[i, 0] = y[i, 0] - v0 * a0 - v1 * a1 - v2 * a2 - v3 * a3
        y[i, 1] = y[i, 1] - v0 * b0 - v1 * b1 - v2 * b2 - v3 * b3
        y[i, 2] = y[i, 2] - v0 * c0 - v1 * c1 - v2 * c2 - v3 * c3


@compiled
def _apply_with_planes(
    starts: np.ndarray, columns: np.ndarray, values: np.ndarray, strength: np.ndarray, normals: np.ndarray, d: np.ndarray
) -> np.ndarray:
    """S d + strength (n^T d) n, (n, 3), for a sparse S in rows: one pass instead of five over arrays.

    n^T d is summed as NumPy's ``einsum`` does where it works on pairs.
    """
    count = len(strength)
    image = np.empty((count, 3))
    for i in range(count):
        a, b, c = 0.0, 0.0, 0.0
        for k in range(starts[i], starts[i + 1]):
            j, value = np.uint32(columns[k]), values[k]
            a += value * d[j, 0]
            b += value * d[j, 1]
            c += value * d[j, 2]
        x, y, z = normals[i, 0], normals[i, 1], normals[i, 2]
        along = strength[i] * (x * d[i, 0] + z * d[i, 2] + y * d[i, 1])
        image[i, 0], image[i, 1], image[i, 2] = a + along * x, b + along * y, c + along * z
    return image
