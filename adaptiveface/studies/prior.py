"""Fit the same scan with the prior on the identity coefficients and without it (section 3)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..evaluation import GroundTruth, neutral_alignment, surface_distance
from ..geometry.frame import RgbdFrame
from ..geometry.mesh import transform_points
from ..model.face_model import FaceModel, embedded_face_model
from ..neutral.fit import fit_identity
from ..neutral.fuse import fuse_frames
from ..parameters import FitParameters
from ..pipeline import one_thread
from .session import Session

#: With this multiple of people's deviations, the prior counts 1e-4 of itself, which is practically nothing.
FREE = 100.0


@dataclass(frozen=True)
class PriorFit:
    """A head that was fitted to a scan with a weaker or a stronger prior.

    Attributes
    ----------
    deviations : float
        How many times as large as those of people the coefficients may be.
    identity : (M,)
        The fitted coefficients, in standard deviations of people.
    vertices : (V, 3)
        The fitted head, mm.
    residual : float
        Median distance to the scan, mm.
    matched : (V,) bool
        Vertices that the scan shows.
    error : (V,)
        Distance from the true head, mm; NaN where it is not known.
    """

    deviations: float
    identity: np.ndarray
    vertices: np.ndarray
    residual: float
    matched: np.ndarray
    error: np.ndarray

    def median_error(self) -> tuple[float, float]:
        """Median distances from the true head, mm: of the vertices that the scan shows, and of the others."""
        return float(np.median(self.error[self.matched])), float(np.median(self.error[~self.matched]))


def fit_with_prior(
    frames: Sequence[RgbdFrame], deviations: float = 1.0, truth: GroundTruth | None = None, model: FaceModel | None = None
) -> PriorFit:
    """Fuse frames and fit the identity with a prior of another strength.

    Modes that are k times as long, with the same prior, are the same as the modes with a prior of k deviations.

    Parameters
    ----------
    frames : sequence of RgbdFrame
        Frames of the neutral face.
    deviations : float
        How many times as large as those of people the coefficients may be.
    truth : GroundTruth, optional
        Of the same performer, for the error.
    model : FaceModel, optional
        The embedded one by default.

    Returns
    -------
    PriorFit
        The fitted head and its error.
    """
    model = model or embedded_face_model()
    with one_thread():
        scan = fuse_frames(frames, model)
        fit = fit_identity(scan, replace(model, identity_modes=deviations * model.identity_modes), FitParameters())
    error = np.full(len(fit.vertices), np.nan)
    if truth is not None:
        scored, everywhere = model.frontal & model.depth_valid, np.ones(len(error), bool)
        aligned = transform_points(neutral_alignment(fit.vertices, truth.neutral, scored), fit.vertices)
        error = surface_distance(aligned, truth.neutral, model.triangles, everywhere)
    return PriorFit(deviations, deviations * fit.identity, fit.vertices, fit.residual, fit.matched, error)


def with_and_without(session: Session, count: int) -> tuple[PriorFit, PriorFit]:
    """Fit the first ``count`` frames that show a face with the prior, and practically without it."""
    frames = [frame for frame in session.neutral if frame.features is not None][:count]
    return fit_with_prior(frames, 1.0, session.truth), fit_with_prior(frames, FREE, session.truth)
