"""Show for notebook 01 what the prior on the identity coefficients does to the fit of one scan."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from ..report.pictures import Portraits
from ..studies.prior import PriorFit
from ..studies.session import Session
from .charts import COLOURS
from .figures import INK, inked, picture


@inked()
def show_priors(session: Session, fits: Sequence[PriorFit], top: float = 5.0):
    """Draw the heads of several fits from the front and the side, coloured by their error, with their coefficients.

    Parameters
    ----------
    session : Session
        The performance.
    fits : sequence of PriorFit
        One row each.
    top : float
        Upper end of the colours' range, mm.

    Returns
    -------
    IPython.display.Image
        A PNG, which saved notebooks keep.
    """
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
