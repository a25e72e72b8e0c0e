"""Check what the accessors of a glTF 2.0 file declare, and limit how many values are read from it."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from .container import GltfContainer

MAX_VALUES = 100_000_000
#: How many values may be zero without any data in the file: a fixed number, and some for every byte of the file.
FREE_ZEROS, ZEROS_PER_BYTE = 10_000_000, 64
_TYPES = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}
#: Component types by their numbers in files.
COMPONENTS = {5120: np.int8, 5121: np.uint8, 5122: np.int16, 5123: np.uint16, 5125: np.uint32, 5126: np.float32}


class GltfLayout(GltfContainer):
    """A parsed file whose accessors are known, but not read. Every method raises :class:`FileFormatError` naming the file."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._read_values = self._zeros = 0

    def layout(self, index) -> tuple[dict, np.dtype, int, int]:
        """The entry of an accessor, its component type, its width (3 for VEC3), and its number of elements."""
        entry = self.item("accessors", index)
        if entry.get("componentType") not in COMPONENTS or entry.get("type") not in _TYPES:
            raise self.error(f"accessor {index} has an unknown component type or type")
        count = self.whole(entry, "count", 1, MAX_VALUES)
        return entry, np.dtype(COMPONENTS[entry["componentType"]]), _TYPES[entry["type"]], count

    def floats(self, index, entry: dict, values: np.ndarray) -> np.ndarray:
        """The values of an accessor, which must be finite. Normalised integers are converted to floats."""
        if values.dtype.kind == "f" and not np.isfinite(values).all():
            raise self.error(f"accessor {index} holds NaN or infinite values")
        if entry.get("normalized") and values.dtype.kind in "iu":
            return np.maximum(values / np.float32(np.iinfo(values.dtype).max), np.float32(-1.0)).astype(np.float32)
        return values

    def spend(self, values: int, zeros: bool = False) -> None:
        """Count values that are about to be allocated, and raise :class:`FileFormatError` if there are too many.

        ``zeros`` tells that the file holds no data for them.
        """
        self._read_values += values
        self._zeros += values if zeros else 0
        if self._read_values > MAX_VALUES:
            raise self.error(f"its accessors hold more than {MAX_VALUES} values")
        if self._zeros > FREE_ZEROS + ZEROS_PER_BYTE * self.size:
            raise self.error(f"it declares {self._zeros} values without data, far more than its size explains")
