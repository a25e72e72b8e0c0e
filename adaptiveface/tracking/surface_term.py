"""Rows of the Laplacian system at points of the surface, features or samples of the skin: sums over them, each in one pass."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..caches.compiled import compiled


@dataclass(frozen=True)
class SurfaceTerm:
    """Q points with energy sum_q e_q^T M_q e_q - 2 p_q^T e_q, where e_q = sum_k shares_qk d_corners_qk is a point's motion.

    ``corners`` (Q, 3) numbers of frontal vertices, ``shares`` (Q, 3) barycentric weights, ``matrices`` M (Q, 3, 3), 1/mm^2.
    ``forces`` (Q, 3), 1/mm, is what the rows pull with at the displacement ``origin`` (n, 3), mm, or, without one, at zero.
    """

    corners: np.ndarray
    shares: np.ndarray
    matrices: np.ndarray
    forces: np.ndarray
    origin: np.ndarray | None = None

    @cached_property
    def pulls(self) -> np.ndarray:
        """p (Q, 3), 1/mm."""
        if self.origin is None:
            return self.forces
        pulls: np.ndarray = self.forces + _moved(self.corners, self.shares, self.matrices, self.origin)
        return pulls

    def add_image(self, field: np.ndarray, displacement: np.ndarray) -> None:
        """Add the term's matrix times a displacement (n, 3) to a field (n, 3), in place."""
        _spread(field, self.corners, self.shares, _moved(self.corners, self.shares, self.matrices, displacement))

    def add_pulls(self, field: np.ndarray) -> None:
        """Add the pulls to a field (n, 3), in place."""
        _spread(field, self.corners, self.shares, self.pulls)

    def add_residual(self, field: np.ndarray, displacement: np.ndarray) -> None:
        """Add the pulls that are left at a displacement (n, 3) to a field (n, 3), in place: at ``origin`` they are known."""
        left = self.forces
        if displacement is not self.origin:
            left = self.pulls - _moved(self.corners, self.shares, self.matrices, displacement)
        _spread(field, self.corners, self.shares, left)

    def totals(self) -> tuple[np.ndarray, np.ndarray]:
        """Sums of the matrices (3, 3) and of the pulls (3,): the rows of a motion that all points share."""
        matrix, pull = _totals(self.matrices, self.pulls)
        return matrix, pull


@compiled(nogil=True)
def _moved(corners: np.ndarray, shares: np.ndarray, matrices: np.ndarray, displacement: np.ndarray) -> np.ndarray:
    """M_q e_q (Q, 3)."""
    out = np.empty((len(corners), 3))
    for q in range(len(corners)):
        x, y, z = 0.0, 0.0, 0.0
        for k in range(3):
            share, i = shares[q, k], corners[q, k]
            x += share * displacement[i, 0]
            y += share * displacement[i, 1]
            z += share * displacement[i, 2]
        for k in range(3):
            out[q, k] = matrices[q, k, 0] * x + matrices[q, k, 1] * y + matrices[q, k, 2] * z
    return out


@compiled(nogil=True)
def _spread(field: np.ndarray, corners: np.ndarray, shares: np.ndarray, forces: np.ndarray) -> None:
    """Add to a field (n, 3) in place what ``forces`` (Q, 3) give to their corners, by the shares."""
    for q in range(len(corners)):
        for k in range(3):
            share, i = shares[q, k], corners[q, k]
            field[i, 0] += share * forces[q, 0]
            field[i, 1] += share * forces[q, 1]
            field[i, 2] += share * forces[q, 2]


@compiled(nogil=True)
def _totals(matrices: np.ndarray, pulls: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Sums over the samples: NumPy takes five times as long for so short rows."""
    matrix, pull = np.zeros((3, 3)), np.zeros(3)
    for q in range(len(pulls)):
        for k in range(3):
            pull[k] += pulls[q, k]
            for m in range(3):
                matrix[k, m] += matrices[q, k, m]
    return matrix, pull
