"""Find the blendshapes that come closest to a true face, and measure a neutral head against the truth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..evaluation import GroundTruth, neutral_alignment, surface_distance
from ..geometry.mesh import transform_points
from ..model.face_model import embedded_face_model
from ..tracking.bounded import bounded_least_squares
from .session import Session


def distance_to_truth(head: np.ndarray, truth: GroundTruth) -> np.ndarray:
    """Measure a neutral head against the truth.

    Parameters
    ----------
    head : (V, 3)
        The head in the head frame, mm.
    truth : GroundTruth
        Of the performer.

    Returns
    -------
    (n,)
        Distances of the frontal vertices that take depth from the true face, mm.
    """
    model = embedded_face_model()
    scored = model.frontal & model.depth_valid
    aligned = transform_points(neutral_alignment(head, truth.neutral, scored), head)
    return surface_distance(aligned, truth.neutral, model.triangles, scored)


@dataclass(frozen=True)
class ClosestExpression:
    """The blendshapes that come closest to a true face.

    Attributes
    ----------
    index : int
        Number of the frame.
    motion : (V, 3)
        The true motion from the neutral face, mm.
    coefficients : (A,)
        The closest coefficients in [0, 1].
    remaining : (V,)
        What they leave of the motion, mm; NaN outside the frontal region.
    """

    index: int
    motion: np.ndarray
    coefficients: np.ndarray
    remaining: np.ndarray


def closest_expression(session: Session) -> ClosestExpression:
    """Find the frame with the largest true motion in a session whose truth is known, and the closest blendshapes."""
    actor, frontal = session.actor, session.actor.frontal
    assert session.truth is not None
    truths = [session.truth[frame.index] for frame in session.frames]
    motions = [transform_points(np.linalg.inv(t.head_pose), t.vertices) - session.truth.neutral for t in truths]
    index = int(np.argmax([np.linalg.norm(m[frontal], axis=1).mean() for m in motions]))
    basis, motion = actor.blendshapes[:, frontal].reshape(len(actor.blendshapes), -1), motions[index]
    count = len(basis)
    x = bounded_least_squares(
        basis @ basis.T + 1e-6 * np.eye(count), basis @ motion[frontal].ravel(), np.zeros(count), np.ones(count)
    )
    remaining = np.full(len(frontal), np.nan)
    remaining[frontal] = np.linalg.norm((motion[frontal].ravel() - x @ basis).reshape(-1, 3), axis=1)
    return ClosestExpression(index, motion, x, remaining)
