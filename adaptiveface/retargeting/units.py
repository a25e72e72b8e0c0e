"""Find the unit of length of heads from files that do not tell it, and check their size."""

from __future__ import annotations

import numpy as np

#: Range of usual heights of a head, with neck or bust, mm.
SMALLEST_HEAD, LARGEST_HEAD = 80.0, 600.0
#: Millimetres per unit, and the unit's name.
_UNITS = ((1.0, "millimetres"), (10.0, "centimetres"), (100.0, "decimetres"), (1000.0, "metres"))
#: Range of the largest extent of a head, with neck or bust, mm.
_SMALLEST, _LARGEST = 140.0, 1200.0


def to_head_frame(neutral: np.ndarray, unit: float | None) -> tuple[np.ndarray, float, list[str]]:
    """Convert a head to millimetres. The axes do not change: x left-right, y up, z out of the face, as in ARKit and glTF.

    Parameters
    ----------
    neutral : (V, 3)
        In the file's unit.
    unit : float or None
        Millimetres per unit, if they are known. With None, it is the unit in which the head has the size of a head.

    Returns
    -------
    vertices : (V, 3)
        In mm.
    scale : float
        Millimetres per unit of the file.
    notes : list of str
        A line about the unit, if it was not known and is not the millimetre.
    """
    if unit is not None:
        return unit * neutral, unit, []
    extent = float(np.ptp(neutral, axis=0).max())
    for scale, name in _UNITS:
        if _SMALLEST <= scale * extent <= _LARGEST:
            return scale * neutral, scale, [f"lengths read as {name}"] if scale != 1 else []
    scale = 240.0 / extent if extent > 0 else 1.0
    return scale * neutral, scale, [f"scaled by {scale:.4g}, so that the head is 240 mm tall"]


def size_note(path, height: float) -> list[str]:
    """A line about a head of unusual ``height``, mm. The list is empty for a usual one."""
    if SMALLEST_HEAD <= height <= LARGEST_HEAD:
        return []
    shown = f"{height / 1000:.3g} m" if height >= 1000 else f"{height:.3g} mm"
    return [f"{path}: the head is {shown} high; if that is wrong, give the file's unit with --unit mm, cm or m"]
