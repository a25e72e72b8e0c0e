"""Transfer what the coefficients cannot express, v4 - v1, to the target (paper, section 8, future work).

For a target whose skin has the actor's topology the difference between the final mesh v4 and the blendshapes' v1 is
carried over by deformation transfer: both are transferred from the actor's neutral to the target's neutral with one
factorisation, and their difference is added to what the coefficients make of the target. Deformation transfer is
linear in the deformation gradients, so that the expressions of the target itself stay what they are.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..errors import ParameterError
from ..model.actor import Actor
from ..model.blendshapes import deformation_transfer
from ..result import Result
from .character import Character
from .retarget import driving_coefficients

#: Frames transferred at once: bounds the memory of the right-hand sides.
_CHUNK = 64


def transferred_correctives(
    neutral: np.ndarray, v1: np.ndarray, v4: np.ndarray, target: np.ndarray, triangles: np.ndarray
) -> np.ndarray:
    """(F, V, 3) mm to add to the target's frames.

    neutral (V, 3): the actor's; v1, v4 (F, V, 3): blendshapes and final meshes, head frame; target (V, 3): its neutral;
    triangles (T, 3) of all.
    """
    out = np.empty_like(v4, dtype=float)
    for start in range(0, len(v4), _CHUNK):
        part = slice(start, start + _CHUNK)
        both = np.concatenate([v4[part] - neutral, v1[part] - neutral])
        carried = deformation_transfer(neutral, target, triangles, both)
        count = len(both) // 2
        out[part] = carried[:count] - carried[count:]
    return out


def carried_correctives(
    result: Result, actor: Actor, character: Character, coefficients: str = "resolved"
) -> Callable[[np.ndarray], np.ndarray]:
    """A function that gives the correctives of the frames (f,) that it is asked for: (f, V, 3) mm, zero beyond the skin.

    Parameters
    ----------
    result : Result
        A take of any length; nothing of it is held.
    actor : Actor
        The rig that was tracked.
    character : Character
        Its skin has the actor's mesh.
    coefficients : str
        Those that drive the character: "resolved" or "initial" (v4 - v1 in the paper's sense).

    Raises
    ------
    ParameterError
        The character's skin is not the actor's mesh.
    """
    if not character.shares_topology(actor.triangles):
        raise ParameterError(f"correctives cannot be carried to '{character.name}': its mesh is not the actor's")
    x = driving_coefficients(result, coefficients, actor)
    rows = [actor.expression_names.index(name) for name in result.expression_names]
    basis = actor.blendshapes[rows].reshape(len(rows), -1)
    target = character.neutral[: len(actor.neutral)]

    def carried(frames: np.ndarray) -> np.ndarray:
        """(f, V, 3) mm of frames (f,)."""
        v1 = actor.neutral + (x[frames] @ basis).reshape(len(frames), -1, 3)
        out = np.zeros((len(frames), *character.neutral.shape))
        v4 = result.head_meshes(frames)
        out[:, : len(target)] = transferred_correctives(actor.neutral, v1, v4, target, actor.triangles)
        return out

    return carried
