"""The ARKit-named expression units on the tracking mesh, mended, and the 23 generic expressions as mixtures of them.

What is mended, and why: the authored units were made for a finer mesh and one head. Fields with steps (cheek puff,
cheek squint, smile) are smoothed with the lips and lids held; units whose lips cross are taken to contact; the blink
closes.
"""

from __future__ import annotations

import numpy as np
from tqdm import tqdm

from .anatomy import Anatomy
from .identity_space import mirrored
from .lids import blink
from .makehuman import MakeHuman
from .mouth import separate_lips

EMPTY_ON_SKIN = ("tongueOut",)
BLINK_SCALE = 0.75  # the authored blink overshoots on the mean head
BLINK_LENGTH_MM = 2.5
DEFAULT_LENGTH_MM = 1.5
# Smoothing length of units with hard steps, and how much of their strength stays.
LENGTH_MM = {
    "cheekPuff": 11.0,
    "cheekSquintLeft": 6.0,
    "mouthSmileLeft": 7.0,
    "browDownLeft": 3.0,
    "mouthFunnel": 2.5,
    "mouthPucker": 2.5,
    "mouthDimpleLeft": 4.0,
    "mouthStretchLeft": 4.0,
    "mouthLeft": 4.0,
}
STRENGTH = {"mouthSmileLeft": 0.85}
CONTOUR_WEIGHT = 30.0  # lips and lid margins hold to the authored unit ...
SOFT_LIPS = {"mouthFunnel": 3.0, "mouthPucker": 3.0}  # ... less where the authored lips have corners
NEGLIGIBLE_MM = 0.02  # the smoothed fields' tails are cut here: invisible, and the file stays small
# Crossing lips: the share of the correction that the upper lip takes (default one half). A rolling lip yields alone.
UPPER_SHARE = {"mouthRollUpper": 1.0, "mouthRollLower": 0.0}

#: name -> mixture; after FACS (Ekman & Friesen 1978): 26/27 jaw drop, 30 jaw sideways, 29 jaw thrust, 12 lip corner
#: puller, 15 lip corner depressor, 18 lip pucker, 22 lip funneler, 10 upper lip raiser, 16 lower lip depressor, 20
#: lip stretcher, 28 lip suck, 17 chin raiser, 34 puff, 45/46 blink and wink, 4 brow lowerer, 1 and 2 brow raisers, 9
#: + 6 nose wrinkler.
GENERIC = {
    "jawOpen": {"jawOpen": 1.0},
    "jawLeft": {"jawLeft": 1.0},
    "jawRight": {"jawRight": 1.0},
    "jawForward": {"jawForward": 1.0},
    "mouthSmileLeft": {"mouthSmileLeft": 1.0},
    "mouthSmileRight": {"mouthSmileRight": 1.0},
    "mouthFrown": {"mouthFrownLeft": 1.0, "mouthFrownRight": 1.0},
    "mouthPucker": {"mouthPucker": 1.0},
    "mouthFunnel": {"mouthFunnel": 1.0},
    "mouthLeft": {"mouthLeft": 1.0},
    "mouthRight": {"mouthRight": 1.0},
    "mouthUpperUp": {"mouthUpperUpLeft": 1.0, "mouthUpperUpRight": 1.0},
    "mouthLowerDown": {"mouthLowerDownLeft": 1.0, "mouthLowerDownRight": 1.0},
    "mouthStretch": {"mouthStretchLeft": 1.0, "mouthStretchRight": 1.0},
    "mouthRoll": {"mouthRollUpper": 1.0, "mouthRollLower": 1.0},
    "chinRaise": {"mouthShrugLower": 1.0, "mouthShrugUpper": 0.5},
    "cheekPuff": {"cheekPuff": 1.0},
    "eyeBlinkLeft": {"eyeBlinkLeft": 1.0},
    "eyeBlinkRight": {"eyeBlinkRight": 1.0},
    "browDown": {"browDownLeft": 1.0, "browDownRight": 1.0},
    "browInnerUp": {"browInnerUp": 1.0},
    "browOuterUp": {"browOuterUpLeft": 1.0, "browOuterUpRight": 1.0},
    "noseSneer": {"noseSneerLeft": 1.0, "noseSneerRight": 1.0, "cheekSquintLeft": 0.6, "cheekSquintRight": 0.6},
}


