"""Folds that appear with activation: ridges and valleys along curves of the face, in no linear basis.

Curves are given in a face frame of three lengths measured on the person's landmarks, so they fit every head.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.spatial import cKDTree

from ..geometry.frame import FEATURE_IDS
from .fields import soft_step


@dataclass(frozen=True)
class FoldKind:
    """One kind of fold on the subject's left side. If ``paired``, the right side has its mirror image.

    Attributes
    ----------
    anchor
        Landmark (iBUG number) that is the origin of ``curve``.
    curve : (K, 2)
        Points with x outwards and y up, in units of half the distance between the outer eye corners.
    drivers
        Expression units and their weights. The names of paired units have no Left or Right.
    depth : float
        Depth of the valley at full activation, mm.
    width : float
        Width of the valley, mm.
    ridge : float
        Height of the bulge beside the valley as a share of the depth. The bulge is above or away from the midline.
    """

    name: str
    anchor: int
    curve: tuple[tuple[float, float], ...]
    drivers: tuple[tuple[str, float], ...]
    depth: float
    width: float
    ridge: float = 0.5
    paired: bool = True


FOLDS = (
    FoldKind(
        "nasolabial",
        54,
        ((-0.15, 0.62), (0.0, 0.42), (0.13, 0.18), (0.19, -0.06)),
        (("mouthSmile", 1.0), ("noseSneer", 0.6), ("mouthUpperUp", 0.5), ("cheekSquint", 0.3)),
        1.3,
        2.6,
        0.8,
    ),
    FoldKind(
        "marionette", 54, ((0.09, -0.04), (0.15, -0.2), (0.15, -0.38)), (("mouthFrown", 1.0), ("mouthStretch", 0.5)), 0.9, 2.6
    ),
    FoldKind(
        "crow upper",
        45,
        ((0.12, 0.06), (0.28, 0.14), (0.4, 0.26)),
        (("eyeSquint", 0.7), ("cheekSquint", 0.7), ("mouthSmile", 0.5)),
        0.7,
        2.0,
        0.4,
    ),
    FoldKind(
        "crow middle",
        45,
        ((0.13, 0.0), (0.3, -0.01), (0.44, 0.02)),
        (("eyeSquint", 0.7), ("cheekSquint", 0.7), ("mouthSmile", 0.5)),
        0.7,
        2.0,
        0.4,
    ),
    FoldKind(
        "crow lower",
        45,
        ((0.11, -0.07), (0.26, -0.16), (0.38, -0.28)),
        (("eyeSquint", 0.7), ("cheekSquint", 0.7), ("mouthSmile", 0.5)),
        0.6,
        2.0,
        0.4,
    ),
    FoldKind(
        "under eye",
        46,
        ((-0.4, -0.18), (-0.1, -0.28), (0.2, -0.24)),
        (("cheekSquint", 1.0), ("mouthSmile", 0.5), ("eyeSquint", 0.5)),
        0.7,
        2.4,
        0.6,
    ),
    FoldKind("frown line", 22, ((-0.06, 0.06), (-0.12, -0.08), (-0.12, -0.26)), (("browDown", 1.0),), 0.9, 2.2, 0.5),
    FoldKind(
        "forehead low",
        23,
        ((-0.75, 0.24), (-0.3, 0.33), (0.1, 0.33), (0.5, 0.18)),
        (("browOuterUp", 0.7), ("browInnerUp", 0.5)),
        0.9,
        2.6,
        0.7,
    ),
    FoldKind(
        "forehead middle",
        23,
        ((-0.75, 0.45), (-0.3, 0.54), (0.1, 0.53), (0.45, 0.4)),
        (("browOuterUp", 0.6), ("browInnerUp", 0.6)),
        1.0,
        2.8,
        0.7,
    ),
    FoldKind(
        "forehead high",
        23,
        ((-0.75, 0.68), (-0.3, 0.75), (0.05, 0.74), (0.35, 0.62)),
        (("browOuterUp", 0.4), ("browInnerUp", 0.7)),
        0.8,
        3.0,
        0.6,
    ),
    FoldKind(
        "chin crease",
        57,
        ((-0.3, -0.16), (0.0, -0.2), (0.3, -0.16)),
        (("mouthShrugLower", 1.0), ("mouthRollLower", 0.4), ("mouthFrownLeft", 0.3), ("mouthFrownRight", 0.3)),
        1.2,
        3.0,
        -0.6,
        paired=False,
    ),
    FoldKind("nose bridge", 42, ((-0.36, 0.1), (-0.3, 0.0), (-0.22, -0.08)), (("noseSneer", 1.0),), 0.6, 2.0, 0.4),
)


@dataclass(frozen=True)
class Fold:
    """One fold of one person: ``vectors`` (n, 3) mm on ``vertices`` (n,) at full activation.

    drivers: numbers and weights of the expression units; onset: activation at which the fold starts to show.
    """

    name: str
    vertices: np.ndarray
    vectors: np.ndarray
    units: np.ndarray
    weights: np.ndarray
    onset: float

    def strength(self, activations: np.ndarray) -> float:
        """Return how far the fold has formed for activations (E,), from 0 to about 1.1."""
        drive = float(self.weights @ np.clip(activations[self.units], 0, 1.2))
        return float(soft_step((drive - self.onset) / (1 - self.onset))) * min(max(drive, 1.0), 1.1)


def make_folds(
    rng: np.random.Generator, points: np.ndarray, normals: np.ndarray, landmarks: np.ndarray, names: tuple[str, ...]
) -> list[Fold]:
    """Make the folds of one person. Position, depth and width vary between persons and between left and right.

    Parameters
    ----------
    rng : numpy.random.Generator
    points, normals : (D, 3) arrays
        The dense neutral surface in the head frame, mm.
    landmarks : (40, 3) array
        Landmarks on the surface in the order of ``FEATURE_IDS``.
    names : tuple of str
        The expression units.
    """
    out = []
    for kind in FOLDS:
        personal_depth, personal_shift = rng.uniform(0.6, 1.15), rng.normal(0, 1.5, (len(kind.curve), 2))
        for side in (1, -1) if kind.paired else (1,):
            depth = kind.depth * personal_depth * rng.uniform(0.75, 1.2)
            shift = personal_shift + rng.normal(0, 0.8, personal_shift.shape)
            units, weights = _drivers(kind, side, names)
            if len(units) == 0:
                continue
            curve = _curve(kind, side, shift, points, normals, landmarks)
            vertices, profile = _profile(kind, curve, points, normals, side)
            vectors = depth * profile[:, None] * normals[vertices]
            out.append(Fold(f"{kind.name} {side:+d}", vertices, vectors, units, weights, rng.uniform(0.1, 0.3)))
    return out


def _drivers(kind: FoldKind, side: int, names: tuple[str, ...]) -> tuple[np.ndarray, np.ndarray]:
    suffix = "Left" if side > 0 else "Right"
    units, weights = [], []
    for driver, weight in kind.drivers:
        name = driver + suffix if kind.paired and driver + suffix in names else driver
        if name in names:
            units.append(names.index(name))
            weights.append(weight)
    return np.array(units, int), np.array(weights)


def _curve(kind: FoldKind, side: int, shift, points, normals, landmarks) -> np.ndarray:
    """Return a densely sampled (K', 3) curve on the surface."""
    at = dict(zip(FEATURE_IDS.tolist(), landmarks, strict=True))
    unit = 0.5 * np.linalg.norm(at[45] - at[36])
    mirrored = {54: 48, 45: 36, 46: 41, 22: 21, 23: 20, 42: 39, 57: 57}
    anchor = at[kind.anchor if side > 0 else mirrored[kind.anchor]]
    knots = anchor[:2] + (np.asarray(kind.curve) * unit + shift) * [side, 1]
    t = np.linspace(0, len(knots) - 1, 60)
    flat = np.stack([_smooth_interpolation(t, knots[:, k]) for k in range(2)], axis=1)
    front = np.flatnonzero((normals[:, 2] > 0.1) & (points[:, 2] > landmarks[:, 2].min() - 45))
    _, nearest = cKDTree(points[front, :2]).query(flat, k=3)
    return np.column_stack([flat, points[front][nearest, 2].mean(axis=1)])


def _smooth_interpolation(t: np.ndarray, knots: np.ndarray) -> np.ndarray:
    return PchipInterpolator(np.arange(len(knots)), knots)(t)


def _profile(kind: FoldKind, curve: np.ndarray, points, normals, side: int) -> tuple[np.ndarray, np.ndarray]:
    """Valley on the curve, bulge beside it; both fade towards the ends of the curve."""
    tree = cKDTree(curve)
    reach = 5 * kind.width
    distance, nearest = tree.query(points, distance_upper_bound=reach)
    vertices = np.flatnonzero(np.isfinite(distance))
    distance, nearest = distance[vertices], nearest[vertices]
    tangent = np.gradient(curve, axis=0)[nearest]
    across = np.cross(normals[vertices], tangent)
    across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-9)
    upright = np.ptp(curve[:, 1]) > np.ptp(curve[:, 0])
    outwards = np.sign(across[:, 0] * side) if upright else np.sign(across[:, 1])
    signed = np.einsum("nd,nd->n", points[vertices] - curve[nearest], across) * outwards
    valley = -np.exp(-0.5 * (distance / kind.width) ** 2)
    ridge_distance = np.hypot(signed - 2.2 * kind.width, np.sqrt(np.maximum(distance**2 - signed**2, 0)))
    ridge = kind.ridge * np.exp(-0.5 * (ridge_distance / (1.3 * kind.width)) ** 2)
    end = soft_step(nearest / 12) * soft_step((len(curve) - 1 - nearest) / 12)
    return vertices, (valley + ridge) * end
