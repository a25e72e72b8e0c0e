"""A chart with two horizontal lines that are dragged in the browser."""

from __future__ import annotations

from pathlib import Path

import anywidget
import traitlets


class Thresholds(anywidget.AnyWidget):
    """A picture of a chart whose y axis is logarithmic, and two values on that axis as lines that can be dragged.

    ``value``: the picture, PNG; ``size`` (width, height) pixels. ``axes`` (left, top, right, bottom) of the chart's axes, in
    shares of the picture; ``decades``: log10 of the y axis' ends. ``low`` and ``high``: the lines; dragging changes them, and
    low never exceeds high. ``names``: what they are called; ``description``: of the picture.
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
