"""Read ICT-FaceKit (Li et al. 2020, "Learning Formation of Physically-Based Face Attributes"), a folder of OBJ files.

The folder holds ``generic_neutral_mesh.obj``, ``identity000.obj``, ..., and one file for each expression (``jawOpen.obj``,
``browDown_L.obj``). All have the same topology, in centimetres. Every file is the neutral with one mode at full strength.
"""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
from tqdm import tqdm

from ..errors import FileFormatError
from ..files import is_own
from ..formats.obj import read_obj, read_obj_vertices
from ..model.face_model import FaceModel
from .assemble import MAX_BYTES, ForeignModel, assemble, check_size

NEUTRAL = "generic_neutral_mesh.obj"
MM_PER_UNIT = 10.0
#: In the released topology of 26,719 vertices, the first 11,248 are face, head and neck, as the model's own table tells.
RELEASED_VERTICES, RELEASED_SKIN = 26_719, 11_248


def load_ict_facekit(folder: str | os.PathLike, feature_vertices=None, identity_modes: int = 100) -> FaceModel:
    """Read the folder ``FaceXModel`` of ICT-FaceKit. ``_L`` and ``_R`` in names become Left and Right.

    Parameters
    ----------
    folder : path-like
        The folder.
    feature_vertices : array-like or path-like, optional
        Vertex numbers of 40 or 68 features, or a text file of them, such as the Multi-PIE list of the model's documentation.
        By default, the features are found by fitting our own model.
    identity_modes : int
        Largest number of identity modes to read.

    Raises
    ------
    FileFormatError
        The message names the file and what is wrong.
    """
    folder = Path(folder)
    neutral = folder / NEUTRAL
    mean, triangles = read_obj(neutral)
    check_size(neutral, len(mean), len(triangles))
    identities = _numbered(folder)[:identity_modes]
    targets = sorted(p for p in folder.glob("*.obj") if is_own(p) and p.name != NEUTRAL and not p.stem.startswith("identity"))
    if not identities or not targets:
        raise FileFormatError(f"{folder}: identity000.obj or the OBJ files of the expressions are missing")
    count = len(identities) + len(targets)
    if count * mean.size * 4 > MAX_BYTES:
        raise FileFormatError(f"{folder}: {count} shapes of {len(mean)} vertices need more than {MAX_BYTES >> 20} MiB")
    shapes = np.stack([_offset(path, mean) for path in tqdm([*identities, *targets], desc="ICT-FaceKit", leave=False)])
    skin = np.arange(len(mean)) < RELEASED_SKIN if len(mean) == RELEASED_VERTICES else None
    foreign = ForeignModel(
        folder,
        MM_PER_UNIT * mean,
        triangles,
        shapes[: len(identities)],
        shapes[len(identities) :],
        tuple(arkit_name(path.stem) for path in targets),
        units=True,
        skin=skin,
    )
    return assemble(foreign, feature_vertices)


def _numbered(folder: Path) -> list[Path]:
    """The files identity000.obj, identity001.obj, ... up to the first gap."""
    found: list[Path] = []
    while (path := folder / f"identity{len(found):03d}.obj").is_file():
        found.append(path)
    return found


def _offset(path: Path, mean: np.ndarray) -> np.ndarray:
    points = read_obj_vertices(path)
    if points.shape != mean.shape:
        raise FileFormatError(f"{path}: {len(points)} vertices; {NEUTRAL} has {len(mean)}")
    return (MM_PER_UNIT * (points - mean)).astype(np.float32)


def arkit_name(name: str) -> str:
    """Spell out the side of a name, as in browDown_L -> browDownLeft."""
    for suffix, side in (("_L", "Left"), ("_R", "Right")):
        if name.endswith(suffix):
            return name[: -len(suffix)] + side
    return name
