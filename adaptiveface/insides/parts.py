"""Build meshes of the parts inside a head: an eyeball, a row of teeth and a tongue, in millimetres."""

from __future__ import annotations

import numpy as np

#: Angles of the rings of an eyeball's mesh, and the ends of pupil, iris and limbus, in degrees from the gaze. On the model's
#: eyeballs, whose radius is 16 mm, the iris is as wide as a person's (11.7 mm).
RINGS = (0.0, 4.5, 8.5, 8.7, 14.0, 19.5, 20.9, 21.1, 28.0, 38.0, 52.0, 70.0, 90.0, 112.0, 140.0, 180.0)
PUPIL, IRIS, LIMBUS = 8.6, 20.0, 21.0
SECTORS = 20
#: Height of the cornea above the ball, as a share of the ball's radius.
CORNEA = 0.045
WHITE, BLACK = (238, 234, 228), (12, 10, 10)
IVORY, GUM, TONGUE, CAVITY = (232, 226, 210), (176, 92, 92), (186, 96, 98), (70, 26, 28)
#: Number of separate teeth in a row, and mesh points across each.
TEETH, ACROSS = 14, 6


def strip(rows: int, columns: int, closed: bool = False) -> np.ndarray:
    """Make (t, 3) triangles between ``rows`` rows of ``columns`` points each. ``closed`` joins the ends of the rows."""
    r, c = np.meshgrid(np.arange(rows - 1), np.arange(columns if closed else columns - 1), indexing="ij")
    here, right = (r * columns + c).ravel(), (r * columns + (c + 1) % columns).ravel()
    pair = [[here, here + columns, right + columns], [here, right + columns, right]]
    return np.transpose(pair, (2, 0, 1)).reshape(-1, 3)


