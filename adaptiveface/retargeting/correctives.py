"""Transfer what the coefficients cannot express, v4 - v1, to the target (paper, section 8, future work).

The target's skin must have the actor's topology. Deformation transfer carries both the final mesh v4 and the blendshapes' v1
from the actor's neutral to the target's neutral, with one factorisation. The difference of the two is added to the target's
own expressions, which do not change: deformation transfer is linear in the deformation gradients.
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

#: How many frames are transferred at once. This bounds the memory of the right-hand sides.
_CHUNK = 64


def transferred_correctives(
    neutral: np.ndarray, v1: np.ndarray, v4: np.ndarray, target: np.ndarray, triangles: np.ndarray
) -> np.ndarray:
    """Transfer v4 - v1 from the actor to a target.

    Parameters
    ----------
    neutral : (V, 3)
        The actor's neutral, mm.
    v1, v4 : (F, V, 3)
        Meshes of the blendshapes and final meshes, head frame, mm.
    target : (V, 3)
        The target's neutral, mm.
    triangles : (T, 3)
        Of all these meshes.

    Returns
    -------
    (F, V, 3)
        What to add to the target's frames, mm.
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
    """Make a function that computes a character's correctives for any frames.

    Parameters
    ----------
    result : Result
        A take of any length.
    actor : Actor
        The rig that was tracked.
    character : Character
        Its skin must have the actor's topology.
    coefficients : str
        What drives the character: "resolved" or "initial" (v4 - v1 in the paper's sense).

    Returns
    -------
    callable
        Takes frame numbers (f,) and returns (f, V, 3) mm, which is zero beyond the skin.

    Raises
    ------
    ParameterError
        The character's skin has another topology.
    """
    if not character.shares_topology(actor.triangles):
        raise ParameterError(f"correctives cannot be carried to '{character.name}': its mesh is not the actor's")
    x = driving_coefficients(result, coefficients, actor)
    actor = result.rig(actor)
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
