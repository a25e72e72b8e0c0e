"""Compute what notebooks and papers show, without widgets: printed equations, fits, ICP iterates, sweeps, the paper's figures.

A figure of the paper is drawn again from synthetic performances, with ``Parameters.paper()`` and with our defaults:

>>> from adaptiveface.studies import paper_figure
>>> paper_figure(11).save("figures")  # doctest: +SKIP

:mod:`.performances` has what is performed. One module draws each figure, and :mod:`.figure` saves it.

The other modules hold the mathematics of the notebooks. :mod:`.session` loads a performance, and :mod:`.measures` scores its
frames. :mod:`.closest`, :mod:`.prior` and :mod:`.expression_transfer` are about section 3, :mod:`.icp` about 4.1, :mod:`.fit`
about 4.2, :mod:`.printed_equation`, :mod:`.laplacians` and :mod:`.skin` about 4.3, :mod:`.learning` about section 5, and
:mod:`.sweep` tracks a performance with many parameters.
"""

from .figure import FIGURES, PaperFigure, paper_figure
from .performances import EMOTIONS, PARAMETER_SETS, Take

__all__ = ["EMOTIONS", "FIGURES", "PARAMETER_SETS", "PaperFigure", "Take", "paper_figure"]