def eyeball_mesh(iris: tuple[int, int, int]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Build an eyeball of radius 1 that looks along +z: vertices (n, 3), triangles (t, 3) and colours (n, 3) in 0..255."""
    angle = np.radians(np.array(RINGS))
    around = 2 * np.pi * np.arange(SECTORS) / SECTORS
    ring = np.stack([np.cos(around), np.sin(around), np.zeros(SECTORS)], axis=1)
    inner = [np.sin(a) * ring + [0.0, 0.0, np.cos(a)] for a in angle[1:-1]]
    unit = np.concatenate([[[0.0, 0.0, 1.0]], *inner, [[0.0, 0.0, -1.0]]])
    k, last = np.arange(SECTORS), len(unit) - 1
    turned = np.roll(k, -1)
    first, final = 1 + k, last - SECTORS + k
    triangles = np.concatenate(
        [
            np.stack([np.zeros_like(k), first, 1 + turned], 1),
            1 + strip(len(inner), SECTORS, closed=True),
            np.stack([final, np.full_like(k, last), last - SECTORS + turned], 1),
        ]
    )
    from_gaze = np.degrees(np.arccos(np.clip(unit[:, 2], -1, 1)))
    colours = np.full((len(unit), 3), WHITE, float)
    shade = np.clip((from_gaze - PUPIL) / (IRIS - PUPIL), 0, 1)[:, None]
    colours[from_gaze < LIMBUS] = ((0.75 + 0.45 * shade) * np.array(iris))[from_gaze < LIMBUS]
    colours[(from_gaze > 19.1) & (from_gaze < LIMBUS)] *= 0.45
    colours[from_gaze < PUPIL] = BLACK
    # The cornea is a low dome over the iris that catches the light.
    dome = 1 + CORNEA * np.cos(np.clip(from_gaze / LIMBUS, 0, 1) * np.pi / 2)
    return unit * dome[:, None], triangles, np.clip(colours, 0, 255)


def teeth_mesh(half_width: float, depth: float, height: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Build the upper row of teeth. The lower row is the same mesh upside down.

    The origin is the biting edge of the front teeth, and the arch is half an ellipse.

    Parameters
    ----------
    half_width, depth : float
        Half-axes of the arch, to the sides and backwards, mm.
    height : float
        Height of the front teeth, mm.

    Returns
    -------
    vertices : (n, 3) array
        In mm.
    triangles : (t, 3) array
        Vertex numbers.
    colours : (n, 3) array
        RGB in 0..255.
    """
    columns = TEETH * ACROSS + 1
    place = np.linspace(-1, 1, columns)
    theta = np.radians(84.0) * place
    across = np.abs((np.arange(columns) % ACROSS) / ACROSS - 0.5) * 2  # 1 between two teeth, 0 in the middle of one
    crown = height * (1 - 0.28 * np.abs(place))
    # Rows from the gum over the front and the edge to the back: height above the edge, distance inwards, 1 for gum.
    rows = [(1.7, 3.4, 1), (1.25, 1.0, 1), (1.0, 0.3, 0), (0.7, 0.0, 0), (0.3, 0.05, 0), (0.03, 0.5, 0), (0.0, 1.2, 0)]
    rows += [(0.1, 2.2, 0), (0.7, 3.6, 0), (1.1, 4.2, 1), (1.6, 6.5, 1)]
    points, colours = [], []
    for up, inward, gum in rows:
        groove = (0.15 if gum else 0.75) * across**6
        bite = 0.5 * across**4 * (up < 0.2)
        size = 1 - (inward + groove) / half_width, 1 - (inward + groove) / depth
        points.append(
            np.stack([half_width * size[0] * np.sin(theta), up * crown + bite, depth * (size[1] * np.cos(theta) - 1)], axis=1)
        )
        dark = (1 - 0.35 * across**6 * (not gum)) * (1 - 0.8 * np.clip(np.abs(place) / 0.8, 0, 1) ** 2)  # cheeks' shade
        colours.append(np.array(GUM if gum else IVORY, float) * dark[:, None])
    triangles = strip(len(rows), columns)
    return np.concatenate(points), triangles, np.concatenate(colours)


def tongue_mesh(half_width: float, length: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Build a tongue that extends from its tip, the origin, along -z: vertices (n, 3) mm, triangles (t, 3), colours (n, 3)."""
    along = np.linspace(0.0, 1.0, 15)
    around = 2 * np.pi * np.arange(20) / 20
    rings = []
    for a in along:
        wide = half_width * np.sqrt(1 - (1 - min(a / 0.55, 1.0)) ** 2.2 + 1e-9)
        thick = 5.0 * np.sqrt(1 - (1 - min(a / 0.3, 1.0)) ** 2 + 1e-9)
        top = np.sin(around)
        furrow = -1.2 * np.exp(-((np.cos(around) * wide / 3.0) ** 2)) * (top > 0) * min(a / 0.3, 1.0)
        lift = 7.0 * np.sin(np.pi * min(a, 0.8) / 1.6) ** 2
        height = thick * top + furrow + lift
        rings.append(np.stack([wide * np.cos(around), height, np.full(20, -length * a)], axis=1))
    vertices = np.concatenate(rings)
    shade = np.repeat(1.0 - 0.5 * along, 20)
    return vertices, strip(15, 20, closed=True)[:, ::-1], shade[:, None] * np.array(TONGUE, float)


def rim_height(rim: np.ndarray) -> np.ndarray:
    """Return (n,) heights in [-1, 1] along a rim (n, 3). They are positive on its upper half and 0 at its corners."""
    left, right = int(rim[:, 0].argmax()), int(rim[:, 0].argmin())
    n, out = len(rim), np.zeros(len(rim))
    halves = [np.arange(a, a + (b - a) % n + 1) % n for a, b in ((left, right), (right, left))]
    halves.sort(key=lambda half: rim[half, 1].mean())
    for half, sign in zip(halves, (-1.0, 1.0), strict=True):
        out[half] = sign * np.sin(np.pi * np.linspace(0, 1, len(half))) ** 0.6
    return out


def smooth_ring(values: np.ndarray) -> np.ndarray:
    """Smooth values (n, ...) along a closed ring. Each is averaged with its neighbours six times."""
    for _ in range(6):
        values = 0.25 * np.roll(values, 1, axis=0) + 0.5 * values + 0.25 * np.roll(values, -1, axis=0)
    return values
