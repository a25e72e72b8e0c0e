"""Read the accessors of glTF 2.0, also sparse, quantised and compressed ones. Sizes are checked before memory is allocated."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from .compressed import Compressed
from .container import MAX_FILE_BYTES
from .layout import COMPONENTS, GltfLayout

#: Kinds of primitives that are made of triangles.
TRIANGLES, STRIP, FAN = 4, 5, 6


class GltfFile(GltfLayout):
    """A parsed file with its accessors. Every method raises :class:`FileFormatError` naming the file."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self.compressed = Compressed(self)

    def _view(self, index, dtype: np.dtype, width: int, count: int, offset: int) -> np.ndarray:
        """Values (count, width) in a buffer view, whose bounds are checked first."""
        view = self.item("bufferViews", index)
        size = self.whole(view, "byteLength", 1, MAX_FILE_BYTES)
        element = width * dtype.itemsize
        stride = self.whole(view, "byteStride", element, 252, element) if "byteStride" in view else element
        if offset + (count - 1) * stride + element > size:
            raise self.error(f"an accessor of {count} elements does not fit into the {size} bytes of its buffer view")
        decoded = self.compressed.view(index)
        data = self.buffer(view.get("buffer")) if decoded is None else memoryview(decoded)
        start = self.whole(view, "byteOffset", 0, MAX_FILE_BYTES, 0) if decoded is None else 0
        if start + size > len(data):
            raise self.error(f"buffer view {index} ends at byte {start + size} of {len(data)}")
        return np.ndarray((count, width), dtype, data, start + offset, (stride, dtype.itemsize))

    def accessor(self, index, count: int | None = None) -> np.ndarray:
        """Read an accessor.

        Parameters
        ----------
        index : int
            Its number.
        count : int, optional
            How many elements it must hold. This is checked before memory is allocated.

        Returns
        -------
        (count, width)
            float32 or integers. Normalised integers become floats. All values are finite.
        """
        entry, dtype, width, declared = self.layout(index)
        if count is not None and declared != count:
            raise self.error(f"accessor {index} holds {declared} elements, {count} are expected")
        self.spend(declared * width, zeros="bufferView" not in entry)
        if "bufferView" in entry:
            offset = self.whole(entry, "byteOffset", 0, MAX_FILE_BYTES, 0)
            values = self._view(entry["bufferView"], dtype, width, declared, offset).copy()
        elif count is None and "sparse" not in entry:
            raise self.error(f"accessor {index} has no data")
        else:
            values = np.zeros((declared, width), dtype)
        if "sparse" in entry:
            self._fill_sparse(entry["sparse"], values)
        return self.floats(index, entry, values)

    def _fill_sparse(self, sparse: dict, values: np.ndarray) -> None:
        count = self.whole(sparse, "count", 1, len(values))
        indices, data = sparse["indices"], sparse["values"]
        if indices.get("componentType") not in (5121, 5123, 5125):
            raise self.error("sparse indices of an unknown component type")
        kind = np.dtype(COMPONENTS[indices["componentType"]])
        offset = self.whole(indices, "byteOffset", 0, MAX_FILE_BYTES, 0)
        at = self._view(indices["bufferView"], kind, 1, count, offset)[:, 0]
        if at.max() >= len(values):
            raise self.error(f"a sparse index {at.max()} points outside {len(values)} elements")
        offset = self.whole(data, "byteOffset", 0, MAX_FILE_BYTES, 0)
        values[at] = self._view(data["bufferView"], values.dtype, values.shape[1], count, offset)

    def triangles(self, primitive: dict, n_vertices: int, corners: np.ndarray | None = None) -> np.ndarray:
        """Triangles (T, 3) int32 of a primitive of triangles, a strip or a fan.

        ``corners`` are its indices, if they are known. Otherwise, they are read.
        """
        if corners is None and "indices" in primitive:
            corners = self.accessor(primitive["indices"])
            if corners.shape[1] != 1 or corners.dtype.kind != "u":
                raise self.error("indices must be unsigned whole numbers")
        corners = np.arange(n_vertices, dtype=np.uint32) if corners is None else corners.reshape(-1)
        if len(corners) and corners.max() >= n_vertices:
            raise self.error(f"index {corners.max()} points outside the {n_vertices} vertices")
        corners, mode = corners.astype(np.int32), primitive.get("mode", TRIANGLES)
        if mode == TRIANGLES:
            if len(corners) % 3:
                raise self.error(f"{len(corners)} indices do not make triangles")
            return corners.reshape(-1, 3)
        return _strip(corners) if mode == STRIP else _fan(corners)


def _strip(corners: np.ndarray) -> np.ndarray:
    """Each corner after the second makes a triangle with the two before it. Every other one is reversed (glTF 2.0, 3.7.2.1)."""
    first = np.arange(max(len(corners) - 2, 0))
    order = np.column_stack([first, first + 1 + first % 2, first + 2 - first % 2])
    return _whole_triangles(corners[order])


def _fan(corners: np.ndarray) -> np.ndarray:
    first = np.arange(1, max(len(corners) - 1, 1))
    return _whole_triangles(corners[np.column_stack([first, first + 1, np.zeros_like(first)])])


def _whole_triangles(triangles: np.ndarray) -> np.ndarray:
    """The triangles without degenerate ones, by which strips continue at another place."""
    a, b, c = triangles.T
    return triangles[(a != b) & (b != c) & (c != a)].reshape(-1, 3)
