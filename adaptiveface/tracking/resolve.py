"""Re-solve coefficients from a final mesh (section 6), in every frame of the tracker and afterwards for retargeting."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import replace
from typing import Self

import numpy as np
import numpy.typing as npt

from ..errors import FileFormatError
from ..geometry.frame import FEATURE_REGIONS
from ..model.actor import Actor
from ..parameters import BlendshapeParameters
from .bounded import BoundedSolver, bounded_least_squares, sparse_least_squares
from .expression_prior import habit_penalty, habit_trust, lips_count, lips_nearness

#: Number of frontal vertices for which ``blendshapes.sparsity`` holds.
SPARSITY_VERTICES = 3500
#: Vertices that are less near to the lips (:func:`.lips_nearness`) count as all others.
_FAR = 0.01


class SparseResolve:
    """Finds few bounded coefficients that explain a mesh over the frontal region.

    There are two departures from the paper: the penalty of :func:`sparsity_penalty`, and the habits of real faces
    (:mod:`.expression_prior`), which count as much as the expressions misfit the mesh, and with which the lips count more.
    With ``sparsity`` and ``expression_prior`` 0 this is the plain bounded fit.

    Parameters
    ----------
    actor : Actor
        Has the neutral and the frontal region.
    basis : (A, N, 3)
        Expressions as displacements from the neutral, mm.
    parameters : BlendshapeParameters
        ``sparsity``, ``ridge``, ``expression_prior`` and the bounds of the coefficients are used.
    dtype : dtype
        Of the basis by which meshes are multiplied. Single precision halves the memory to stream in every frame. The normal
        equations' matrix is in double precision in both cases.
    solver : callable
        Solves the bounded problem.
    """

    def __init__(
        self,
        actor: Actor,
        basis: np.ndarray,
        parameters: BlendshapeParameters,
        dtype: npt.DTypeLike = np.float64,
        solver: BoundedSolver = bounded_least_squares,
    ) -> None:
        count, self._dtype, self._solver, self._parameters = len(basis), dtype, solver, parameters
        self._frontal = np.flatnonzero(actor.frontal)
        self._neutral = actor.neutral[self._frontal]
        self._habits = parameters.expression_prior * habit_penalty(actor.expression_names[:count])
        self._has_habits = bool(self._habits.any())
        self._bounds = np.full(count, parameters.lower), np.full(count, parameters.upper)
        nearness = lips_nearness(self._neutral, _lips(actor))
        self._near_lips = np.flatnonzero(nearness > _FAR)
        self._lips_weights = np.repeat(nearness[self._near_lips], 3)
        self._take(basis)

    def _take(self, basis: np.ndarray) -> None:
        """Solve for the expressions ``basis`` (A, N, 3), mm."""
        count, p = len(basis), self._parameters
        shapes = basis.take(self._frontal, axis=1)
        rows = shapes.reshape(count, -1)
        gram = rows @ rows.T
        self._basis = rows.astype(self._dtype, copy=False)
        self._penalty = sparsity_penalty(gram, p.sparsity, len(self._frontal))
        self._gram, self._matrix = gram, gram + p.ridge * np.eye(count)
        at_lips = shapes.take(self._near_lips, axis=1).reshape(count, -1)
        weighted = at_lips * self._lips_weights
        self._lips, self._lips_gram = weighted.astype(self._dtype, copy=False), weighted @ at_lips.T

    def with_basis(self, basis: np.ndarray) -> Self:
        """The same re-solve with other meshes (A, N, 3) of the same expressions, mm."""
        out = copy.copy(self)
        out._take(basis)
        return out

    @classmethod
    def of(cls, actor: Actor, names: Sequence[str], parameters: BlendshapeParameters | None = None) -> Self:
        """Make the solver for the expressions ``names`` (A,) of an actor; raises :class:`FileFormatError` if it lacks one."""
        missing = [name for name in names if name not in actor.expression_names]
        if missing:
            raise FileFormatError(f"the actor lacks the expressions {', '.join(missing)[:200]}")
        rows = [actor.expression_names.index(name) for name in names]
        rig = replace(actor, blendshapes=actor.blendshapes[rows], expression_names=tuple(names))
        return cls(rig, rig.blendshapes, parameters or BlendshapeParameters())

    def __call__(self, vertices: np.ndarray, start: np.ndarray | None = None) -> np.ndarray:
        """Find the coefficients (A,) of a mesh (N, 3) in the head frame, mm. ``start`` (A,) is a first guess."""
        offsets = (vertices.take(self._frontal, axis=0) - self._neutral).astype(self._dtype, copy=False)
        displacement = offsets.ravel()
        g = self._basis @ displacement
        x = self._solve(self._matrix, g, start)
        if not self._has_habits:
            return x
        trust = habit_trust(float(displacement @ displacement) - 2.0 * g @ x + x @ self._gram @ x, len(self._frontal))
        if trust == 0.0:
            return x
        more = lips_count(trust)
        g = g + more * (self._lips @ offsets.take(self._near_lips, axis=0).ravel())
        return self._solve(self._matrix + more * self._lips_gram + trust * self._habits, g, x)

    def _solve(self, matrix: np.ndarray, g: np.ndarray, start: np.ndarray | None) -> np.ndarray:
        return few_coefficients(matrix, g, self._penalty, *self._bounds, start, self._solver)


def _lips(actor: Actor) -> np.ndarray:
    """(m, 3) the features of the lips on the actor's neutral, mm."""
    lips = np.flatnonzero(FEATURE_REGIONS == "lips")  # the 40 features come first; without depth, landmarks follow them
    points: np.ndarray = np.einsum("fk,fkd->fd", actor.feature_weights[lips], actor.neutral[actor.feature_triangles[lips]])
    return points


def few_coefficients(
    h: np.ndarray,
    g: np.ndarray,
    penalty: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
    start: np.ndarray | None = None,
    solver: BoundedSolver = bounded_least_squares,
) -> np.ndarray:
    """Minimise x^T H x / 2 - g^T x + sum_k penalty_k |x_k| within bounds (A,); returns (A,).

    If no coefficient may be negative, the penalty is linear, and the plain bounded ``solver`` suffices.
    """
    if (lower >= 0.0).all():
        return solver(h, g - penalty, lower, upper, start)
    return sparse_least_squares(h, g, penalty, lower, upper, start)


def sparsity_penalty(gram: np.ndarray, sparsity: float, vertices: int) -> np.ndarray:
    """Half the weights (A,) of sum_k w_k |x_k| in the re-solve of section 6, from gram (A, A) = B^T B over ``vertices``.

    v4 contains more than the blendshapes can express, and a plain bounded fit spreads the rest over many small coefficients.
    Its result is hardly closer to known coefficients than the initial fit (``data_synth/evaluate_retargeting.py``). Faces use
    few expressions at a time. Therefore an expression is only used if it explains at least ``sparsity`` mm (root of the summed
    squares over the face). This is a lasso (Tibshirani 1996) within bounds that weighs every expression by its size |b_k|.
    """
    return np.asarray(sparsity * np.sqrt(vertices / SPARSITY_VERTICES) * np.sqrt(np.diag(gram)))
