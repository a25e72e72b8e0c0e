"""Show for notebook 04 the coefficients of one frame's fit, and those of a whole performance."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from ..studies.session import Session
from .charts import COLOURS, LiveChart
from .figures import INK, inked, picture
from .replay import Replay


@inked()
def coefficient_bars(names: Sequence[str], solutions: dict[str, np.ndarray], title: str = ""):
    """Draw the coefficients of several solutions as bars, with the allowed range [0, 1] in grey.

    Parameters
    ----------
    names : sequence of str
        Of the A expressions.
    solutions : dict
        Coefficients (A,) by the name of the solution.
    title : str
        Of the figure.

    Returns
    -------
    IPython.display.Image
        A PNG, which saved notebooks keep.
    """
    figure = Figure(figsize=(9.2, 3.6), dpi=100, layout="constrained")
    axis = figure.add_subplot()
    axis.axhspan(0, 1, color=INK, alpha=0.2, lw=0, zorder=0)
    width = 0.8 / len(solutions)
    for k, (name, x) in enumerate(solutions.items()):
        axis.bar(np.arange(len(x)) + (k - (len(solutions) - 1) / 2) * width, x, width, color=COLOURS[k], label=name)
    axis.set_xticks(range(len(names)), names, rotation=60, ha="right", fontsize=8)
    axis.set_ylabel("coefficient (grey: allowed)", fontsize=9)
    axis.set_title(title, fontsize=9)
    axis.legend(fontsize=8)
    return picture(figure, f"coefficients of the solutions {', '.join(solutions)}, and the allowed range from 0 to 1", dpi=100)


def coefficient_chart(session: Session, chosen: Sequence[int]):
    """Make a chart of the fitted coefficients of some expressions over the performance.

    Parameters
    ----------
    session : Session
        The performance.
    chosen : sequence of int
        Numbers of the expressions.

    Returns
    -------
    (LiveChart, ChartSource)
        The chart and its source, for a :class:`~adaptiveface.views.StageExplorer`.
    """
    names = [session.actor.expression_names[k] for k in chosen]
    chart = LiveChart(names, (0, len(session.frames) - 1), (-0.05, 1.05), "frame", "coefficient", "the liveliest coefficients")

    def lines(replay: Replay) -> dict[str, np.ndarray]:
        out = {name: np.full(len(replay.frames), np.nan) for name in names}
        for index, result in enumerate(replay.results):
            if result is not None and result.tracked:
                for name, k in zip(names, chosen, strict=True):
                    if k < len(result.coefficients_initial):  # there are fewer if the parameter A is lowered
                        out[name][index] = result.coefficients_initial[k]
        return out

    return chart, lines
