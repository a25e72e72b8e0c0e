"""The widget that draws heads and clouds in the browser: geometry once, then positions and values as bytes."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import anywidget
import numpy as np
import traitlets
from matplotlib import colormaps

from ..insides import Insides

#: Lowest and highest turn and tilt, degrees, and zoom.
BOUNDS = ((-90.0, 90.0), (-60.0, 60.0), (0.5, 3.0))
#: Positions are sent as whole numbers of this many mm, 16 bits each: up to 512 mm from the origin of the head frame.
STEP_MM = 1 / 64
#: The code of a value that is not known; the others are 0 .. 65534 between the ends of their range.
UNKNOWN = 65535


class Heads(anywidget.AnyWidget):
    """Panes of heads and points on one canvas; sources in ``js/src``. Turning and zooming stay in the browser.

    ``geometry``: of every pane, see :func:`geometry`; ``rests``: of every pane the rigid parts inside its head at rest, which
    another person's head changes; ``frame``: what every pane shows, see :func:`shape`, :func:`inside` and :func:`points`.
    ``grid`` (columns, rows); ``pane`` (width, height) pixels; ``limits``, ``label``, ``palette`` (RGB bytes) of the heat map.
    ``camera`` (turn, tilt in degrees, zoom) is only ever sent to the browser. ``differs``: there is a difference that
    ``exaggeration`` can enlarge. ``renderer``: "webgl", "canvas" (needs no WebGL) or "auto", which is the canvas where WebGL is
    done by the processor. ``name`` becomes the canvas's CSS class, for tests.
    """

    _esm = Path(__file__).resolve().parents[1] / "assets" / "heads.js"
    geometry = traitlets.List().tag(sync=True)
    rests = traitlets.List(traitlets.Bytes()).tag(sync=True)
    frame = traitlets.List().tag(sync=True)
    titles = traitlets.List(traitlets.Unicode()).tag(sync=True)
    grid = traitlets.List(traitlets.Int(), [1, 1]).tag(sync=True)
    pane = traitlets.List(traitlets.Int(), [380, 420]).tag(sync=True)
    centre = traitlets.List(traitlets.Float(), [0.0, 0.0, 0.0]).tag(sync=True)
    radius = traitlets.Float(138.0).tag(sync=True)
    limits = traitlets.List(traitlets.Float(), [0.0, 1.0]).tag(sync=True)
    label = traitlets.Unicode("").tag(sync=True)
    palette = traitlets.Bytes(b"").tag(sync=True)
    camera = traitlets.List(traitlets.Float(), [0.0, 0.0, 1.0]).tag(sync=True)
    bounds = traitlets.List([list(pair) for pair in BOUNDS]).tag(sync=True)
    differs = traitlets.Bool(False).tag(sync=True)
    exaggeration = traitlets.Float(1.0).tag(sync=True)
    renderer = traitlets.Enum(["auto", "webgl", "canvas"], "auto").tag(sync=True)
    name = traitlets.Unicode("adaptiveface-face").tag(sync=True)
    still: Callable[[], np.ndarray] | None = None  #: draws the picture that stays without a browser, (H, W, 3) uint8

    def own_traits(self) -> list[str]:
        """The names of what the browser has of this view."""
        return [name for name, trait in Heads.class_own_traits().items() if trait.metadata.get("sync")]


def palette(colourmap: str) -> bytes:
    """256 RGB colours of a matplotlib colour map."""
    return (colormaps[colourmap](np.linspace(0, 1, 256))[:, :3] * 255).round().astype(np.uint8).tobytes()


class Moving:
    """The vertices of a head that move (N,) bool, and where all of them rest, (N, 3) mm: of the others nothing need be sent."""

    def __init__(self, mask: np.ndarray, rest: np.ndarray) -> None:
        self.mask, self.rest = mask, _whole(rest)

    def sent(self) -> dict:
        """What the browser has to know of it."""
        return {"moving": np.flatnonzero(self.mask).astype("<u4").tobytes(), "rest": self.rest.tobytes()}

    def positions(self, whole: np.ndarray) -> np.ndarray:
        """Of positions (N, 3) in whole steps those that have to be sent."""
        return whole[self.mask] if np.array_equal(whole[~self.mask], self.rest[~self.mask]) else whole

    def values(self, codes: np.ndarray) -> np.ndarray:
        """Of codes (N,) those that have to be sent; the others are unknown."""
        return codes[self.mask] if len(codes) and (codes[~self.mask] == UNKNOWN).all() else codes


def geometry(count: int, triangles: np.ndarray, colours: np.ndarray | None = None, insides: Insides | None = None) -> dict:
    """What a pane's head is made of: number of vertices, triangles (T, 3), colours (N, 3) uint8 or None for skin."""
    own = b"" if colours is None else np.asarray(colours, np.uint8).tobytes()
    out = {"count": count, "triangles": np.asarray(triangles, np.uint32).tobytes(), "colours": own or None}
    if insides is not None:
        parts = geometry(len(insides.part), insides.triangles, insides.colours)
        out["inside"] = parts | {"part": insides.part.tobytes()}
    return out


