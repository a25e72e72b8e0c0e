"""Where skin, lips, brows, lids and hair lie on a performer: distances stored per vertex of the dense neutral skin.

Interpolated over a pixel's triangle and only then turned into colour, distances give edges that are sharper than the
mesh.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from matplotlib.path import Path
from scipy.interpolate import CubicSpline, PchipInterpolator
from scipy.spatial import cKDTree

from ..geometry.frame import FEATURE_IDS
from .fields import smooth_field

#: Columns of :attr:`Makeup.fields`.
LIPS, BROWS, LASHES, HAIR, BLUSH, TEXTURE, FRECKLES = range(7)


@dataclass(frozen=True)
class Makeup:
    """fields (D, 7) per vertex of the dense skin.

    LIPS, BROWS, HAIR: signed distance to the outline in mm, positive inside; LASHES: distance to the rim of the lids in
    mm, larger below the eye; BLUSH, TEXTURE, FRECKLES: random patterns of about unit size that stick to the skin.
    """

    fields: np.ndarray


def make_makeup(
    rng: np.random.Generator,
    points: np.ndarray,
    normals: np.ndarray,
    landmarks: np.ndarray,
    lids: list[np.ndarray],
    mouth: np.ndarray | None,
) -> Makeup:
    """Make the fields for one performer. All positions are in the head frame, mm.

    ``points`` and ``normals`` are (D, 3), and ``landmarks`` are (40, 3). ``lids`` are the rims (n, 3) of the eyes. ``mouth``
    is the rim (n, 3) inside the lips.
    """
    at = dict(zip(FEATURE_IDS.tolist(), landmarks, strict=True))
    unit = 0.5 * float(np.linalg.norm(at[45] - at[36]))
    front = (normals[:, 2] > -0.2) & (points[:, 2] > landmarks[:, 2].min() - 0.5 * unit)
    fields = np.empty((len(points), 7))
    fields[:, LIPS] = np.where(front, _lips(points, np.array([at[i] for i in range(48, 60)])), -50.0)
    if mouth is not None:
        # The rolled-in skin beside the corners of the mouth is lip too.
        fields[:, LIPS] = np.maximum(fields[:, LIPS], 5.0 - cKDTree(mouth).query(points)[0])
    fields[:, BROWS] = np.where(front, _brows(points, at, unit * rng.uniform(0.85, 1.15)), -50.0)
    fields[:, LASHES] = np.where(front, _lashes(points, lids), 50.0)
    fields[:, HAIR] = _hair(points, at, unit) + 2.0 * smooth_field(rng, points, 25.0)[:, 0]
    fields[:, BLUSH] = smooth_field(rng, points, 60.0)[:, 0]
    fields[:, TEXTURE] = 0.6 * smooth_field(rng, points, 7.0)[:, 0] + 0.8 * rng.standard_normal(len(points))
    fields[:, FRECKLES] = rng.random(len(points)) ** 8
    return Makeup(fields)


def _lips(points: np.ndarray, outline: np.ndarray) -> np.ndarray:
    """Signed distance to the outer contour of the lips, seen from the front."""
    closed = np.vstack([outline, outline[:1]])[:, :2]
    # Two splines, because the corners of the mouth are corners.
    curve = np.concatenate([_spline(closed[:7]), _spline(closed[6:])])
    distance = cKDTree(curve).query(points[:, :2])[0]
    return np.where(Path(curve).contains_points(points[:, :2]), distance, -distance)


def _spline(knots: np.ndarray) -> np.ndarray:
    t = np.linspace(0, len(knots) - 1, 20 * len(knots))
    return CubicSpline(np.arange(len(knots)), knots)(t)


def _brows(points: np.ndarray, at: dict[int, np.ndarray], unit: float) -> np.ndarray:
    """Brow features lie on the upper edge of the hair; the brow hangs below it, thinning outwards."""
    out = np.full(len(points), -50.0)
    for numbers, side in (((22, 23, 24, 25), 1), ((21, 20, 19, 18), -1)):
        edge = np.array([at[i][:2] for i in numbers])
        half = unit * np.array([0.075, 0.08, 0.062, 0.03])
        middle = edge - np.stack([np.zeros(4), half], axis=1)
        middle[0, 0] -= side * 0.03 * unit
        t = np.linspace(0, 3, 120)
        curve = PchipInterpolator(np.arange(4), middle)(t)
        distance, nearest = cKDTree(curve).query(points[:, :2])
        out = np.maximum(out, np.interp(t, np.arange(4), half)[nearest] - distance)
    return out


def _lashes(points: np.ndarray, lids: list[np.ndarray]) -> np.ndarray:
    out = np.full(len(points), 50.0)
    for rim in lids:
        dense = np.concatenate([rim + f * (np.roll(rim, -1, axis=0) - rim) for f in (0, 0.25, 0.5, 0.75)])
        distance, nearest = cKDTree(dense).query(points)
        lower = dense[nearest, 1] < 0.5 * (rim[:, 1].min() + rim[:, 1].max())
        out = np.minimum(out, distance + 0.8 * lower)
    return out


def _hair(points: np.ndarray, at: dict[int, np.ndarray], unit: float) -> np.ndarray:
    """Roughly the signed distance to the hairline: over the forehead, sloping to the ears, low at the back."""
    brow, eye = 0.5 * (at[20] + at[23]), 0.5 * (at[36] + at[45])
    behind = np.maximum(at[45][2] - points[:, 2], 0)
    top = points[:, 1] - (brow[1] + 1.2 * unit - 0.5 * behind)
    middle = 0.5 * (points[:, 2].min() + points[:, 2].max())
    back = np.minimum(middle - 0.9 * unit - points[:, 2], points[:, 1] - (eye[1] - 0.9 * unit))
    return np.maximum(top, back)
