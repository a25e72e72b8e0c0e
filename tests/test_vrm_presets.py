"""VRM's preset expressions: names of VRM 1.0, VRM 0.x and VRoid Studio, and what drives them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from adaptiveface.retargeting.arkit import ARKIT_NAMES
from adaptiveface.retargeting.vrm_presets import (
    PRESETS,
    VRM0_NAMES,
    preset_name,
    preset_row,
    preset_weights,
)


def curves(**values: float) -> np.ndarray:
    out = np.zeros((1, len(ARKIT_NAMES)))
    for name, value in values.items():
        out[0, ARKIT_NAMES.index(name)] = value
    return out


def driven(**values: float) -> dict[str, float]:
    return {p: w for p, w in zip(PRESETS, preset_weights(curves(**values))[0].round(6).tolist(), strict=True) if w}


@pytest.mark.parametrize(
    ("name", "preset"),
    [
        ("aa", "aa"),
        ("A", "aa"),
        ("o", "oh"),
        ("Blink_L", "blinkLeft"),
        ("blink_l", "blinkLeft"),
        ("BLINK", "blink"),
        ("Joy", "happy"),
        ("happy", "happy"),
        ("Sorrow", "sad"),
        ("Fun", "relaxed"),
        ("LookLeft", "lookLeft"),
        ("lookup", "lookUp"),
        ("Fcl_MTH_U", "ou"),
        ("Fcl_EYE_Close_R", "blinkRight"),
        ("Fcl_ALL_Surprised", "surprised"),
        ("neutral", None),
        ("jawOpen", None),
        ("", None),
        ("Fcl_EYE_Joy_R", None),
        ("ab", None),
    ],
)
def test_names_in_every_vrm(name, preset):
    assert preset_name(name) == preset


def test_every_row_is_made_of_arkit_shapes_and_reaches_one():
    assert set(VRM0_NAMES) == set(PRESETS) - {"surprised"}
    for preset, row in PRESETS.items():
        assert set(row) <= set(ARKIT_NAMES), preset
        assert preset_row(preset)[preset_row(preset) > 0].sum() == pytest.approx(1.0, abs=0.21), preset


def test_a_plain_movement_drives_its_preset():
    assert driven(jawOpen=0.6) == {"aa": 0.6}
    assert driven(eyeBlinkLeft=1.0) == {"blink": 0.5, "blinkLeft": 1.0}
    assert driven(mouthSmileLeft=1.0, mouthSmileRight=1.0) == {"happy": 0.8}
    assert driven(eyeLookOutLeft=0.4, eyeLookInRight=0.4) == {"lookLeft": pytest.approx(0.4)}
    assert not driven()


def test_the_rounded_open_mouth_is_oh_and_surprise_is_not_sad():
    assert driven(jawOpen=0.4, mouthFunnel=0.7) == {"oh": 0.7}
    surprised = driven(browInnerUp=0.8, browOuterUpLeft=1, browOuterUpRight=1, eyeWideLeft=1, eyeWideRight=1)
    assert surprised == {"surprised": 1.0}
    assert "sad" in driven(browInnerUp=0.8, mouthFrownLeft=0.5, mouthFrownRight=0.5)


def test_weights_stay_within_zero_and_one():
    random = np.random.default_rng(0).uniform(0, 1, (200, len(ARKIT_NAMES)))
    weights = preset_weights(random)
    assert weights.shape == (200, len(PRESETS)) and weights.min() == 0 and weights.max() <= 1
    np.testing.assert_array_equal(preset_weights(random, ("oh",))[:, 0], random[:, ARKIT_NAMES.index("mouthFunnel")])


def preset_table() -> str:
    """The table as Markdown, for the documentation."""
    lines = ["| VRM 1.0 | VRM 0.x | ARKit shapes |", "|---|---|---|"]
    for preset, row in PRESETS.items():
        mixture = " ".join(f"{'-' if weight < 0 else '+'} {abs(weight):.3g} {name}" for name, weight in row.items())
        lines.append(f"| {preset} | {VRM0_NAMES.get(preset, '')} | {mixture.removeprefix('+ ')} |")
    return "\n".join(lines)


def test_the_documentation_has_the_table_of_the_code():
    page = (Path(__file__).parents[1] / "docs" / "retargeting.md").read_text(encoding="utf-8")
    assert preset_table() in page
