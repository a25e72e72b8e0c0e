"""Compute how far an avatar's eyes turn for a gaze: as VRM's look-at says, or else as far as a person's."""

from __future__ import annotations

import numpy as np

from ..errors import FileFormatError
from ..formats.gltf.container import GltfContainer, extensions
from ..livelink.convention import angles, rotations

#: Directions of gaze for each eye: yaw to the subject's left and right, pitch down and up.
_OUTER, _INNER, _DOWN, _UP = "HorizontalOuter", "HorizontalInner", "VerticalDown", "VerticalUp"
_MOST_DEGREES = 180.0


def gaze_by_expressions(file: GltfContainer) -> bool:
    """Whether expressions (lookUp, lookLeft, ...) direct the gaze of a VRM file, instead of the eyes' bones."""
    one, zero = _look_at(file)
    return one.get("type") == "expression" or zero.get("lookAtTypeName") == "BlendShape"


def reached(file: GltfContainer, gaze: np.ndarray, side: int) -> np.ndarray:
    """Apply a VRM file's range maps to eye rotations (F, 3, 3) in the face's axes; ``side`` 0 is the left eye."""
    limits = {name: _limit(file, name) for name in (_OUTER, _INNER, _DOWN, _UP)}
    if all(limit is None for limit in limits.values()):
        return gaze
    yaw, pitch, _ = np.degrees(angles(gaze)).T  # yaw is positive to the subject's right, pitch downwards
    right, left = (_INNER, _OUTER) if side == 0 else (_OUTER, _INNER)
    turned = np.stack(
        [
            np.where(yaw > 0, _mapped(yaw, limits[right]), _mapped(yaw, limits[left])),
            np.where(pitch > 0, _mapped(pitch, limits[_DOWN]), _mapped(pitch, limits[_UP])),
            np.zeros_like(yaw),
        ],
        axis=-1,
    )
    return rotations(np.radians(turned))


def _look_at(file: GltfContainer) -> tuple[dict, dict]:
    one = (extensions(file.document).get("VRMC_vrm") or {}).get("lookAt") or {}
    zero = (extensions(file.document).get("VRM") or {}).get("firstPerson") or {}
    return one, zero


def _limit(file: GltfContainer, name: str) -> tuple[float, float] | None:
    """The largest angle of gaze that the map covers, and the angle by which the eye turns then, degrees."""
    one, zero = _look_at(file)
    entry = one.get(f"rangeMap{name}") or zero.get(f"lookAt{name}")
    if not entry:
        return None
    limit = (
        float(entry.get("inputMaxValue", entry.get("xRange", 90.0))),
        float(entry.get("outputScale", entry.get("yRange", 10.0))),
    )
    if not all(np.isfinite(limit)) or not 0 < limit[0] <= 360 or not 0 <= limit[1] <= _MOST_DEGREES:
        raise FileFormatError(f"{file.path}: its look-at range {name} is {limit[0]:g} to {limit[1]:g} degrees")
    return limit


def _mapped(degrees: np.ndarray, limit: tuple[float, float] | None) -> np.ndarray:
    if limit is None:
        return degrees
    return np.sign(degrees) * np.minimum(np.abs(degrees) / limit[0], 1.0) * limit[1]
