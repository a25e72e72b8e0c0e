"""The smooth motions that conjugate gradients would reach last, solved beside them (two-level preconditioning).

A0 bounds the rows of depth and colours by the same stiffness in all three directions. Where they say less than that, most of
all about smooth motion along one direction, each iteration with A0 goes only a part of the way. What is slow are the smooth
fields v of S v = lambda W v with the least lambda, S the smoothing and W the bound: A0 = S + W changes them least. In the span
of the first m of them, three components each, the system is a small dense one. Its matrix is taken from the neutral's rows
and inverted once: as a search direction it need not be exact, since conjugate gradients find each step's length.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import LinearOperator, eigsh, splu

from ..caches.compiled import compiled

#: So many modes are solved beside the iterations.
COUNT = 60
#: S + SHIFT W is factorised to find the modes: S alone would be singular without a boundary.
SHIFT = 0.02


def slowest_modes(smoothing: sp.spmatrix, bound: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """The ``count`` fields v (n, m) with the least v^T S v for v^T W v = 1, and these values (m,); W = diag(bound)."""
    bound = np.maximum(bound, 1e-6 * bound.max())
    n, root = len(bound), np.sqrt(bound)
    shifted = (smoothing + SHIFT * sp.diags(bound)).tocsc()
    factor = splu(shifted, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
    inverse = LinearOperator((n, n), lambda field: root * factor.solve(root * field.ravel()), dtype=float)
    values, fields = eigsh(inverse, k=min(count, n - 1), which="LM", v0=root, tol=1e-2)
    return fields[:, ::-1] / root[:, None], 1.0 / values[::-1] - SHIFT


class SlowModes:
    """Solves for the smooth part of a displacement.

    Parameters
    ----------
    modes : (n, m)
        Fields of the frontal vertices.
    matrix : (3 m, 3 m)
        The system's matrix in their span, components last.
    """

    def __init__(self, modes: np.ndarray, matrix: np.ndarray) -> None:
        self._modes = np.ascontiguousarray(modes, np.float32)
        self._rows = np.ascontiguousarray(modes.T, np.float32)
        self._inverse = np.linalg.inv(matrix)

    @classmethod
    def of(
        cls,
        smoothing: sp.spmatrix,
        bound: np.ndarray,
        depth: np.ndarray,
        corners: np.ndarray,
        shares: np.ndarray,
        colours: np.ndarray,
        count: int = COUNT,
    ) -> SlowModes:
        """The ``count`` slowest modes of the neutral.

        smoothing (n, n) and bound (n,): A0 is their sum. depth (n, 3, 3): the vertices' rows. corners (Q, 3), shares (Q, 3)
        and colours (Q, 3, 3): the samples' rows.
        """
        modes, values = slowest_modes(smoothing, bound, count)
        m = len(values)
        at_samples = np.einsum("qk,qkm->qm", shares, modes[corners])
        matrix = np.einsum("im,ikl,in->mknl", modes, depth, modes, optimize=True)
        matrix += np.einsum("qm,qkl,qn->mknl", at_samples, colours, at_samples, optimize=True)
        for k in range(3):
            matrix[np.arange(m), k, np.arange(m), k] += values
        return cls(modes, matrix.reshape(3 * m, 3 * m))

    def solve(self, residual: np.ndarray) -> np.ndarray:
        """The smooth displacement (n, 3) for a residual (n, 3)."""
        amplitudes = self._inverse @ _in_modes(self._modes, residual).ravel()
        return _of_modes(self._rows, amplitudes.reshape(-1, 3))


@compiled(nogil=True)
def _in_modes(modes: np.ndarray, field: np.ndarray) -> np.ndarray:
    """V^T f (m, 3), in single precision."""
    n, m = modes.shape
    x, y, z = np.zeros(m, np.float32), np.zeros(m, np.float32), np.zeros(m, np.float32)
    for i in range(n):
        a, b, c = np.float32(field[i, 0]), np.float32(field[i, 1]), np.float32(field[i, 2])
        for k in range(m):
            x[k] += a * modes[i, k]
            y[k] += b * modes[i, k]
            z[k] += c * modes[i, k]
    out = np.empty((m, 3))
    out[:, 0], out[:, 1], out[:, 2] = x, y, z
    return out


@compiled(nogil=True)
def _of_modes(rows: np.ndarray, amplitudes: np.ndarray) -> np.ndarray:
    """V a (n, 3) of V^T ``rows`` (m, n) and amplitudes (m, 3)."""
    m, n = rows.shape
    x, y, z = np.zeros(n, np.float32), np.zeros(n, np.float32), np.zeros(n, np.float32)
    for k in range(m):
        a, b, c = np.float32(amplitudes[k, 0]), np.float32(amplitudes[k, 1]), np.float32(amplitudes[k, 2])
        for i in range(n):
            x[i] += a * rows[k, i]
            y[i] += b * rows[k, i]
            z[i] += c * rows[k, i]
    out = np.empty((n, 3))
    for i in range(n):
        out[i, 0], out[i, 1], out[i, 2] = x[i], y[i], z[i]
    return out
