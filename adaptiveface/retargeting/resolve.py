"""Coefficients re-solved from final meshes (section 6) of any expressions of an actor, after the fact.

As the tracker does for every frame (:func:`adaptiveface.tracking.expression.sparsity_penalty` says why few coefficients).
``data_synth/evaluate_retargeting.py`` prints what it brings.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..actor import Actor
from ..errors import FileFormatError
from ..parameters import BlendshapeParameters, Parameters
from ..result import Result
from ..tracking.expression import few_coefficients, sparsity_penalty

SPARSITY, RIDGE = BlendshapeParameters().sparsity, BlendshapeParameters().ridge


class SparseResolve:
    """Re-solves coefficients of ``names`` (A,) for one actor; ``sparsity`` 0 is the plain bounded fit."""

    def __init__(
        self,
        actor: Actor,
        names: Sequence[str],
        sparsity: float = SPARSITY,
        ridge: float = RIDGE,
        lower: float = 0.0,
        upper: float = 1.0,
    ) -> None:
        missing = [name for name in names if name not in actor.expression_names]
        if missing:
            raise FileFormatError(f"the actor lacks the expressions {', '.join(missing)[:200]}")
        rows = [actor.expression_names.index(name) for name in names]
        self._frontal = actor.frontal
        self._neutral = actor.neutral[actor.frontal]
        self._basis = actor.blendshapes[rows][:, actor.frontal].reshape(len(rows), -1)
        gram = self._basis @ self._basis.T
        self._penalty = sparsity_penalty(gram, sparsity, int(actor.frontal.sum()))
        self._gram = gram + ridge * np.eye(len(rows))
        self._bounds = np.full(len(rows), float(lower)), np.full(len(rows), float(upper))

    @classmethod
    def as_tracked(cls, actor: Actor, names: Sequence[str], parameters: BlendshapeParameters) -> SparseResolve:
        """The re-solve of a run with these parameters."""
        return cls(actor, names, parameters.sparsity, parameters.ridge, parameters.lower, parameters.upper)

    def __call__(self, vertices: np.ndarray, start: np.ndarray | None = None) -> np.ndarray:
        """(A,) coefficients within the bounds of a mesh (N, 3) in the head frame; ``start`` (A,) a first guess."""
        displacement = (vertices[self._frontal] - self._neutral).ravel()
        return few_coefficients(self._gram, self._basis @ displacement, self._penalty, *self._bounds, start)


def blendshape_parameters(result: Result) -> BlendshapeParameters:
    """The parameters of the blendshape fit with which a result was tracked. Raises :class:`ParameterError`."""
    stages = Parameters.stored(result.parameters)
    return Parameters().set(**{f"blendshapes.{name}": v for name, v in stages.get("blendshapes", {}).items()}).blendshapes
