"""Skin as in photographs: pores, freckles, moles, beard, make-up and gloss, evaluated at the points that a camera sees.

The colour of skin is the colour of the tissue below it, dimmed by two pigments: melanin and the blood's haemoglobin (Tsumura
et al. 1999, "Independent-component analysis of skin color image"). The amounts of both are random fields on the neutral face.
Gloss comes from the oil on the surface, and the pores give the surface its relief. Gloss depends on the places of the camera
and the lamp. All colours are linear and are converted to sRGB at the end.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..geometry.frame import FEATURE_IDS
from ..geometry.rendering import irradiance, unit
from .fields import soft_step
from .lamp import Lamp
from .makeup import BROWS, HAIR, LASHES, LIPS
from .pattern import noise, spots

#: Absorption of linear R, G and B by a unit of melanin and of haemoglobin, as exponents.
_MELANIN, _BLOOD = np.array([0.34, 0.62, 0.95]), np.array([0.10, 0.80, 0.62])
#: Columns of the fields that a :class:`PhotographicSkin` adds: the place on the neutral face, and regions in [0, 1].
PLACE, BEARD, OIL, CHEEKS, LIDS = slice(0, 3), 3, 4, 5, 6
_FIELDS = 7


@dataclass(frozen=True)
class Kind:
    """The amounts of all components in one kind of skin. Colours are linear."""

    melanin: tuple[float, float]
    mottled: float = 1.0
    pores: float = 1.0
    freckles: float = 0.0
    beard: float = 0.0
    makeup: float = 0.0
    gloss: float = 0.05
    oil: float = 0.08
    sharpness: float = 24.0


KINDS = {
    "freckled": Kind(melanin=(0.2, 0.5), freckles=1.0, mottled=1.2),
    "bearded": Kind(melanin=(0.45, 1.0), beard=1.0, mottled=1.1, pores=1.3),
    "made-up": Kind(melanin=(0.3, 1.2), makeup=1.0, mottled=0.35, pores=0.4, gloss=0.04, oil=0.05),
    "oily": Kind(melanin=(0.9, 2.2), pores=1.5, gloss=0.07, oil=0.34, sharpness=34.0),
}


@dataclass(frozen=True)
class Surface:
    """P points that a camera sees.

    Attributes
    ----------
    normals, towards_camera : (P, 3) arrays
        Unit vectors in the camera frame.
    footprint : (P,) array
        Size of a pixel on the skin, mm.
    """

    normals: np.ndarray
    towards_camera: np.ndarray
    footprint: np.ndarray


class PhotographicSkin:
    """The skin of one performer.

    The attribute ``fields`` has shape (D, 7). It holds the values at the D vertices of the dense neutral skin.
    """

    def __init__(self, kind: str, seed: int, points: np.ndarray, landmarks: np.ndarray) -> None:
        rng = np.random.default_rng([seed, 0x5C17])
        self.kind = KINDS[kind]
        self.fields = _regions(points, landmarks)
        self._melanin = rng.uniform(*self.kind.melanin)
        self._blood = rng.uniform(0.3, 0.55)
        self._below = np.array([0.93, 0.76, 0.63])
        hair = rng.choice(3)
        self._hair = np.array([(0.012, 0.008, 0.006), (0.04, 0.02, 0.011), (0.10, 0.055, 0.025)][hair])
        self._lipstick = np.array([(0.42, 0.03, 0.05), (0.5, 0.12, 0.14), (0.3, 0.04, 0.09)][rng.choice(3)])
        self._shadow = np.array([(0.20, 0.13, 0.16), (0.13, 0.16, 0.22), (0.28, 0.17, 0.10)][rng.choice(3)])
        self._seed = int(rng.integers(1 << 30))

    def albedo(self, makeup: np.ndarray, fields: np.ndarray, footprint: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Compute colour and gloss at P points.

        Parameters
        ----------
        makeup : (P, 7) array
            Fields of the makeup.
        fields : (P, 7) array
            Fields of this skin.
        footprint : (P,) array
            Size of a pixel on the skin, mm.

        Returns
        -------
        colour : (P, 3) array
            Linear colour.
        gloss : (P,) array
        """
        k, at, seed = self.kind, fields[:, PLACE], self._seed
        lips, on_head = _edge(makeup[:, LIPS] - 0.2, 1.0), _edge(makeup[:, HAIR], 4.0)
        skin = 1.0 - lips
        melanin = self._melanin * (
            1 + k.mottled * noise(at, footprint, (28, 13, 6, 3, 1.5), (0.05, 0.04, 0.03, 0.03, 0.03), seed)
        )
        melanin = melanin + k.freckles * self._freckles(fields, footprint, skin)
        melanin = melanin + 2.2 * spots(at, footprint, skin * 0.35, 14.0, (0.6, 1.8), seed + 11)
        pores = spots(at, footprint, skin * 0.8 * (0.35 + 0.65 * fields[:, OIL]), 1.3, (0.12, 0.3), seed + 21)
        melanin = melanin + 0.9 * k.pores * pores
        blood = self._blood * (
            1 + k.mottled * noise(at, footprint, (45, 20, 9, 4, 2), (0.08, 0.07, 0.05, 0.04, 0.03), seed + 31)
        )
        blood = blood + 0.3 * k.mottled * fields[:, CHEEKS] + 0.5 * lips
        colour = self._below * np.exp(-np.maximum(melanin, 0)[:, None] * _MELANIN - np.maximum(blood, 0)[:, None] * _BLOOD)
        creases = noise(at * [1.0, 0.25, 0.6], footprint, (2.6, 1.4), (0.10, 0.10), seed + 41)
        colour *= np.exp(lips * creases)[:, None]
        colour = self._bearded(colour, fields, footprint, skin)
        colour = self._made_up(colour, makeup, fields, footprint, lips)
        colour = self._haired(colour, makeup, at, footprint, on_head)
        gloss = k.gloss * (1 + 1.5 * k.makeup * lips) + k.oil * fields[:, OIL] * skin
        return colour, gloss * np.clip(1 - 0.8 * k.pores * pores, 0, 1) * (1 - 0.8 * on_head) * (
            1 - 0.7 * _edge(makeup[:, BROWS], 1)
        )

    def _freckles(self, fields: np.ndarray, footprint: np.ndarray, skin: np.ndarray) -> np.ndarray:
        at, seed = fields[:, PLACE], self._seed
        patches = np.clip(0.5 + 0.5 * noise(at, footprint, (22,), (1.0,), seed + 51), 0.05, 1)
        density = skin * patches * (0.25 + 0.75 * fields[:, CHEEKS])
        small, large = (
            spots(at, footprint, density * d, cell, r, seed + s)
            for d, cell, r, s in ((0.9, 2.6, (0.5, 1.0), 61), (0.7, 4.6, (0.8, 1.9), 71))
        )
        return 1.3 * np.minimum(small + large, 1.2)

    def _bearded(self, colour: np.ndarray, fields: np.ndarray, footprint: np.ndarray, skin: np.ndarray) -> np.ndarray:
        if not self.kind.beard:
            return colour
        at = fields[:, PLACE]
        patchy = np.clip(0.75 + 0.2 * noise(at, footprint, (15, 7), (0.7, 0.7), self._seed + 81), 0.1, 1.2)
        where = self.kind.beard * skin * fields[:, BEARD] * patchy
        hairs = spots(at, footprint, where, 1.6, (0.2, 0.5), self._seed + 91)
        tufts = noise(at, footprint, (3.4, 2.2), (0.25, 0.25), self._seed + 101)
        # Hair below the surface looks bluish; hairs too fine for a pixel are an even shade.
        shade = np.clip(0.45 * where * (1 + 0.35 * tufts) + 0.6 * hairs, 0, 0.9)
        return _mix(colour, 0.6 * self._hair + [0.028, 0.030, 0.034], shade)

    def _made_up(self, colour, makeup: np.ndarray, fields: np.ndarray, footprint: np.ndarray, lips: np.ndarray) -> np.ndarray:
        if not self.kind.makeup:
            return colour
        powder = noise(fields[:, PLACE], footprint, (5, 2.5), (0.5, 0.5), self._seed + 111)
        colour = colour * np.exp(0.05 * powder)[:, None]
        colour = _mix(colour, colour * [1.0, 0.62, 0.62], 0.7 * fields[:, CHEEKS] * np.clip(1 + 0.2 * powder, 0, 1.3))
        colour = _mix(colour, self._shadow, np.clip(0.7 * fields[:, LIDS] * (1 + 0.25 * powder), 0, 1))
        colour = _mix(colour, np.full(3, 0.01), 0.9 * _edge(2.0 - makeup[:, LASHES], 0.8))
        return _mix(colour, self._lipstick * np.exp(0.06 * powder)[:, None], 0.85 * lips)

    def _haired(self, colour, makeup: np.ndarray, at: np.ndarray, footprint: np.ndarray, on_head: np.ndarray) -> np.ndarray:
        """Brows, lashes and the hair of the head, in strands."""
        strands = noise(at * [0.35, 1.0, 1.0], footprint, (4.0, 2.2, 1.2), (0.4, 0.5, 0.5), self._seed + 121)
        hair = self._hair * np.exp(0.5 * strands)[:, None]
        brows = 0.85 * _edge(makeup[:, BROWS] - 0.5 + 0.7 * strands, 1.6)
        colour = _mix(colour, hair, brows)
        colour = _mix(colour, 0.3 * self._hair, 0.85 * _edge(0.9 - makeup[:, LASHES], 0.7))
        locks = noise(at * [1.0, 0.2, 0.3], footprint, (14.0, 5.0, 2.5), (0.4, 0.4, 0.4), self._seed + 131)
        return _mix(colour, self._hair * np.exp(0.6 * locks)[:, None], on_head)

    def relief(self, fields: np.ndarray, footprint: np.ndarray, rotation: np.ndarray) -> np.ndarray:
        """(P, 3) what the pores' relief adds to the normals in the camera frame; rotation (3, 3): head to camera."""
        at, step = fields[:, PLACE], 0.15
        lengths, heights = (0.9, 1.8, 5.0), np.array([0.008, 0.014, 0.025]) * self.kind.pores
        here = noise(at, footprint, lengths, heights, self._seed + 141)
        slopes = [noise(at + step * axis, footprint, lengths, heights, self._seed + 141) - here for axis in np.eye(3)]
        return -np.stack(slopes, axis=1) / step @ rotation.T

    def shine(self, surface: Surface, lamp: Lamp) -> np.ndarray:
        """(P,) gloss of unit oil (Blinn-Phong), of the lamp and a window above the camera; more at grazing angles (Schlick)."""
        total = np.zeros(len(surface.normals))
        for direction, level in ((lamp.light.key_direction, lamp.light.key), ((0.25, -0.55, -1.0), 0.5 * lamp.light.head)):
            to = np.asarray(direction, float) / np.linalg.norm(direction)
            cosine = np.einsum("pd,pd->p", surface.normals, unit(surface.towards_camera + to))
            total += 3.0 * level * np.clip(cosine, 0, 1) ** self.kind.sharpness
        facing = np.clip(np.einsum("pd,pd->p", surface.normals, surface.towards_camera), 0, 1)
        return total * (1 + 2.0 * (1 - facing) ** 5)


