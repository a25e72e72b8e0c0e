"""Wavefront OBJ files, as far as morphable models use them: vertex positions and polygons."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..errors import FileFormatError
from ..files import decoded, read_bytes

#: Largest number of vertices and of faces; a head of film quality has a tenth of it.
MAX_FILE_BYTES, MAX_LINES, MAX_ELEMENTS, MAX_LINE_BYTES = 96 << 20, 8_000_000, 1_000_000, 1 << 16


def read_lines(path: Path) -> list[bytes]:
    """The lines of an OBJ file that hold vertices and faces.

    Raises :class:`FileFormatError` if the file is missing, or holds more than a face model may. Lines are counted first.
    """
    content = read_bytes(path, MAX_FILE_BYTES)
    if not content[:1].isascii():  # a byte-order mark
        content = decoded(content, errors="replace").encode()
    for what, most, count in (
        ("lines", MAX_LINES, content.count(b"\n") + content.count(b"\r")),
        ("vertices", MAX_ELEMENTS, content.count(b"v ")),
        ("faces", MAX_ELEMENTS, content.count(b"f ")),
    ):
        if count > most:
            raise FileFormatError(f"{path}: {count} {what}; at most {most} are read")
    lines = [line for line in content.splitlines() if line.startswith((b"v ", b"f "))]
    if max(map(len, lines), default=0) > MAX_LINE_BYTES:
        raise FileFormatError(f"{path}: a line of more than {MAX_LINE_BYTES} bytes")
    return lines


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
