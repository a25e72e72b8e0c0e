"""Coefficients re-solved from the final mesh (section 6), with the preference for few expressions.

The plain bounded fit of the blendshapes to v4 spreads what they cannot express over many small coefficients, since v4
holds more than the initial fit saw: it comes out no closer to the true coefficients than the initial ones. Faces use
few expressions at a time. So the fit is

    min_x |B x - (v4 - b0)|^2 + ridge |x|^2 + 2 sparsity sum_k |b_k| x_k,   0 <= x <= 1

over the frontal region, a non-negative lasso (Tibshirani 1996) whose penalty weighs every expression by its size |b_k|:
as if every expression had to explain at least ``sparsity`` mm (root of the summed squares over the face) to take part.
``data_synth/evaluate_retargeting.py`` prints what it brings.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..actor import Actor
from ..errors import FileFormatError
from ..tracking.bounded import bounded_least_squares

#: mm over a face of this many frontal vertices; chosen on performers 3 to 6.
SPARSITY, REFERENCE_VERTICES = 2.5, 3500
RIDGE = 10.0


class SparseResolve:
    """Re-solves coefficients of ``names`` (A,) for one actor; ``sparsity`` 0 is the plain bounded fit."""

    def __init__(self, actor: Actor, names: Sequence[str], sparsity: float = SPARSITY, ridge: float = RIDGE) -> None:
        missing = [name for name in names if name not in actor.expression_names]
        if missing:
            raise FileFormatError(f"the actor lacks the expressions {', '.join(missing)[:200]}")
        rows = [actor.expression_names.index(name) for name in names]
        self._frontal = actor.frontal
        self._neutral = actor.neutral[actor.frontal]
        self._basis = actor.blendshapes[rows][:, actor.frontal].reshape(len(rows), -1)
        gram = self._basis @ self._basis.T
        scale = sparsity * np.sqrt(actor.frontal.sum() / REFERENCE_VERTICES)
        self._penalty = scale * np.sqrt(np.diag(gram))
        self._gram = gram + ridge * np.eye(len(rows))

    def __call__(self, vertices: np.ndarray, start: np.ndarray | None = None) -> np.ndarray:
        """(A,) coefficients in [0, 1] of a mesh (N, 3) in the head frame; ``start`` (A,) a first guess."""
        displacement = (vertices[self._frontal] - self._neutral).ravel()
        count = len(self._penalty)
        return bounded_least_squares(self._gram, self._basis @ displacement - self._penalty, np.zeros(count),
                                     np.ones(count), start)  # fmt: skip
