"""Make a performer a person: detail of the identity, own expression units, a turning jaw, units that interact."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .fields import smooth_field

#: Units that move the skin farther than this, mm, such as the opening jaw, vary less in proportion.
RIGID_REACH = 14.0

#: Pairs of expression units that change each other when active together.
INTERACTIONS = (
    ("jawOpen", "mouthSmileLeft"),
    ("jawOpen", "mouthSmileRight"),
    ("jawOpen", "mouthPucker"),
    ("jawOpen", "mouthFunnel"),
    ("jawOpen", "mouthStretchLeft"),
    ("jawOpen", "mouthStretchRight"),
    ("cheekPuff", "mouthPucker"),
    ("mouthSmileLeft", "mouthSmileRight"),
    ("browDownLeft", "browInnerUp"),
    ("browDownRight", "browInnerUp"),
    ("mouthFrownLeft", "mouthShrugLower"),
    ("mouthFrownRight", "mouthShrugLower"),
    ("noseSneerLeft", "mouthUpperUpLeft"),
    ("noseSneerRight", "mouthUpperUpRight"),
    ("jawOpen", "jawLeft"),
    ("jawOpen", "jawRight"),
)


def identity_detail(rng: np.random.Generator, points: np.ndarray, size: float) -> np.ndarray:
    """Draw an asymmetric displacement that the identity modes do not hold.

    It is the sum of three octaves: asymmetry of the whole head, bumps of cheeks and brows, and waves of the skin.

    Parameters
    ----------
    rng : numpy.random.Generator
    points : (V, 3) array
        Points of the head, mm.
    size : float
        Root mean square of the displacement, mm.

    Returns
    -------
    (V, 3) array
        Displacements, mm.
    """
    field = np.zeros_like(points)
    for wavelength, share in ((140.0, 0.6), (60.0, 0.7), (28.0, 0.35)):
        field += share * smooth_field(rng, points, wavelength, 3)
    return field * (size / np.sqrt((field**2).sum(axis=1).mean()))


def personal_units(
    rng: np.random.Generator, points: np.ndarray, units: np.ndarray, names: tuple[str, ...], variation: float = 1.0
) -> np.ndarray:
    """Warp the generic expression units (E, V, 3) mm into the person's own ones (E, V, 3) mm.

    Each unit gets a smooth gain (standard deviation 0.18), a smooth rotation of its direction (10 degrees) and a strength of
    its own (12 %). Left and right are drawn separately, so that the face moves unevenly. Eyelids vary less, because they must
    close. Units that move the skin far also vary less, because they move bone, which does not bend.
    """
    out = np.zeros_like(units)
    for e, name in enumerate(names):
        lid = name.startswith("eye")
        largest = np.linalg.norm(units[e], axis=1).max(initial=0.0)
        scale = variation * (0.3 if lid else 1.0) * min(1.0, RIGID_REACH / max(largest, 1e-9))
        moved = np.flatnonzero(np.abs(units[e]).max(axis=1) > 1e-3)
        unit = units[e, moved]
        gain = np.exp(scale * 0.18 * smooth_field(rng, points[moved], 90.0))
        turn = scale * np.radians(10.0) / np.sqrt(2) * smooth_field(rng, points[moved], 90.0, 3)
        strength = np.exp(scale * rng.normal(0, 0.12))
        turned = unit + np.cross(turn, unit)
        length = np.linalg.norm(unit, axis=1, keepdims=True) / np.linalg.norm(turned, axis=1, keepdims=True)
        out[e, moved] = strength * gain * length * turned
    return out


def path_bends(rng: np.random.Generator, points: np.ndarray, units: np.ndarray, size: float = 0.06) -> np.ndarray:
    """Draw how far each unit leaves its straight path half-way, (E, V, 3) mm. ``size`` is a share of the displacement."""
    out = np.zeros_like(units)
    for e in range(len(units)):
        moved = np.flatnonzero(np.abs(units[e]).max(axis=1) > 1e-3)
        axis = smooth_field(rng, points[moved], 90.0, 3) / np.sqrt(3)
        out[e, moved] = size * np.cross(axis, units[e, moved])
    return out


@dataclass(frozen=True)
class Interactions:
    """What ``pairs`` of units (P, 2) add when both are active: ``fields`` (P, V, 3) mm at full activation of both."""

    pairs: np.ndarray
    fields: np.ndarray

    def displacement(self, activations: np.ndarray) -> np.ndarray | float:
        """Return the (V, 3) mm that activations (E,) add."""
        both = np.clip(activations[self.pairs], 0, 1.2).prod(axis=1)
        active = both > 1e-4
        return np.tensordot(both[active], self.fields[active], axes=1) if active.any() else 0.0


def make_interactions(
    rng: np.random.Generator, points: np.ndarray, units: np.ndarray, names: tuple[str, ...], size: float = 1.4
) -> Interactions:
    """Draw smooth fields where both units of a pair move the skin, with a root mean square of ``size`` mm there."""
    pairs, fields = [], []
    for a, b in INTERACTIONS:
        field = smooth_field(rng, points, 70.0, 3) * (size / np.sqrt(3))
        if a in names and b in names:
            pair = [names.index(a), names.index(b)]
            moved = np.linalg.norm(units[pair], axis=2)
            shared = np.sqrt(moved.prod(axis=0))
            pairs.append(pair)
            fields.append(field * (shared / max(shared.max(), 1e-9))[:, None])
    return Interactions(np.array(pairs, int).reshape(-1, 2), np.array(fields).reshape(-1, *points.shape))


@dataclass(frozen=True)
class JawHinge:
    """A jaw that opens by turning. It adds the arc that the straight unit leaves out.

    Attributes
    ----------
    arm : (V, 2) array
        y and z of each vertex from the hinge, mm.
    angle : (V,) array
        Rotation of each vertex at full activation of its own unit, rad.
    """

    arm: np.ndarray
    angle: np.ndarray

    def displacement(self, activation: float) -> np.ndarray:
        """Return the (V, 2) difference in y and z between the arc and its chord, mm. It is zero at activations 0 and 1."""
        return self._turned(activation) - activation * self._turned(1.0)

    def _turned(self, activation: float) -> np.ndarray:
        angle = activation * self.angle
        cos, sin = np.cos(angle) - 1, np.sin(angle)
        y, z = self.arm.T
        return np.stack([cos * y - sin * z, sin * y + cos * z], axis=1)


def make_jaw_hinge(neutral: np.ndarray, unit: np.ndarray) -> JawHinge:
    """Find the hinge from the jaw-open unit (V, 3).

    The chord of a rotation is perpendicular to the line from its middle to the axis.
    """
    chord, middle = unit[:, 1:], neutral[:, 1:] + 0.5 * unit[:, 1:]
    length = np.linalg.norm(chord, axis=1)
    jaw = length > 0.5 * length.max()
    hinge = np.linalg.lstsq(chord[jaw], (chord[jaw] * middle[jaw]).sum(axis=1), rcond=None)[0]
    arm = neutral[:, 1:] - hinge
    radius = np.linalg.norm(arm, axis=1)
    turn = np.sign(arm[:, 0] * chord[:, 1] - arm[:, 1] * chord[:, 0])
    angle = turn * 2 * np.arcsin(np.clip(length / (2 * np.maximum(radius, 20.0)), 0, 0.5))
    return JawHinge(arm, angle)
