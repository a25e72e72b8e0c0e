"""Draw heads and clouds in the browser. The geometry is sent once, and positions and values follow as bytes."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import anywidget
import numpy as np
import traitlets
from matplotlib import colormaps

from ..insides import Insides

#: Lowest and highest turn (degrees), tilt (degrees) and zoom.
BOUNDS = ((-90.0, 90.0), (-60.0, 60.0), (0.5, 3.0))
#: Positions are sent as multiples of this length, mm, in 16 bits: up to 512 mm from the origin of the head frame.
STEP_MM = 1 / 64
#: The code of an unknown value. The others are 0 .. 65534 between the ends of their range.
UNKNOWN = 65535


class Heads(anywidget.AnyWidget):
    """Panes of heads and points on one canvas; the sources are in ``js/src``. Turning and zooming stay in the browser.

    Attributes
    ----------
    geometry : list
        What every pane's head is made of (:func:`geometry`).
    rests : list of bytes
        For every pane the rigid parts inside the head at rest. They change with the person whose head is shown.
    frame : list
        What every pane shows (:func:`shape`, :func:`inside`, :func:`points`).
    titles : list of str
        Of the panes.
    grid : list of int
        Columns and rows of panes.
    pane : list of int
        Width and height of a pane, pixels.
    centre, radius : list of float, float
        The point that the cameras look at, and the radius of what a pane shows around it, mm.
    limits, label, palette : list of float, str, bytes
        Range, meaning and RGB colours of the heat map.
    camera : list of float
        Turn (degrees), tilt (degrees) and zoom. It is sent to the browser and never comes back.
    differs : bool
        Whether the panes differ, so that ``exaggeration`` can enlarge the difference.
    renderer : {"auto", "webgl", "canvas"}
        The canvas needs no WebGL. "auto" chooses it if the processor would do WebGL's work.
    name : str
        CSS class of the canvas, for tests.
    """

    _esm = Path(__file__).resolve().parents[1] / "assets" / "heads.js"
    geometry: traitlets.List[dict] = traitlets.List().tag(sync=True)
    rests = traitlets.List(traitlets.Bytes()).tag(sync=True)
    frame: traitlets.List[dict] = traitlets.List().tag(sync=True)
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
    still: Callable[[], np.ndarray] | None = None  #: draws the picture that remains without a browser, (H, W, 3) uint8

    def own_traits(self) -> list[str]:
        """Names of the traits that the browser has."""
        return [name for name, trait in Heads.class_own_traits().items() if trait.metadata.get("sync")]


def palette(colourmap: str) -> bytes:
    """256 RGB colours of one of Matplotlib's colour maps."""
    return (colormaps[colourmap](np.linspace(0, 1, 256))[:, :3] * 255).round().astype(np.uint8).tobytes()


class Moving:
    """Which vertices of a head move, (N,) bool, and where all of them rest, (N, 3) mm. Only those that move are sent."""

    def __init__(self, mask: np.ndarray, rest: np.ndarray) -> None:
        self.mask, self.rest = mask, _whole(rest)

    def sent(self) -> dict:
        """What the browser must know about it."""
        return {"moving": np.flatnonzero(self.mask).astype("<u4").tobytes(), "rest": self.rest.tobytes()}

    def positions(self, whole: np.ndarray) -> np.ndarray:
        """The positions that must be sent, from (N, 3) in whole steps."""
        return whole[self.mask] if np.array_equal(whole[~self.mask], self.rest[~self.mask]) else whole

    def values(self, codes: np.ndarray) -> np.ndarray:
        """The codes that must be sent, from (N,). The others are unknown."""
        return codes[self.mask] if len(codes) and (codes[~self.mask] == UNKNOWN).all() else codes


def geometry(count: int, triangles: np.ndarray, colours: np.ndarray | None = None, insides: Insides | None = None) -> dict:
    """Describe what a pane's head is made of.

    Parameters
    ----------
    count : int
        Number of vertices N.
    triangles : (T, 3)
        Of the head.
    colours : (N, 3) uint8, optional
        Of the vertices; the colour of skin by default.
    insides : Insides, optional
        The parts inside the head.

    Returns
    -------
    dict
        As the browser reads it.
    """
    own = b"" if colours is None else np.asarray(colours, np.uint8).tobytes()
    out = {"count": count, "triangles": np.asarray(triangles, np.uint32).tobytes(), "colours": own or None}
    if insides is not None:
        parts = geometry(len(insides.part), insides.triangles, insides.colours)
        out["inside"] = parts | {"part": insides.part.tobytes()}
    return out


def rest(insides: Insides | None) -> bytes:
    """Positions of eyeballs, teeth and tongue at rest, where their placement is the identity."""
    return b"" if insides is None else _steps(insides.rest)


def inside(placements: np.ndarray, soft: np.ndarray) -> dict:
    """Where the parts inside a head are, from :meth:`~adaptiveface.insides.Insides.motion`: about 2 kB instead of 18."""
    return {"placements": np.asarray(placements, "<f4").tobytes(), "soft": _steps(soft)}


def shape(
    vertices: np.ndarray,
    heat: np.ndarray | None,
    differs: bool = False,
    visible: bool = True,
    moving: Moving | None = None,
) -> dict:
    """Describe what a pane's head looks like now.

    Parameters
    ----------
    vertices : (N, 3)
        Of the head, mm.
    heat : (N,) or None
        Values that colour it.
    differs : bool
        Whether its difference from the first pane's head can be enlarged.
    visible : bool
        Whether it is drawn.
    moving : Moving, optional
        Which vertices may move. Nothing is sent of the others while they rest.

    Returns
    -------
    dict
        As the browser reads it.
    """
    codes, span = _codes(heat)
    positions = _whole(vertices)
    if moving is not None:
        positions, codes = moving.positions(positions), moving.values(codes)
    sent = {"positions": positions.tobytes(), "values": codes.tobytes()}
    return sent | {"differs": differs, "range": span, "visible": visible}


def points(positions: np.ndarray, values: np.ndarray, normals: np.ndarray | None, size: float) -> dict:
    """Describe a cloud of points.

    Parameters
    ----------
    positions : (n, 3)
        Of the points, mm.
    values : (n,)
        Values that colour them.
    normals : (n, 3) or None
        Unit normals.
    size : float
        Of a point, pixels.

    Returns
    -------
    dict
        As the browser reads it.
    """
    codes, span = _codes(values)
    directions = b"" if normals is None else np.round(127 * np.asarray(normals)).astype(np.int8).tobytes()
    return {"positions": _steps(positions), "values": codes.tobytes(), "range": span, "normals": directions, "size": size}


def _steps(positions: np.ndarray) -> bytes:
    return _whole(positions).tobytes()


def _whole(positions: np.ndarray) -> np.ndarray:
    """Positions in mm as multiples of :data:`STEP_MM`."""
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
