"""Re-solve ARKit's shapes, with their left and right halves, from final meshes (section 6).

The paper's 23 generic expressions have no squint, dimple, press or wide eyes, and move brows, lips and nose equally on both
sides. The final mesh v4 shows more than they can express. Therefore the model's expression units, which are ARKit's shapes one
by one, are transferred to the actor's neutral as the 23 expressions are (section 3). Then v4 is solved for them as for the 23,
with bounds and a preference for few shapes. The tracker does not change. The eyeLook shapes are not solved for, because the
lids hardly show where an eye looks.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np

from ..errors import ParameterError
from ..livelink import ARKIT_NAMES
from ..model.actor import Actor
from ..model.blendshapes import deformation_transfer
from ..model.face_model import embedded_face_model
from ..parameters import BlendshapeParameters
from ..tracking.resolve import SparseResolve


@lru_cache(maxsize=1)
def unit_names() -> tuple[str, ...]:
    """The units that are solved for: ARKit names, 43 of the embedded model's 51."""
    return tuple(n for n in embedded_face_model().expression_names if n in ARKIT_NAMES and not n.startswith("eyeLook"))


def has_units(actor: Actor | None) -> bool:
    """Whether the actor's mesh is the embedded model's, whose units can be transferred to it."""
    return actor is not None and np.array_equal(actor.triangles, embedded_face_model().triangles)


class ArkitResolve:
    """Solves the final meshes of one actor for ARKit's curves. The transfer of the units takes a few seconds.

    Parameters
    ----------
    actor : Actor
        The tracked rig.
    parameters : BlendshapeParameters, optional
        Those of the re-solve.

    Raises
    ------
    ParameterError
        The actor's mesh is not the face model's.
    """

    def __init__(self, actor: Actor, parameters: BlendshapeParameters | None = None) -> None:
        if not has_units(actor):
            raise ParameterError("coefficients arkit: the actor's mesh is not the face model's; use resolved")
        model, names = embedded_face_model(), unit_names()
        rows = [model.expression_names.index(name) for name in names]
        shapes = deformation_transfer(model.mean, actor.neutral, model.triangles, model.expressions[rows])
        rig = replace(actor, blendshapes=shapes, expression_names=names)
        self._solve = SparseResolve.of(rig, names, parameters)
        self._columns = [ARKIT_NAMES.index(name) for name in names]

    def __call__(self, vertices: np.ndarray, start: np.ndarray | None = None) -> np.ndarray:
        """Solve one mesh.

        Parameters
        ----------
        vertices : (N, 3)
            Final mesh in the head frame, mm.
        start : (52,), optional
            Curves of the previous frame, at which the solver begins.

        Returns
        -------
        (52,)
            Curves in [0, 1].
        """
        out = np.zeros(len(ARKIT_NAMES))
        solved = self._solve(vertices, None if start is None else start[self._columns])
        out[self._columns] = np.clip(solved, 0.0, 1.0)
        return out
