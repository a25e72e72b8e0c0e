"""Matplotlib's figures as pictures for light and dark pages: transparent, with text in a grey that reads on both.

A picture cannot ask the page for its colours, and a saved notebook may be opened in JupyterLab, in VS Code or as HTML.
"""

from __future__ import annotations

import io
from functools import partial
from typing import TYPE_CHECKING

import matplotlib
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

if TYPE_CHECKING:
    from matplotlib.typing import RcKeyType

#: Text, ticks and frames. Its contrast is 4.2 to 1 or more with white and with JupyterLab's dark #111111.
INK = "#7a7a7a"
_STYLE: dict[RcKeyType, object] = {
    **dict.fromkeys(("figure.facecolor", "axes.facecolor", "savefig.facecolor", "legend.facecolor"), "none"),
    **dict.fromkeys(("text.color", "axes.labelcolor", "axes.edgecolor", "xtick.color", "ytick.color", "grid.color"), INK),
    "legend.frameon": False,
}


#: Inside ``with inked():``, or in a function decorated by ``@inked()``, new axes are transparent and their text is in INK.
inked = partial(matplotlib.rc_context, _STYLE)


def pixels(canvas: FigureCanvasAgg) -> np.ndarray:
    """The drawn picture as RGBA, (H, W, 4) uint8."""
    return np.asarray(canvas.buffer_rgba())


def picture(figure: Figure, words: str, dpi: int = 110):
    """Return the figure as a PNG for IPython. ``words`` describe it for people who cannot see it."""
    from IPython.display import Image

    FigureCanvasAgg(figure)
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=dpi, facecolor="none")
    return Image(data=stream.getvalue(), format="png", alt=words)
