"""Read and write Wavefront OBJ files, as far as heads need them: vertex positions, polygons, normals and colours."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..errors import FileFormatError
from ..files import decoded, read_bytes, replacing
from . import UNITS
from .surface import unit_normals

MAX_FILE_BYTES, MAX_LINES, MAX_LINE_BYTES = 96 << 20, 8_000_000, 1 << 16
#: Largest number of vertices and of faces; a head of film quality has a tenth of it.
MAX_ELEMENTS = 1_000_000
#: Largest absolute coordinate.
MAX_COORDINATE = 1e7


def read_obj(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Read the mesh of an OBJ file.

    Parameters
    ----------
    path : path-like
        The file.

    Returns
    -------
    vertices : (V, 3)
        In the file's unit of length.
    triangles : (T, 3) int32
        Vertex numbers. Polygons are cut into fans around their first corner.

    Raises
    ------
    FileFormatError
        The file is missing or too large, or a line holds something else than finite coordinates or numbers of vertices.
    """
    lines = _lines(path)
    vertices = _vertices(path, lines)
    return vertices, _triangles(path, lines, len(vertices))


def read_obj_vertices(path: Path) -> np.ndarray:
    """(V, 3) vertices of an OBJ file, in its unit of length. Raises :class:`FileFormatError` as :func:`read_obj` does."""
    return _vertices(path, _lines(path))


def _lines(path: Path) -> list[bytes]:
    """The lines that hold vertices and faces. They are counted before they are split."""
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


def _vertices(path: Path, lines: list[bytes]) -> np.ndarray:
    words = [line.split()[1:4] for line in lines if line.startswith(b"v ")]
    try:
        points = np.array(words, dtype=np.float64)
    except ValueError:
        raise FileFormatError(f"{path}: a vertex line does not hold three numbers") from None
    if points.ndim != 2 or points.shape[1:] != (3,):
        raise FileFormatError(f"{path}: not an OBJ file with vertices of three coordinates")
    near = (np.abs(points) <= MAX_COORDINATE).all(axis=1)
    if not near.all():
        raise FileFormatError(f"{path}: vertex {int(near.argmin()) + 1} is not finite, or absurdly far away")
    return points


def _triangles(path: Path, lines: list[bytes], count: int) -> np.ndarray:
    triangles: list[tuple[int, int, int]] = []
    for line in lines:
        if not line.startswith(b"f "):
            continue
        shown = line[:60].decode(errors="replace").strip()
        try:
            polygon = [int(word.split(b"/", 1)[0]) for word in line.split()[1:]]
        except ValueError:
            raise FileFormatError(f"{path}: the face '{shown}' is not made of numbers") from None
        polygon = [i - 1 if i > 0 else count + i for i in polygon]  # negative numbers count from the last vertex
        if len(polygon) < 3 or min(polygon) < 0 or max(polygon) >= count:
            raise FileFormatError(f"{path}: the face '{shown}' points outside 1..{count}")
        triangles += [(polygon[0], a, b) for a, b in zip(polygon[1:], polygon[2:], strict=False)]
    return np.array(triangles, np.int32).reshape(-1, 3)


def obj_text(vertices: np.ndarray, triangles: np.ndarray, colours: np.ndarray | None = None, unit: str = "mm") -> str:
    """The text of an OBJ file with smooth normals.

    Parameters
    ----------
    vertices : (V, 3)
        In mm.
    triangles : (T, 3)
        Vertex numbers.
    colours : (V, 3) uint8, optional
        They follow the coordinates, in the form that many programs read.
    unit : str
        Unit of length of the file, a key of :data:`~adaptiveface.formats.UNITS`.
    """
    points, digits = vertices / UNITS[unit], {"mm": 4, "cm": 5, "m": 7}[unit]
    number = f"{{:.{digits}f}}"
    if colours is None:
        lines = [f"v {number} {number} {number}".format(*row) for row in points.tolist()]
    else:
        form = f"v {number} {number} {number} {{:.3f}} {{:.3f}} {{:.3f}}"
        lines = [form.format(*row) for row in np.hstack([points, colours / 255]).tolist()]
    normals = unit_normals(vertices, triangles)
    lines += ["vn {:.3f} {:.3f} {:.3f}".format(*row) for row in normals.tolist()]
    lines += [f"f {a}//{a} {b}//{b} {c}//{c}" for a, b, c in (triangles + 1).tolist()]
    return "\n".join([f"# adaptiveface: lengths in {unit}", "s 1", *lines]) + "\n"


def write_obj(
    path: str | Path, vertices: np.ndarray, triangles: np.ndarray, colours: np.ndarray | None = None, unit: str = "mm"
) -> None:
    """Write :func:`obj_text`, whole or not at all."""
    with replacing(path) as temporary:
        temporary.write_text(obj_text(vertices, triangles, colours, unit), encoding="ascii")
