"""The colours' rows in the Laplacian system: sums over samples of the surface, each in one pass. dense_skin.py makes them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..caches.compiled import compiled


@dataclass(frozen=True)
class SkinTerm:
    """Q samples with energy sum_q e_q^T M_q e_q - 2 p_q^T e_q, where e_q = sum_k shares_qk d_corners_qk is a sample's motion.

    ``corners`` (Q, 3) numbers of frontal vertices, ``shares`` (Q, 3) barycentric weights, ``matrices`` M (Q, 3, 3), 1/mm^2,
    and ``pulls`` p (Q, 3), 1/mm.
    """

    corners: np.ndarray
    shares: np.ndarray
    matrices: np.ndarray
    pulls: np.ndarray

    def image(self, displacement: np.ndarray) -> np.ndarray:
        """The term's matrix times a displacement (n, 3)."""
        return _spread(
            self.corners, self.shares, _moved(self.corners, self.shares, self.matrices, displacement), len(displacement)
        )

    def right_hand_side(self, count: int) -> np.ndarray:
        """The pulls at ``count`` vertices (n, 3)."""
        right: np.ndarray = _spread(self.corners, self.shares, self.pulls, count)
        return right

    def totals(self) -> tuple[np.ndarray, np.ndarray]:
        """Sums of the matrices (3, 3) and of the pulls (3,): the rows of a motion that all samples share."""
        matrix, pull = _totals(self.matrices, self.pulls)
        return matrix, pull

    @classmethod
    def about(
        cls, corners: np.ndarray, shares: np.ndarray, matrices: np.ndarray, forces: np.ndarray, displacement: np.ndarray
    ) -> SkinTerm:
        """The term whose rows were linearised at a ``displacement`` (n, 3), where they pull with ``forces`` (Q, 3)."""
        return cls(corners, shares, matrices, forces + _moved(corners, shares, matrices, displacement))


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
def _spread(corners: np.ndarray, shares: np.ndarray, forces: np.ndarray, count: int) -> np.ndarray:
    """(count, 3) sums over the samples of shares times forces (Q, 3)."""
    out = np.zeros((count, 3))
    for q in range(len(corners)):
        for k in range(3):
            share, i = shares[q, k], corners[q, k]
            out[i, 0] += share * forces[q, 0]
            out[i, 1] += share * forces[q, 1]
            out[i, 2] += share * forces[q, 2]
    return out


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
