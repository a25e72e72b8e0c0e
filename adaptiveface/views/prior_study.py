"""For notebook 01: what the prior on the identity coefficients is for. The same scan, fitted with it and without."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from matplotlib.figure import Figure

from ..evaluation import GroundTruth, neutral_alignment, surface_distance
from ..geometry.frame import RgbdFrame
from ..geometry.mesh import transform_points
from ..model.face_model import FaceModel, embedded_face_model
from ..neutral.fit import fit_identity
from ..neutral.fuse import fuse_frames
from ..parameters import FitParameters
from ..pipeline import one_blas_thread
from ..report.pictures import Portraits
from .charts import COLOURS
from .figures import INK, inked, picture
from .session import Session

#: So many times the deviation that people have is as good as none at all: the prior counts 1e-4 of itself.
FREE = 100.0


@dataclass(frozen=True)
class PriorFit:
    """A fit with a prior of so many ``deviations``.

    identity (M,) in the deviations of people; vertices (V, 3) mm; residual: median distance to the scan, mm; matched (V,)
    bool: vertices that the scan shows; error (V,) mm from the true head, NaN where it is not known.
    """

    deviations: float
    identity: np.ndarray
    vertices: np.ndarray
    residual: float
    matched: np.ndarray
    error: np.ndarray

    def median_error(self) -> tuple[float, float]:
        """mm from the true head: where the scan has shown it, and elsewhere."""
        return float(np.median(self.error[self.matched])), float(np.median(self.error[~self.matched]))


def fit_with_prior(
    frames: Sequence[RgbdFrame], deviations: float = 1.0, truth: GroundTruth | None = None, model: FaceModel | None = None
) -> PriorFit:
    """Fuse ``frames`` and fit the identity; coefficients may be ``deviations`` times as large as those of people.

    Modes that are k times as long, with the same prior, are the same as the modes with a prior of k deviations.
    """
    model = model or embedded_face_model()
    with one_blas_thread():
        scan = fuse_frames(frames, model)
        fit = fit_identity(scan, replace(model, identity_modes=deviations * model.identity_modes), FitParameters())
    error = np.full(len(fit.vertices), np.nan)
    if truth is not None:
        scored, everywhere = model.frontal & model.depth_valid, np.ones(len(error), bool)
        aligned = transform_points(neutral_alignment(fit.vertices, truth.neutral, scored), fit.vertices)
        error = surface_distance(aligned, truth.neutral, model.triangles, everywhere)
    return PriorFit(deviations, deviations * fit.identity, fit.vertices, fit.residual, fit.matched, error)


def with_and_without(session: Session, count: int) -> tuple[PriorFit, PriorFit]:
    """The first ``count`` frames that show a face, fitted with the prior and, as good as, without."""
    frames = [frame for frame in session.neutral if frame.features is not None][:count]
    return tuple(fit_with_prior(frames, deviations, session.truth) for deviations in (1.0, FREE))


@inked()
def show_priors(session: Session, fits: Sequence[PriorFit], top: float = 5.0):
    """Heads of several fits from the front and the side, coloured by their error, and their coefficients."""
    figure = Figure(figsize=(8.4, 3.1 * len(fits)), layout="constrained")
    rows = figure.subplots(len(fits), 3, width_ratios=(1, 1, 1.6), squeeze=False)
    portraits = Portraits(session.actor, (300, 360), whole=True)
    for (front, side, bars), fit in zip(rows, fits, strict=True):
        known = np.isfinite(fit.error).any()
        for axis, turn in ((front, 0.0), (side, 60.0)):
            drawn = portraits.draw(fit.vertices, fit.error if known else None, (0, top), turn)
            axis.imshow(drawn)
            axis.axis("off")
        front.set_title("without the prior" if fit.deviations > 1 else "with the prior", fontsize=10)
        side.set_title(f"colour: distance from the true head,\n0 to {top:g} mm" if known else "", fontsize=8)
        bars.bar(np.arange(len(fit.identity)) + 1, fit.identity, color=COLOURS[0])
        bars.axhspan(-2, 2, color=INK, alpha=0.2, lw=0, zorder=0)
        bars.set(ylim=(-6, 6), xlabel="mode", ylabel="standard deviations")
        bars.set_title("coefficients; grey: 95 % of people", fontsize=9)
    return picture(figure, "the head fitted with and without the identity prior, and its coefficients")
