"""Widgets that leave a picture behind: in a saved notebook, and in what is made of it without a kernel."""

from __future__ import annotations

import base64
from collections.abc import Callable, Sequence

import ipywidgets as widgets
import numpy as np

from .pictures import encode


class Pictured(widgets.VBox):
    """A column of widgets that is stored with ``picture()``, (H, W, 3) uint8, as it looks when it is displayed."""

    def __init__(self, children: Sequence[widgets.Widget], picture: Callable[[], np.ndarray], **options) -> None:
        super().__init__(children, **options)
        self._picture = picture

    def _repr_mimebundle_(self, **options) -> dict:
        """What Jupyter shows: the widget, and where there is none, the picture."""
        png = base64.b64encode(encode(self._picture(), "png")).decode("ascii")
        return {**super()._repr_mimebundle_(**options), "image/png": png}
