"""Read characters from a folder of OBJ files with ARKit names: ``neutral.obj``, ``jawOpen.obj``, ... on any mesh.

ICT-FaceKit's folder works as it is. Its neutral is ``generic_neutral_mesh.obj``, and ``identity000.obj`` etc. are left out.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from ..errors import FileFormatError
from ..files import is_own
from ..formats.obj import read_obj, read_obj_vertices
from .arkit import canonical_name
from .character import Character, make_character
from .shape_names import letters
from .units import size_note, to_head_frame

MAX_FILES = 1000
MAX_TOTAL_VALUES = 100_000_000
_NEUTRAL = ("neutral", "genericneutralmesh", "base", "basis", "rest", "default")
_IDENTITY = re.compile(r"identity\d+|random_identity\w*")


def load_obj_folder(folder: str | Path, unit: float | None = None) -> Character:
    """Read the character in a folder of OBJ files.

    Parameters
    ----------
    folder : path-like
        The folder.
    unit : float, optional
        Millimetres per unit of length of the files. By default, the size of the head decides.

    Raises
    ------
    FileFormatError
        There is no neutral or no shape, or a shape has another number of vertices than the neutral, or a file is malformed.
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
        vertices = read_obj_vertices(path)
        if len(vertices) != len(neutral):
            raise FileFormatError(f"{path}: {len(vertices)} vertices, but the neutral has {len(neutral)}")
        shapes.append((path.stem, vertices - neutral))
    skipped = len(paths) - 1 - len(shape_paths)
    notes = [f"{skipped} identity shapes left out"] if skipped else []
    neutral, scale, note = to_head_frame(neutral, unit)
    scaled = [(name, scale * displacement) for name, displacement in shapes]
    notes += note + size_note(folder, float(np.ptp(neutral[:, 1])))
    return make_character(folder.name, neutral, triangles, scaled, notes=notes)
