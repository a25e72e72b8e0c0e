"""Export the eyes, teeth and tongue of a tracked actor as a second animated mesh."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..insides import Insides, make_insides
from ..model.actor import Actor
from ..result import Result
from .animation import AnimatedMesh, in_slider_range
from .components import principal_targets

#: Largest error of a part in a file, mm.
TOLERANCE = 0.05


def actor_insides(result: Result, actor: Actor | None = None) -> Insides | None:
    """The parts, fitted to the actor's neutral or to the mean of all frames; None for the mesh of another model."""
    if actor is not None:
        return make_insides(actor.neutral, actor.triangles)
    mean = sum(meshes.sum(axis=0) for _, meshes in result.head_blocks()) / len(result)
    return make_insides(mean, result.triangles)


def with_insides(mesh: AnimatedMesh, result: Result, actor: Actor | None = None) -> AnimatedMesh:
    """Add :attr:`AnimatedMesh.inside` to the actor's animated mesh. A mesh of another model is returned unchanged.

    The skin does not change. The morph targets of the parts are principal components of their motion, within
    :data:`TOLERANCE` mm.
    """
    insides = actor_insides(result, actor)
    if insides is None:
        return mesh
    rest = insides.at(insides.neutral_skin)

    def moved(frames: np.ndarray) -> np.ndarray:
        """(f, P, 3) mm of frames (f,)."""
        gaze = np.zeros((len(frames), 2, 2)) if result.gaze is None else result.gaze[frames].astype(float)
        return np.stack([insides.at(*pair) for pair in zip(result.head_meshes(frames), gaze, strict=True)]) - rest

    targets, weights = principal_targets(moved, len(result), TOLERANCE)
    names = tuple(f"inside{k:03d}" for k in range(len(targets)))
    inside = replace(
        mesh,
        name="insides",
        neutral=rest,
        triangles=insides.triangles,
        target_names=names,
        targets=targets,
        weights=weights,
        colours=insides.colours,
    )
    return replace(mesh, inside=in_slider_range(inside))