def rest(insides: Insides | None) -> bytes:
    """Eyeballs, teeth and tongue where their placement is the identity."""
    return b"" if insides is None else _steps(insides.rest)


def inside(placements: np.ndarray, soft: np.ndarray) -> dict:
    """Where what is inside a head has moved: :meth:`~adaptiveface.insides.Insides.motion`, some 2 kB instead of 18."""
    return {"placements": np.asarray(placements, "<f4").tobytes(), "soft": _steps(soft)}


def shape(
    vertices: np.ndarray,
    heat: np.ndarray | None,
    differs: bool = False,
    visible: bool = True,
    moving: Moving | None = None,
) -> dict:
    """What a pane's head looks like: vertices (N, 3) mm, heat (N,) or None; fewer of both with ``moving``.

    ``differs``: from the first pane's head, and the difference can be drawn larger than it is.
    """
    codes, span = _codes(heat)
    positions = _whole(vertices)
    if moving is not None:
        positions, codes = moving.positions(positions), moving.values(codes)
    sent = {"positions": positions.tobytes(), "values": codes.tobytes()}
    return sent | {"differs": differs, "range": span, "visible": visible}


def points(positions: np.ndarray, values: np.ndarray, normals: np.ndarray | None, size: float) -> dict:
    """A cloud: positions (n, 3) mm, values (n,), unit normals (n, 3) or None, ``size`` of a point in pixels."""
    codes, span = _codes(values)
    directions = b"" if normals is None else np.round(127 * np.asarray(normals)).astype(np.int8).tobytes()
    return {"positions": _steps(positions), "values": codes.tobytes(), "range": span, "normals": directions, "size": size}


def _steps(positions: np.ndarray) -> bytes:
    return _whole(positions).tobytes()


def _whole(positions: np.ndarray) -> np.ndarray:
    """Positions in mm as whole numbers of :data:`STEP_MM`."""
    return np.clip(np.round(np.asarray(positions) / STEP_MM), -32768, 32767).astype("<i2")


def _codes(values: np.ndarray | None) -> tuple[np.ndarray, list[float]]:
    """Values as 16-bit codes, and the ends of their range."""
    if values is None:
        return np.zeros(0, "<u2"), [0.0, 1.0]
    values = np.asarray(values, float)
    known = np.isfinite(values)
    low, high = (float(values[known].min()), float(values[known].max())) if known.any() else (0.0, 1.0)
    scale = (UNKNOWN - 1) / max(high - low, 1e-9)
    codes = np.where(known, np.round((np.where(known, values, low) - low) * scale), UNKNOWN)
    return codes.astype("<u2"), [low, max(high, low + 1e-9)]
