"""The unit of length and the origin of heads from elsewhere."""

from __future__ import annotations

import numpy as np

#: Usual heights of a head, with neck or bust, mm.
SMALLEST_HEAD, LARGEST_HEAD = 80.0, 600.0
#: Millimetres per unit that files come in, and the largest extent of a head, with neck or bust, in mm.
_UNITS = ((1.0, "millimetres"), (10.0, "centimetres"), (100.0, "decimetres"), (1000.0, "metres"))
_SMALLEST, _LARGEST = 140.0, 1200.0


def to_head_frame(neutral: np.ndarray, unit: float | None) -> tuple[np.ndarray, float, list[str]]:
    """Vertices (V, 3) in mm, millimetres per unit of the file, and a note.

    ``unit``: millimetres per unit where the format says so (glTF: 1000); None: told from the size, the unit that makes
    the largest extent that of a head. Axes stay: x left-right, y up, z out of the face, as in ARKit's and glTF's use.
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
    """One line about a head that is not as high as heads are (``height`` in mm), else []."""
    if SMALLEST_HEAD <= height <= LARGEST_HEAD:
        return []
    shown = f"{height / 1000:.3g} m" if height >= 1000 else f"{height:.3g} mm"
    return [f"{path}: the head is {shown} high; if that is not meant, say the file's unit with --unit mm, cm or m"]