def shade_photographic(
    albedo: np.ndarray, gloss: np.ndarray, skin: PhotographicSkin, surface: Surface, lamp: Lamp
) -> np.ndarray:
    """(P, 3) sRGB, 0 to 255 and above, of points with linear albedo (P, 3) and gloss (P,)."""
    diffuse, _ = irradiance(surface.normals, surface.towards_camera, lamp.light)
    shine = gloss * skin.shine(surface, lamp)
    return to_srgb((albedo * diffuse[:, None] + shine[:, None]) * lamp.colour)


def to_srgb(linear: np.ndarray) -> np.ndarray:
    """Linear light, 1 is white, as 0 to 255 of a display; the power 1/2.2 stands for sRGB's curve."""
    return 255.0 * np.maximum(linear, 0.0) ** (1 / 2.2)


def to_linear(srgb: np.ndarray) -> np.ndarray:
    """The inverse of :func:`to_srgb`."""
    return (np.maximum(srgb, 0.0) / 255.0) ** 2.2


def _regions(points: np.ndarray, landmarks: np.ndarray) -> np.ndarray:
    """(D, 7) place and regions of the neutral skin (D, 3), from the features (40, 3): all in the head frame, mm."""
    at = dict(zip(FEATURE_IDS.tolist(), landmarks, strict=True))
    size = 0.5 * float(np.linalg.norm(at[45] - at[36]))
    middle, mouth = 0.5 * (at[36] + at[45]), 0.5 * (at[48] + at[54])
    x, down = (points[:, 0] - middle[0]) / size, (points[:, 1] - mouth[1]) / size
    eyes = (middle[1] - mouth[1]) / size
    front = _edge(points[:, 2] - (landmarks[:, 2].min() - 1.3 * size), 0.5 * size)
    fields = np.zeros((len(points), _FIELDS))
    fields[:, PLACE] = points
    top = np.interp(np.abs(x), [0.0, 0.55, 0.8, 1.2, 1.5, 1.7], [0.42, 0.38, 0.16, 0.5, eyes, eyes + 0.3])
    fields[:, BEARD] = front * _edge(top - down, 0.22) * _edge(down + 1.7, 0.4)

    def bump(centre_x: float, centre_y: float, wide: float, high: float) -> np.ndarray:
        return np.exp(-(((np.abs(x) - centre_x) / wide) ** 2) - ((down - centre_y) / high) ** 2)

    nose = bump(0.0, 0.55 * eyes, 0.3, 0.45)
    oily = bump(0.0, eyes + 0.85, 1.0, 0.4) + nose + 0.8 * bump(0.75, 0.6 * eyes, 0.3, 0.25) + 0.5 * bump(0.0, -0.75, 0.3, 0.2)
    fields[:, OIL] = front * np.clip(oily, 0, 1)
    fields[:, CHEEKS] = front * np.clip(bump(0.8, 0.5 * eyes, 0.4, 0.35) + 0.8 * nose, 0, 1)
    above = [
        bump(np.abs(at[i][0] - middle[0]) / size, (at[i][1] - mouth[1]) / size + 0.12, 0.22, 0.16) for i in (37, 38, 43, 44)
    ]
    fields[:, LIDS] = front * np.clip(1.2 * np.max(above, axis=0), 0, 1)
    return fields


def _edge(distance: np.ndarray, softness: float) -> np.ndarray:
    return soft_step(distance / softness + 0.5)


def _mix(below: np.ndarray, above: np.ndarray, share: np.ndarray) -> np.ndarray:
    return below + (above - below) * share[:, None]
