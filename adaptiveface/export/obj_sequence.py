"""OBJ files: one per frame (a sequence that every program reads), or one per shape (a character's folder)."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from ..errors import FileFormatError
from ..files import replacing, replacing_folder
from ..retargeting.obj_folder import read_obj
from .animation import AnimatedMesh

_FRAME = re.compile(r"\d{5,}\.obj")


def write_obj(path: str | Path, vertices: np.ndarray, triangles: np.ndarray, colours: np.ndarray | None = None) -> None:
    """Vertices (V, 3) mm and triangles (T, 3); colours (V, 3) uint8 behind the coordinates, as many programs read."""
    if colours is None:
        lines = [f"v {x:.5f} {y:.5f} {z:.5f}" for x, y, z in vertices.tolist()]
    else:
        rows = np.hstack([vertices, colours / 255]).tolist()
        lines = ["v {:.5f} {:.5f} {:.5f} {:.3f} {:.3f} {:.3f}".format(*row) for row in rows]
    lines += [f"f {a} {b} {c}" for a, b, c in (triangles + 1).tolist()]
    with replacing(path) as temporary:
        temporary.write_text("\n".join(lines) + "\n", encoding="ascii")


def is_of_sequence(name: str) -> bool:
    """Whether a file of that name belongs to a folder of :func:`write_obj_sequence`."""
    return name == "timestamps.csv" or _FRAME.fullmatch(name.replace(".part", "")) is not None


def write_obj_sequence(folder: str | Path, mesh: AnimatedMesh) -> None:
    """``00000.obj``, ... in mm with the head's motion, the median position of the head at the origin, and
    ``timestamps.csv``. The whole folder appears at the end, and takes the place of one with an earlier take.

    Raises :class:`AdaptiveFaceError`: the folder holds other files, the disk is full.
    """
    centre = np.median(mesh.rigid[:, :3, 3], axis=0)
    with replacing_folder(folder, is_of_sequence) as new:
        for frame in range(len(mesh)):
            write_obj(new / f"{frame:05d}.obj", mesh.shape(frame, posed=True) - centre, mesh.triangles, mesh.colours)
        rows = [f"{frame},{time:.6f}" for frame, time in enumerate(mesh.timestamps)]
        (new / "timestamps.csv").write_text("\n".join(["frame,timestamp", *rows]) + "\n", encoding="ascii")


def read_obj_sequence(folder: str | Path) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (F, V, 3) mm and triangles (T, 3) of a folder of :func:`write_obj_sequence`.

    Raises :class:`FileFormatError` for a folder without frames or frames of different meshes.
    """
    paths = sorted(p for p in Path(folder).iterdir() if _FRAME.fullmatch(p.name))
    if not paths:
        raise FileFormatError(f"{folder}: no frames such as 00000.obj")
    frames, triangles = [], None
    for path in paths:
        vertices, corners = read_obj(path)
        if triangles is not None and (len(vertices) != len(frames[0]) or not np.array_equal(corners, triangles)):
            raise FileFormatError(f"{path}: another mesh than {paths[0].name}")
        frames.append(vertices)
        triangles = corners
    return np.stack(frames), triangles


def write_obj_shapes(folder: str | Path, mesh: AnimatedMesh) -> None:
    """``neutral.obj`` and one ``NAME.obj`` per morph target at weight 1: a folder that loads as a character.

    Raises :class:`AdaptiveFaceError` as :func:`write_obj_sequence` does.
    """
    with replacing_folder(folder, lambda name: name.endswith(".obj")) as new:
        write_obj(new / "neutral.obj", mesh.neutral, mesh.triangles, mesh.colours)
        for name, target in zip(mesh.target_names, mesh.targets, strict=True):
            write_obj(new / f"{name}.obj", mesh.neutral + target, mesh.triangles, mesh.colours)