def authored_units(base: MakeHuman, anatomy: Anatomy, scale: float) -> dict[str, np.ndarray]:
    """The units as authored, carried to the tracking mesh, mm: name -> (V, 3); right ones are mirrored left ones."""
    mirror, operator = anatomy.mesh.mirror, anatomy.mesh.operator
    names = [name for name in base.face_unit_names() if name not in EMPTY_ON_SKIN]
    units = {name: scale * (operator @ base.face_unit(name).astype(float)) for name in names}
    for name in names:
        opposite = _opposite(name)
        units[name] = 0.5 * (units[name] + mirrored(units[opposite], mirror))
        units[opposite] = mirrored(units[name], mirror)
    return units


def _opposite(name: str) -> str:
    for this, other in (("Left", "Right"), ("Right", "Left")):
        if name.endswith(this):
            return name[: -len(this)] + other
    return name


def mend_units(units: dict[str, np.ndarray], mean: np.ndarray, anatomy: Anatomy) -> dict[str, np.ndarray]:
    """The mended units of the mean head, mean (V, 3)."""
    mended = {}
    for name in tqdm(units, desc="mending expressions"):
        if name.endswith("Right"):
            continue
        field = _smoothed(name, units[name], mean, anatomy)
        if name != "mouthClose":  # means something only together with jawOpen
            field = field + _contact(mean + field, anatomy, UPPER_SHARE.get(name, 0.5))
        mended[name] = field
    both = mean + mended["jawOpen"] + mended["mouthClose"]
    mended["mouthClose"] = mended["mouthClose"] + _contact(both, anatomy, 0.5)
    for name in units:
        if _opposite(name) == name:
            mended[name] = 0.5 * (mended[name] + mirrored(mended[name], anatomy.mesh.mirror))
        elif name.endswith("Right"):
            mended[name] = mirrored(mended[_opposite(name)], anatomy.mesh.mirror)
    return {name: _without_tails(mended[name]) for name in units}


def _without_tails(field: np.ndarray) -> np.ndarray:
    return np.where(np.linalg.norm(field, axis=1, keepdims=True) > NEGLIGIBLE_MM, field, 0.0)


def _contact(points: np.ndarray, anatomy: Anatomy, share: float) -> np.ndarray:
    return separate_lips(points, anatomy.lips, anatomy.mesh.triangles, anatomy.smoother, share)


def _smoothed(name: str, unit: np.ndarray, mean: np.ndarray, anatomy: Anatomy) -> np.ndarray:
    if name == "eyeBlinkLeft":
        unit = anatomy.smoother.smooth(BLINK_SCALE * unit, BLINK_LENGTH_MM)
        return blink(mean, unit, anatomy.left_eye, anatomy.left_lid_distance, anatomy.smoother)
    weight = np.ones(len(mean))
    weight[anatomy.lip] = SOFT_LIPS.get(name, CONTOUR_WEIGHT)
    weight[anatomy.lid_distance < 0.1] = CONTOUR_WEIGHT
    return STRENGTH.get(name, 1.0) * anatomy.smoother.smooth(unit, LENGTH_MM.get(name, DEFAULT_LENGTH_MM), weight)


def generic_weights(names: list[str]) -> np.ndarray:
    """(23, E) float32: the generic expressions over the units ``names``."""
    weights = np.zeros((len(GENERIC), len(names)), np.float32)
    for row, mixture in zip(weights, GENERIC.values(), strict=True):
        for name, value in mixture.items():
            row[names.index(name)] = value
    return weights
