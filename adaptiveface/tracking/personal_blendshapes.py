"""Blendshapes that become the person's own while tracking; not in the paper, whose section 8 names their lack.

After Bouaziz, Wang and Pauly 2013 (Online modeling for realtime facial animation): every trusted frame tells by how much its
mesh differs from b0 + B x, and what the frames have in common is a change dB of the expressions' meshes. Per vertex v, over
frames t with coefficients x_t and observed displacements d_t(v) - B(v) x_t = r_t(v),

    min over dB(v), c(v):  sum_t w_t |r_t(v) - dB(v) x_t - c(v)|^2 / noise^2
                           + sum_i |dB_i(v)|^2 / (prior_deviation |b_i(v)|)^2 + |c(v)|^2 / misfit^2

so that an expression changes only where it moves, by a share of its own motion, as smoothly as that; whatever is off at rest
goes into c, which is not used: the neutral stays, and coefficients of zero change nothing. Lids hardly change at all.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from typing import Self

import numpy as np

from ..caches.compiled import compiled
from ..parameters import PersonalBlendshapesParameters
from .lanes import LANES, less, put, row

#: Standard deviation of the neutral's own error c, mm.
MISFIT = 1.0
#: Closed lids deviate from the transferred ones by this share of what other expressions may. Depth does not see them, and
#: of a person with narrow eyes the tracker learned that a blink is small, until open eyes counted as closed ones.
LIDS, LIDS_SHARE = "eyeBlink", 0.1


@compiled
def _accumulate(moments: np.ndarray, x: np.ndarray, residual: np.ndarray, weight: float, decay: float) -> None:
    """``moments`` (A + 1, 3n) = decay moments + weight x residual^T in place, in one pass."""
    for i in range(len(x)):
        factor = np.float32(weight * x[i])
        for j in range(len(residual)):
            moments[i, j] = np.float32(decay) * moments[i, j] + factor * residual[j]


@compiled(nogil=True)
def _solutions(gram: np.ndarray, moments: np.ndarray, deviations: np.ndarray, noise: float) -> np.ndarray:
    """(A, m, 3) dB of m vertices: D z of (D G D + ``noise`` 1) z = D R with a vertex's ``deviations`` (m, A + 1) in D.

    By Cholesky factors, with the right-hand sides R = ``moments`` (A + 1, m, 3) beside them. Four vertices are solved for side
    by side, and each step is one of rows of four numbers. Products are differences from zero.
    """
    size, count = len(gram), len(deviations)
    out = np.empty((size - 1, count, 3))
    d, negative_d, negative_inverse = np.zeros((3, size, LANES))
    factor, right, nothing = np.empty((size * size, LANES)), np.zeros((3 * size, LANES)), np.zeros((1, LANES))
    for first in range(0, count, LANES):
        used, zero = min(LANES, count - first), row(nothing, 0)
        for i in range(size):
            for v in range(used):
                d[i, v], negative_d[i, v] = deviations[first + v, i], -deviations[first + v, i]
                for k in range(3):
                    right[3 * i + k, v] = d[i, v] * moments[i, first + v, k]
        for i in range(size):  # the lower factor, row by row, and the right-hand sides through it
            for j in range(i + 1):
                left = less(zero, row(negative_d, i), less(zero, -gram[i, j], row(d, j)))
                for k in range(j):
                    left = less(left, row(factor, size * i + k), row(factor, size * j + k))
                if j < i:
                    left = less(zero, row(negative_inverse, j), left)
                put(factor, size * i + j, left)
            for v in range(LANES):
                negative_inverse[i, v] = -1.0 / np.sqrt(factor[size * i + i, v] + noise)
            for k in range(3):
                left = row(right, 3 * i + k)
                for j in range(i):
                    left = less(left, row(factor, size * i + j), row(right, 3 * j + k))
                put(right, 3 * i + k, less(zero, row(negative_inverse, i), left))
        for i in range(size - 1, -1, -1):
            for k in range(3):
                solved = less(zero, row(negative_inverse, i), row(right, 3 * i + k))
                for j in range(i):
                    put(right, 3 * j + k, less(row(right, 3 * j + k), row(factor, size * i + j), solved))
                if i < size - 1:
                    put(right, 3 * i + k, solved)
                    for v in range(used):
                        out[i, first + v, k] = d[i, v] * right[3 * i + k, v]
    return out


class PersonalBlendshapes:
    """Learns the change dB of the expressions over the n frontal vertices.

    Parameters
    ----------
    basis : (A, n, 3)
        The transferred expressions as displacements from the neutral, mm.
    parameters
        See :class:`.PersonalBlendshapesParameters`.
    names : (A,) str, optional
        The expressions' names, which tell the lids.

    Attributes
    ----------
    change : (A, n, 3) float32
        dB, mm. An update replaces it.
    updates : int
        How often that was.
    """

    def __init__(self, basis: np.ndarray, parameters: PersonalBlendshapesParameters, names: Sequence[str] = ()) -> None:
        self.parameters = parameters
        self._transferred = basis.reshape(len(basis), -1).astype(np.float32)
        lengths = np.linalg.norm(basis, axis=2).T
        lengths[:, [k for k, name in enumerate(names) if name.startswith(LIDS)]] *= LIDS_SHARE
        #: (n, A + 1) prior standard deviations of dB and c, mm.
        self._deviations = np.column_stack([parameters.prior_deviation * lengths, np.full(len(lengths), MISFIT)])
        self.reset()

    def reset(self) -> None:
        """Forget everything: the expressions are the transferred ones."""
        n, unknowns = self._deviations.shape
        self.change = np.zeros((unknowns - 1, n, 3), np.float32)
        self.updates = 0
        self._gram = np.zeros((unknowns, unknowns))
        self._moments = np.zeros((unknowns, 3 * n), np.float32)
        self._coming, self._solved = np.zeros_like(self.change), 0
        self._shared = False

    def copy(self) -> Self:
        """One that goes its own way; arrays are copied when one of the two learns."""
        out = copy.copy(self)
        self._shared = out._shared = True
        return out

    def remembered(self, keep: Callable[[np.ndarray], np.ndarray] = np.copy) -> Self:
        """The expressions as they are now in little memory: one that cannot learn. ``keep`` copies an array."""
        out = copy.copy(self)
        out.change = keep(self.change)
        out._gram, out._moments, out._coming = np.zeros((0, 0)), out.change[:0], out.change[:0]
        return out

    def learn(self, x: np.ndarray, displacement: np.ndarray, trust: float = 1.0) -> bool:
        """Learn from a frame; True when ``change`` is another one now.

        Parameters
        ----------
        x : (A,)
            The frame's coefficients.
        displacement : (3n,)
            Of the frame's mesh from the neutral, mm.
        trust : float
            How much the frame counts.
        """
        if self._shared:
            self._gram, self._moments, self._coming = self._gram.copy(), self._moments.copy(), self._coming.copy()
            self._shared = False
        residual = displacement.astype(np.float32) - x.astype(np.float32) @ self._transferred
        unknowns = np.append(x, 1.0)
        # A face at rest has nothing to say about expressions, and makes none of them forgotten.
        decay = float(np.exp(-trust * min(float(x @ x), 1.0) / self.parameters.memory))
        self._gram = decay * self._gram + trust * np.outer(unknowns, unknowns)
        _accumulate(self._moments, unknowns, residual, trust, decay)
        return self._solve_some()

    def _solve_some(self) -> bool:
        """Solve for a few vertices of the next ``change``, so that no frame takes long; True when it is complete."""
        n = len(self._deviations)
        part = slice(self._solved, min(self._solved + -(-n // self.parameters.interval), n))
        self._coming[:, part] = self._solution(part)
        self._solved = part.stop
        if part.stop < n:
            return False
        self.change, self._coming, self._solved = self._coming, np.zeros_like(self._coming), 0
        self.updates += 1
        return True

    def _solution(self, part: slice) -> np.ndarray:
        """(A, m, 3) dB of a slice of m vertices."""
        moments = self._moments.reshape(len(self._gram), -1, 3)[:, part]
        solved: np.ndarray = _solutions(self._gram, moments, self._deviations[part], self.parameters.noise**2)
        return solved
