"""Show a picture that is turned by mouse, pen or fingers. The kernel draws it, and the browser only sends the camera."""

from __future__ import annotations

from pathlib import Path

import anywidget
import traitlets

#: Lowest and highest turn and tilt, degrees, and zoom.
LIMITS = ((-90.0, 90.0), (-60.0, 60.0), (0.5, 3.0))


class Turntable(anywidget.AnyWidget):
    """Shows ``value`` (JPEG bytes) and sends ``camera`` (turn, tilt in degrees, zoom) while it is dragged.

    Drag turns and tilts, wheel or two fingers zoom, a double click goes back to straight ahead. Wishes that arrive while
    the kernel draws are merged: only the newest is drawn. ``background``: the page's colour behind the picture, RGB, which the
    browser sends when it differs and when the page's theme changes. ``name`` becomes the picture's CSS class, for tests.
    """

    _esm = Path(__file__).resolve().parents[1] / "assets" / "turntable.js"
    value = traitlets.Bytes(b"").tag(sync=True)
    width = traitlets.Int(300).tag(sync=True)
    height = traitlets.Int(300).tag(sync=True)
    name = traitlets.Unicode("").tag(sync=True)
    camera = traitlets.List(traitlets.Float(), [0.0, 0.0, 1.0], minlen=3, maxlen=3).tag(sync=True)
    background = traitlets.List(traitlets.Int(min=0, max=255), [255, 255, 255], minlen=3, maxlen=3).tag(sync=True)
    limits = traitlets.List([list(pair) for pair in LIMITS]).tag(sync=True)
