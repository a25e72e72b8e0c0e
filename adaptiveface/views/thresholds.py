"""Draw a chart with two horizontal lines that can be dragged in the browser."""

from __future__ import annotations

from pathlib import Path

import anywidget
import traitlets


class Thresholds(anywidget.AnyWidget):
    """A picture of a chart with a logarithmic y axis, and two values on that axis as lines that can be dragged.

    Attributes
    ----------
    value : bytes
        The picture, PNG.
    size : list of int
        Its width and height, pixels.
    axes : list of float
        Left, top, right and bottom of the chart's axes, as shares of the picture.
    decades : list of float
        log10 of the ends of the y axis.
    low, high : float
        The lines. Dragging changes them, and low never exceeds high.
    names : dict
        Their names.
    description : str
        Of the picture.
    """

    _esm = Path(__file__).resolve().parents[1] / "assets" / "thresholds.js"
    value = traitlets.Bytes(b"").tag(sync=True)
    size = traitlets.List(traitlets.Int(), [420, 260]).tag(sync=True)
    axes = traitlets.List(traitlets.Float(), [0.0, 0.0, 1.0, 1.0]).tag(sync=True)
    decades = traitlets.List(traitlets.Float(), [0.0, 1.0]).tag(sync=True)
    low = traitlets.Float(1.0).tag(sync=True)
    high = traitlets.Float(10.0).tag(sync=True)
    names = traitlets.Dict({"low": "low", "high": "high"}).tag(sync=True)
    description = traitlets.Unicode("").tag(sync=True)
