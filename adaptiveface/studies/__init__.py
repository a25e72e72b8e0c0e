"""Draw the paper's figures again from synthetic performances, with ``Parameters.paper()`` and with our defaults.

>>> from adaptiveface.studies import paper_figure
>>> paper_figure(11).save("figures")  # doctest: +SKIP

:mod:`.performances` has what is performed, one module each draws a figure, :mod:`.figure` saves it.
"""

from .figure import FIGURES, PaperFigure, paper_figure
from .performances import EMOTIONS, PARAMETER_SETS, Take

__all__ = ["EMOTIONS", "FIGURES", "PARAMETER_SETS", "PaperFigure", "Take", "paper_figure"]
