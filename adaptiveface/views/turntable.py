"""Show a picture that mouse, pen or fingers turn. The kernel draws it, and the browser only sends the camera."""

from __future__ import annotations

from pathlib import Path

import anywidget
import traitlets

#: Lowest and highest turn (degrees), tilt (degrees) and zoom.
LIMITS = ((-90.0, 90.0), (-60.0, 60.0), (0.5, 3.0))


class Turntable(anywidget.AnyWidget):
    """Shows ``value`` (JPEG bytes) and sends ``camera`` (turn, tilt in degrees, zoom) while it is dragged.

    Dragging turns and tilts, the wheel or two fingers zoom, and a double click goes back to straight ahead. Of several
    cameras that arrive while the kernel draws, only the newest is drawn. ``background`` is the page's RGB colour behind the
    picture. The browser sends it if it differs, and when the page's theme changes. ``name`` is the CSS class, for tests.
    """

    _esm = Path(__file__).resolve().parents[1] / "assets" / "turntable.js"
    value = traitlets.Bytes(b"").tag(sync=True)
    width = traitlets.Int(300).tag(sync=True)
    height = traitlets.Int(300).tag(sync=True)
    name = traitlets.Unicode("").tag(sync=True)
    camera = traitlets.List(traitlets.Float(), [0.0, 0.0, 1.0], minlen=3, maxlen=3).tag(sync=True)
    background = traitlets.List(traitlets.Int(min=0, max=255), [255, 255, 255], minlen=3, maxlen=3).tag(sync=True)
    limits = traitlets.List([list(pair) for pair in LIMITS]).tag(sync=True)
