"""Write OBJ files: a sequence with one file per frame, which every program reads."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from pathlib import Path

from ..files import replacing_folder
from ..formats.obj import obj_text, write_obj
from .animation import AnimatedMesh

#: Importers of sequences need a common prefix. Earlier versions wrote none.
_FRAME = re.compile(r"(?:face_)?\d{5,}\.obj")


def is_of_sequence(name: str) -> bool:
    """Whether a file of that name belongs to a folder of :func:`write_obj_sequence`."""
    return name == "timestamps.csv" or _FRAME.fullmatch(name.replace(".part", "")) is not None


def sequence_bytes(mesh: AnimatedMesh, unit: str = "m") -> int:
    """About how many bytes :func:`write_obj_sequence` writes."""
    return len(mesh) * len(obj_text(mesh.whole_shape(0) - mesh.centre, mesh.whole_triangles, mesh.whole_colours, unit))


def write_obj_sequence(
    folder: str | Path, mesh: AnimatedMesh, unit: str = "m", progress: Callable[[Iterable], Iterable] = iter
) -> None:
    """Write ``face_00000.obj``, ... with the head's motion, and ``timestamps.csv``.

    The median position of the head is at the origin. The folder appears complete at the end, and replaces one with an earlier
    take. ``unit`` is "m" (Blender, Houdini), "cm" (Maya) or "mm". Raises :class:`AdaptiveFaceError` if the folder holds other
    files, or if the disk is full.
    """
    with replacing_folder(folder, is_of_sequence) as new:
        for frame in progress(range(len(mesh))):
            vertices = mesh.whole_shape(frame) - mesh.centre
            write_obj(new / f"face_{frame:05d}.obj", vertices, mesh.whole_triangles, mesh.whole_colours, unit)
        rows = [f"{frame},{time:.6f}" for frame, time in enumerate(mesh.timestamps)]
        (new / "timestamps.csv").write_text("\n".join(["frame,timestamp", *rows]) + "\n", encoding="ascii")
