"""Wavefront OBJ files, as far as morphable models use them: vertex positions and polygons."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..errors import FileFormatError
from ..files import decoded, read_bytes

MAX_FILE_BYTES = 64 << 20


def read_lines(path: Path) -> list[bytes]:
    """The lines of an OBJ file; raises :class:`FileFormatError` when it is missing or absurdly large."""
    return decoded(read_bytes(path, MAX_FILE_BYTES), errors="replace").encode().splitlines()


def obj_vertices(lines: list[bytes], path: Path) -> np.ndarray:
    """(V, 3) positions."""
    words = [line.split() for line in lines if line.startswith(b"v ")]
    try:
        points = np.array([w[1:4] for w in words], dtype=np.float64)
    except ValueError as error:
        raise FileFormatError(f"{path}: a vertex line does not hold three numbers") from error
    if points.ndim != 2 or points.shape[1:] != (3,):
        raise FileFormatError(f"{path}: not an OBJ file with vertices")
    if not np.isfinite(points).all():
        first = int(np.flatnonzero(~np.isfinite(points).all(axis=1))[0])
        raise FileFormatError(f"{path}: vertex {first + 1} is not finite")
    return points


def obj_triangles(lines: list[bytes], path: Path, n_vertices: int) -> np.ndarray:
    """(T, 3) triangles; polygons are fanned from their first corner."""
    triangles = []
    try:
        for line in lines:
            if line.startswith(b"f "):
                corners = [int(word.split(b"/")[0]) - 1 for word in line.split()[1:]]
                triangles += [(corners[0], a, b) for a, b in zip(corners[1:], corners[2:], strict=False)]
    except ValueError as error:
        raise FileFormatError(f"{path}: a face line does not hold vertex numbers ({error})") from error
    out = np.array(triangles, int).reshape(-1, 3)
    if len(out) == 0 or out.min() < 0 or out.max() >= n_vertices:
        raise FileFormatError(f"{path}: its faces do not point at vertices 1..{n_vertices}")
    return out
