"""Matplotlib's figures as pictures in a cell's output: no global state, no widget, the same in a page as in JupyterLab."""

from __future__ import annotations

import io

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure


def picture(figure: Figure, words: str, dpi: int = 110):
    """The figure as a PNG that IPython displays; ``words`` say what it shows, for those who do not see it."""
    from IPython.display import Image

    FigureCanvasAgg(figure)
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=dpi)
    return Image(data=stream.getvalue(), format="png", alt=words)
