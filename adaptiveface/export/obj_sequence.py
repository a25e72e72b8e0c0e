"""Write OBJ files: a sequence with one file per frame, which every program reads."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np

from ..files import replacing, replacing_folder
from ..retargeting import UNITS
from .animation import AnimatedMesh, unit_normals

#: Importers of sequences need a common prefix. Earlier versions wrote none.
_FRAME = re.compile(r"(?:face_)?\d{5,}\.obj")


def obj_text(vertices: np.ndarray, triangles: np.ndarray, colours: np.ndarray | None = None, unit: str = "mm") -> str:
    """An OBJ file of vertices (V, 3) mm and triangles (T, 3), with smooth normals, in ``unit`` (:data:`UNITS`).

    Colours (V, 3) uint8 follow the coordinates, in the form that many programs read.
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
