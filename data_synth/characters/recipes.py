"""What makes each character: MakeHuman targets far beyond anyone's face, and sculpting by smooth fields.

Targets are given in their own units (1 = the slider's end); ``sculpt`` moves balls of space: (centre relative to a
feature, radius, displacement), in millimetres of the head frame. Fields act on everything inside, teeth and eyes too.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np


@dataclass(frozen=True)
class Recipe:
    """One character.

    macro: target -> weight of the body's macro targets (age, sex, build); details: face sliders, ``*`` stands for both
    sides (``l`` and ``r``); sculpt: (anchor, offset mm, radius mm, displacement mm), anchors are iBUG numbers of
    features or ``nose``, ``chin``, ``scalp``, ``("ear", side)``; size: factor of the whole head; wrinkles, warts: see
    ``skin.py``; colours: sRGB of skin, lips, hair, iris, teeth; tusks mm; motion: factor of the expressions; hair: how
    much of the colour of the hair shows.
    """

    macro: dict[str, float]
    details: dict[str, float]
    sculpt: list[tuple] = field(default_factory=list)
    size: float = 1.0
    wrinkles: float = 0.0
    warts: list[tuple] = field(default_factory=list)
    colours: dict[str, tuple[int, int, int]] = field(default_factory=dict)
    tusks: float = 0.0
    motion: float = 1.0
    hair: float = 0.0


_ADULT = "macrodetails/universal-{}-{}-{}muscle-{}weight"

RECIPES = {
    "baby": Recipe(
        macro={
            "macrodetails/caucasian-female-baby": 0.5,
            "macrodetails/asian-female-baby": 0.5,
            _ADULT.format("female", "baby", "average", "max"): 0.6,
            _ADULT.format("female", "baby", "average", "average"): 0.4,
        },
        details={
            "head/head-fat-incr": 0.2,
            "*-eye-scale-incr": 0.6,
            "*-eye-height2-incr": 0.25,
            "*-cheek-volume-incr": 0.3,
            "nose/nose-scale-vert-decr": 0.3,
            "nose/nose-point-up": 0.5,
            "chin/chin-height-decr": 0.3,
            "*-ear-wing-incr": 0.5,
            "mouth/mouth-scale-horiz-decr": 0.15,
        },
        size=0.92,
        hair=0.35,
        colours={
            "skin": (240, 196, 176),
            "lips": (216, 128, 124),
            "hair": (196, 152, 112),
            "iris": (70, 120, 190),
            "blush": (240, 150, 140),
            "teeth": (214, 128, 126),
        },
    ),
    "hag": Recipe(
        macro={"macrodetails/caucasian-female-old": 1.15, _ADULT.format("female", "old", "min", "min"): 0.9},
        details={
            "nose/nose-hump-incr": 0.9,
            "nose/nose-point-down": 0.9,
            "nose/nose-scale-vert-incr": 0.5,
            "nose/nose-scale-depth-incr": 0.6,
            "nose/nose-curve-convex": 0.5,
            "nose/nose-width3-decr": 0.2,
            "chin/chin-prominent-incr": 1.0,
            "chin/chin-height-incr": 0.5,
            "chin/chin-width-decr": 0.6,
            "chin/chin-triangle": 0.5,
            "*-cheek-inner-decr": 0.5,
            "*-cheek-volume-decr": 0.8,
            "*-cheek-bones-incr": 0.9,
            "*-eye-bag-incr": 0.8,
            "*-eye-bag-height-incr": 0.5,
            "*-ear-scale-vert-incr": 0.5,
            "*-ear-lobe-incr": 0.8,
            "mouth/mouth-upperlip-volume-decr": 0.6,
            "mouth/mouth-lowerlip-volume-decr": 0.5,
            "mouth/mouth-laugh-lines-in": 0.8,
            "mouth/mouth-angles-down": 0.5,
            "head/head-age-incr": 1.0,
            "head/head-scale-horiz-decr": 0.3,
            "asym/asym-jaw-1-l": 0.5,
            "asym/asym-brown-1-r": 0.8,
            "asym/asym-nose-1-l": 0.35,
            "forehead/forehead-temple-decr": 0.7,
        },
        sculpt=[
            ("nose", (0, -2, 2), 15, (1.5, -8, 9)),
            ("chin", (0, -4, 4), 21, (2, -1, 13)),
            (19, (0, 5, 2), 14, (0, -3, 2.5)),
            (24, (0, 5, 2), 14, (0, 1, 3)),
        ],
        size=0.97,
        wrinkles=1.0,
        hair=0.8,
        warts=[("nose", (-6, 6, -2), 3.6, 3.4), ("chin", (-9, 2, 2), 3.4, 3.0), (54, (16, 13, 0), 2.8, 2.2)],
        colours={
            "skin": (196, 174, 138),
            "lips": (146, 92, 90),
            "hair": (164, 158, 148),
            "iris": (120, 140, 60),
            "blush": (172, 120, 96),
            "teeth": (200, 178, 110),
        },
    ),
    "ogre": Recipe(
        macro={
            "macrodetails/african-male-young": 0.5,
            "macrodetails/caucasian-male-young": 0.5,
            _ADULT.format("male", "young", "max", "max"): 1.0,
        },
        details={
            "nose/nose-width1-incr": 0.8,
            "nose/nose-width2-incr": 1.0,
            "nose/nose-width3-incr": 1.0,
            "nose/nose-flaring-incr": 0.9,
            "nose/nose-compression-compress": 0.4,
            "nose/nose-volume-incr": 0.6,
            "nose/nose-point-up": 0.5,
            "chin/chin-prognathism-incr": 0.9,
            "chin/chin-width-incr": 1.0,
            "chin/chin-height-incr": 0.5,
            "chin/chin-bones-incr": 1.0,
            "chin/chin-prominent-incr": 0.4,
            "*-ear-shape-pointed": 1.0,
            "*-ear-scale-incr": 0.9,
            "*-ear-wing-incr": 1.0,
            "*-cheek-bones-incr": 0.8,
            "mouth/mouth-scale-horiz-incr": 0.6,
            "mouth/mouth-lowerlip-volume-incr": 0.6,
            "forehead/forehead-trans-backward": 0.6,
            "head/head-square": 0.5,
            "neck/neck-scale-horiz-incr": 0.8,
            "eyebrows/eyebrows-trans-forward": 0.8,
            "eyebrows/eyebrows-angle-down": 0.3,
            "forehead/forehead-scale-vert-decr": 0.6,
        },
        sculpt=[
            (20, (0, 4, 2), 18, (0, -2.5, 8)),
            (23, (0, 4, 2), 18, (0, -2.5, 8)),
            (18, (0, 4, 0), 18, (0, -1, 7)),
            (25, (0, 4, 0), 18, (0, -1, 7)),
            ("chin", (24, 4, -8), 26, (7, -3, 3)),
            ("chin", (-24, 4, -8), 26, (-7, -3, 3)),
            ("chin", (0, -4, 4), 24, (0, -4, 8)),
            ("scalp", (0, 0, 30), 60, (0, -13, -10)),
            ("nose", (0, 4, 0), 17, (0, 3, -3)),
            (("ear", 1), (0, 22, -6), 30, (16, 20, -8)),
            (("ear", -1), (0, 22, -6), 30, (-16, 20, -8)),
        ],
        size=1.3,
        wrinkles=0.35,
        tusks=11.0,
        hair=0.0,
        warts=[(36, (-14, -14, 0), 4.0, 2.6), ("chin", (18, 16, 0), 4.5, 3.0), ("scalp", (22, -12, 40), 5.0, 3.0)],
        colours={
            "skin": (112, 140, 84),
            "lips": (92, 96, 74),
            "hair": (70, 84, 56),
            "iris": (206, 150, 40),
            "blush": (132, 128, 74),
            "teeth": (216, 204, 160),
        },
    ),
}


def side_names(name: str) -> list[tuple[str, float]]:
    """Targets of one detail: ``*-eye-scale-incr`` -> both sides in their folder."""
    if not name.startswith("*-"):
        return [(name, 1.0)]
    folder = {"eye": "eyes", "ear": "ears", "cheek": "cheek"}[name[2:].split("-")[0]]
    return [(f"{folder}/{side}{name[1:]}", 1.0) for side in "lr"]


def bump(points: np.ndarray, centre: np.ndarray, radius: float) -> np.ndarray:
    """(n,) smooth weight, 1 at the centre, 0 from ``radius`` on (C2: Wendland's function)."""
    r = np.clip(np.linalg.norm(points - centre, axis=1) / radius, 0, 1)
    return (1 - r) ** 4 * (4 * r + 1)
