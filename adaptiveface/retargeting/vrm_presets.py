"""VRM's preset expressions as mixtures of Apple's ARKit shapes, for avatars without ARKit names.

The table :data:`PRESETS` uses the names of VRM 1.0. VRM 0.x and VRoid Studio have other names for the same expressions
(:data:`VRM0_NAMES`, :func:`preset_name`). A preset's weight is the weighted sum of the curves, clipped to [0, 1].
Negative weights separate expressions that share a movement: the jaw also opens in "oh", and the inner brow also rises in
surprise.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .arkit import ARKIT_NAMES
from .shape_names import letters


def _pair(weight: float, *names: str) -> dict[str, float]:
    return {name + side: weight for name in names for side in ("Left", "Right")}


#: VRM 1.0 preset -> weight of each ARKit shape in it. "neutral" is the rest pose and has no row.
PRESETS: dict[str, dict[str, float]] = {
    "aa": {"jawOpen": 1.0, "mouthFunnel": -0.7, "mouthPucker": -0.7},
    "ih": _pair(0.5, "mouthStretch"),
    "ou": {"mouthPucker": 1.0},
    "ee": _pair(0.25, "mouthUpperUp", "mouthLowerDown"),
    "oh": {"mouthFunnel": 1.0},
    "blink": _pair(0.5, "eyeBlink"),
    "blinkLeft": {"eyeBlinkLeft": 1.0},
    "blinkRight": {"eyeBlinkRight": 1.0},
    "happy": _pair(0.4, "mouthSmile") | _pair(0.1, "cheekSquint"),
    "angry": _pair(0.4, "browDown") | _pair(0.1, "noseSneer"),
    "sad": {"browInnerUp": 0.5} | _pair(0.35, "mouthFrown") | _pair(-0.25, "browOuterUp"),
    "relaxed": _pair(0.5, "eyeSquint") | _pair(-0.5, "browDown"),
    "surprised": _pair(0.25, "eyeWide", "browOuterUp"),
    "lookUp": _pair(0.5, "eyeLookUp"),
    "lookDown": _pair(0.5, "eyeLookDown"),
    "lookLeft": {"eyeLookOutLeft": 0.5, "eyeLookInRight": 0.5},
    "lookRight": {"eyeLookInLeft": 0.5, "eyeLookOutRight": 0.5},
}
#: VRM 1.0 preset -> its name in VRM 0.x, as UniVRM writes it; "surprised" is new in 1.0.
VRM0_NAMES: dict[str, str] = {
    "aa": "A",
    "ih": "I",
    "ou": "U",
    "ee": "E",
    "oh": "O",
    "blink": "Blink",
    "blinkLeft": "Blink_L",
    "blinkRight": "Blink_R",
    "happy": "Joy",
    "angry": "Angry",
    "sad": "Sorrow",
    "relaxed": "Fun",
    "lookUp": "LookUp",
    "lookDown": "LookDown",
    "lookLeft": "LookLeft",
    "lookRight": "LookRight",
}
# Names of VRoid Studio's morph targets with the same meaning, for files that lost their VRM part in a conversion.
_VROID = {
    "aa": "Fcl_MTH_A",
    "ih": "Fcl_MTH_I",
    "ou": "Fcl_MTH_U",
    "ee": "Fcl_MTH_E",
    "oh": "Fcl_MTH_O",
    "blink": "Fcl_EYE_Close",
    "blinkLeft": "Fcl_EYE_Close_L",
    "blinkRight": "Fcl_EYE_Close_R",
    "happy": "Fcl_ALL_Joy",
    "angry": "Fcl_ALL_Angry",
    "sad": "Fcl_ALL_Sorrow",
    "relaxed": "Fcl_ALL_Fun",
    "surprised": "Fcl_ALL_Surprised",
}


_BY_KEY = {letters(name): preset for names in ({p: p for p in PRESETS}, VRM0_NAMES, _VROID) for preset, name in names.items()}


def preset_name(name: str) -> str | None:
    """The VRM 1.0 preset that ``name`` stands for (VRM 1.0, VRM 0.x or VRoid Studio, any case), or None.

    >>> preset_name("Blink_L"), preset_name("joy"), preset_name("Fcl_MTH_A"), preset_name("jawOpen")
    ('blinkLeft', 'happy', 'aa', None)
    """
    return _BY_KEY.get(letters(name))


def preset_row(preset: str) -> np.ndarray:
    """(52,) weights of the ARKit shapes, in the order of ``ARKIT_NAMES``, in a VRM 1.0 preset."""
    return np.array([PRESETS[preset].get(name, 0.0) for name in ARKIT_NAMES])


def preset_weights(curves: np.ndarray, presets: Sequence[str] = tuple(PRESETS)) -> np.ndarray:
    """(F, P) weights in [0, 1] of VRM 1.0 presets for ARKit curves (F, 52). By default, these are all of them."""
    matrix = np.array([preset_row(preset) for preset in presets]).reshape(len(presets), len(ARKIT_NAMES))
    return np.clip(np.asarray(curves, float) @ matrix.T, 0.0, 1.0)
