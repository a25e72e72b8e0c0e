"""Build a new glTF 2.0 binary file (.glb): collect accessors and their bytes, and write them with a JSON document.

This is a writer of our own because libraries lack what is needed: trimesh writes no morph targets or animations, and pygltflib
only wraps the JSON objects.
"""

from __future__ import annotations

import json
import os

import numpy as np

from ...files import replacing
from .container import write_chunks
from .layout import COMPONENTS

#: What a buffer view holds: attributes of vertices, or numbers of vertices.
ATTRIBUTE, INDICES = 34962, 34963
_NUMBER = {np.dtype(kind): number for number, kind in COMPONENTS.items()}
#: A vertex whose target moves it less than this is left out of the sparse accessor, m (float32 rounds more).
_STILL = 1e-8


class GltfBuilder:
    """Collects accessors and their bytes. Every method that adds one returns its number.

    Attributes
    ----------
    views, accessors : list of dict
        The entries of the JSON document so far.
    binary : bytearray
        The content of the binary chunk so far.
    """

    def __init__(self) -> None:
        self.views: list[dict] = []
        self.accessors: list[dict] = []
        self.binary = bytearray()

    def view(self, array: np.ndarray, target: int | None = None) -> int:
        """Add a buffer view with the bytes of an array. ``target`` is ``ATTRIBUTE``, ``INDICES`` or None."""
        self.binary += b"\0" * (-len(self.binary) % 4)
        view = {"buffer": 0, "byteOffset": len(self.binary)}
        if target == ATTRIBUTE and array[0].nbytes % 4:  # attributes start at multiples of four bytes
            padding = -array[0].nbytes % 4 // array.itemsize
            array = np.pad(array, ((0, 0), (0, padding)))
            view["byteStride"] = array[0].nbytes
        view["byteLength"] = array.nbytes
        if target:
            view["target"] = target
        self.binary += np.ascontiguousarray(array).tobytes()
        self.views.append(view)
        return len(self.views) - 1

    def accessor(self, array: np.ndarray, target: int | None = None, bounds: bool = False, **more) -> int:
        """Add an accessor.

        Parameters
        ----------
        array : (n,) or (n, width)
            Its values.
        target : int, optional
            ``ATTRIBUTE`` or ``INDICES``.
        bounds : bool
            Whether the entry has the smallest and the largest values.
        **more
            Further keys of the entry.
        """
        kind = "SCALAR" if array.ndim == 1 else f"VEC{array.shape[1]}"
        entry = {"bufferView": self.view(array, target), "componentType": _NUMBER[array.dtype], "count": len(array)}
        self._add(entry | {"type": kind} | more, array if bounds else None)
        return len(self.accessors) - 1

    def attribute(self, array: np.ndarray, bounds: bool = False) -> int:
        """Add an attribute (V, 3) of the vertices: float32, or integers that stand for -1 to 1."""
        return self.accessor(array, ATTRIBUTE, bounds, **normalized(array))

    def sparse(self, array: np.ndarray, bounds: bool = False) -> int:
        """Add an attribute (V, 3) as a sparse accessor if most of it is zero."""
        moving = np.flatnonzero(np.abs(array).max(axis=1) > _STILL)
        if len(moving) > 0.8 * len(array):
            return self.attribute(array, bounds)
        entry = {"componentType": _NUMBER[array.dtype], "count": len(array), "type": "VEC3"} | normalized(array)
        kept = np.zeros_like(array)
        if len(moving):
            kept[moving] = array[moving]
            index = moving.astype(np.uint16 if len(array) <= 65535 else np.uint32)
            entry["sparse"] = {
                "count": len(moving),
                "indices": {"bufferView": self.view(index), "componentType": _NUMBER[index.dtype]},
                "values": {"bufferView": self.view(array[moving])},
            }
        else:  # some readers take an accessor without any data for a mistake
            entry["bufferView"] = self.view(kept, ATTRIBUTE)
        self._add(entry, kept if bounds else None)
        return len(self.accessors) - 1

    def _add(self, entry: dict, bounded: np.ndarray | None) -> None:
        if bounded is not None:
            low, high = np.atleast_1d(bounded.min(axis=0)), np.atleast_1d(bounded.max(axis=0))
            entry |= {"min": low.tolist(), "max": high.tolist()}
        self.accessors.append(entry)

    def write(self, path: str | os.PathLike, document: dict) -> None:
        """Write ``document`` with everything collected as ``.glb``, whole or not at all.

        Raises :class:`FileFormatError` if the file would exceed 4 GiB.
        """
        views = {"accessors": self.accessors, "bufferViews": self.views, "buffers": [{"byteLength": len(self.binary)}]}
        text = json.dumps(document | views, separators=(",", ":"), allow_nan=False).encode()
        with replacing(path) as temporary, open(temporary, "wb") as stream:
            write_chunks(stream, path, [(b"JSON", [text]), (b"BIN\0", [self.binary])])


def normalized(array: np.ndarray) -> dict:
    """The key that tells that integers stand for -1 to 1, or for 0 to 1 if they are unsigned. Floats need none."""
    return {} if array.dtype.kind == "f" else {"normalized": True}
