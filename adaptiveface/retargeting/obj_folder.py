"""Characters from a folder of OBJ files: ``neutral.obj``, ``jawOpen.obj``, ... with ARKit names, any topology.

ICT-FaceKit's folder works as it is: ``generic_neutral_mesh.obj`` is its neutral, ``identity000.obj`` ... are left out.
"""

from __future__ import annotations

import io
import re
from pathlib import Path

import numpy as np

from ..errors import FileFormatError
from ..files import is_own
from ..importers.obj import read_lines
from .arkit import canonical_name
from .character import Character, make_character
from .shape_names import letters
from .units import size_note, to_head_frame

MAX_FILES = 1000
MAX_TOTAL_VALUES = 100_000_000
_NEUTRAL = ("neutral", "genericneutralmesh", "base", "basis", "rest", "default")
_IDENTITY = re.compile(r"identity\d+|random_identity\w*")


def read_obj(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (V, 3) as written and triangles (T, 3) int32 (polygons as fans) of an OBJ file.

    Raises :class:`FileFormatError` for files too large, non-finite vertices, indices out of range.
    """
    lines = _lines(path)
    vertices = _vertices(path, lines)
    corners: list[list[int]] = []
    for line in lines:
        if line.startswith("f "):
            try:
                polygon = [int(word.split("/", 1)[0]) for word in line.split()[1:]]
            except ValueError:
                raise FileFormatError(f"{path}: the face '{line[:60].strip()}' is not made of numbers") from None
            polygon = [i - 1 if i > 0 else len(vertices) + i for i in polygon]
            if len(polygon) < 3 or min(polygon) < 0 or max(polygon) >= len(vertices):
                raise FileFormatError(f"{path}: the face '{line[:60].strip()}' points outside 1..{len(vertices)}")
            corners += [[polygon[0], polygon[k], polygon[k + 1]] for k in range(1, len(polygon) - 1)]
    return vertices, np.array(corners, np.int32).reshape(-1, 3)


def _lines(path: Path) -> list[str]:
    return [line.decode(errors="replace") for line in read_lines(path)]


def _vertices(path: Path, lines: list[str]) -> np.ndarray:
    rows = [" ".join(line.split()[1:4]) for line in lines if line.startswith("v ")]
    try:
        vertices = np.loadtxt(io.StringIO("\n".join(rows)), ndmin=2) if rows else np.zeros((0, 3))
    except ValueError:
        raise FileFormatError(f"{path}: a vertex line does not hold three numbers") from None
    if len(vertices) == 0 or vertices.shape[1] != 3:
        raise FileFormatError(f"{path}: no vertices with three coordinates")
    if not np.isfinite(vertices).all() or np.abs(vertices).max() > 1e7:
        raise FileFormatError(f"{path}: vertices that are not finite, or absurdly far away")
    return vertices


def load_obj_folder(folder: str | Path, unit: float | None = None) -> Character:
    """The character in a folder of OBJ files; without ``unit`` (mm per unit) it is told from the size of the head.

    Raises :class:`FileFormatError`: no neutral, no shape, a shape with another number of vertices, bad values.
    """
    folder = Path(folder)
    paths = sorted(p for p in folder.iterdir() if p.suffix.lower() == ".obj" and is_own(p) and p.is_file())
    if len(paths) > MAX_FILES:
        raise FileFormatError(f"{folder}: {len(paths)} OBJ files; at most {MAX_FILES} are read")
    neutral_path = next((p for key in _NEUTRAL for p in paths if letters(p.stem) == key), None)
    if neutral_path is None:
        raise FileFormatError(f"{folder}: no neutral.obj (or generic_neutral_mesh.obj) among {len(paths)} OBJ files")
    neutral, triangles = read_obj(neutral_path)
    if len(triangles) == 0:
        raise FileFormatError(f"{neutral_path}: no faces")
    shape_paths = [p for p in paths if p != neutral_path and not _IDENTITY.fullmatch(p.stem)]
    if not any(canonical_name(p.stem) for p in shape_paths):
        raise FileFormatError(f"{folder}: none of the OBJ files has an ARKit name such as jawOpen.obj")
    if neutral.size * len(shape_paths) > MAX_TOTAL_VALUES:
        raise FileFormatError(f"{folder}: {len(shape_paths)} shapes of {len(neutral)} vertices are too many")
    shapes = []
    for path in shape_paths:
        vertices = _vertices(path, _lines(path))
        if len(vertices) != len(neutral):
            raise FileFormatError(f"{path}: {len(vertices)} vertices, the neutral has {len(neutral)}")
        shapes.append((path.stem, vertices - neutral))
    skipped = len(paths) - 1 - len(shape_paths)
    notes = [f"{skipped} identity shapes left out"] if skipped else []
    neutral, scale, note = to_head_frame(neutral, unit)
    scaled = [(name, scale * displacement) for name, displacement in shapes]
    notes += note + size_note(folder, float(np.ptp(neutral[:, 1])))
    return make_character(folder.name, neutral, triangles, scaled, notes=notes)
