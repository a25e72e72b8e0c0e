"""Write point caches: all vertices of all frames in a binary file, beside an OBJ file with the rest mesh.

``.pc2`` (3ds Max, Blender, Houdini; Maya converts it) is little-endian: "POINTCACHE2", version 1, number of points, first
frame, frames per sample, number of samples, then float32 x y z. ``.mdd`` (LightWave, Blender, Cinema 4D) is big-endian: number
of frames, number of points, the time of every frame in seconds, then float32 x y z. Both have the coordinates of the OBJ file,
and one sample per frame.
"""

from __future__ import annotations

import os
import struct
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

import numpy as np

from ..files import replacing
from ..formats import UNITS
from ..formats.obj import write_obj
from .animation import AnimatedMesh

_PC2 = struct.Struct("<12siiffi")
_MAGIC = b"POINTCACHE2\0"


def samples(mesh: AnimatedMesh) -> Iterator[np.ndarray]:
    """Yield the vertices (V, 3) at every whole frame, mm, interpolated linearly.

    The inside parts come last. The head's median position is at the origin.
    """
    codes = mesh.codes
    for code in range(count_samples(mesh)):
        after = int(np.searchsorted(codes, code - 1e-9))
        if after >= len(codes) or abs(codes[after] - code) < 1e-9 or after == 0:
            yield mesh.whole_shape(min(after, len(codes) - 1)) - mesh.centre
            continue
        share = (code - codes[after - 1]) / (codes[after] - codes[after - 1])
        pair = mesh.whole_shape(after - 1), mesh.whole_shape(after)
        yield (1 - share) * pair[0] + share * pair[1] - mesh.centre


def count_samples(mesh: AnimatedMesh) -> int:
    """Number of whole frames from the first to the last."""
    return int(np.floor(mesh.codes[-1] + 1e-9)) + 1


def _points(mesh: AnimatedMesh) -> int:
    return len(mesh.neutral) + (0 if mesh.inside is None else len(mesh.inside.neutral))


def cache_bytes(mesh: AnimatedMesh) -> int:
    """Approximate size of the cache that :func:`write_point_cache` writes, bytes."""
    return 12 * count_samples(mesh) * _points(mesh)


def rest_mesh(path: str | os.PathLike) -> Path:
    """The OBJ file beside a cache."""
    return Path(path).with_suffix(".obj")


def write_point_cache(
    path: str | os.PathLike, mesh: AnimatedMesh, unit: str = "m", progress: Callable[..., Iterable] = lambda it, **_: it
) -> None:
    """Write a cache and :func:`rest_mesh` beside it, each whole or not at all.

    Parameters
    ----------
    path : path-like
        The file, whose suffix is ``.mdd`` or ``.pc2``.
    mesh : AnimatedMesh
        What to write.
    unit : str
        "m", "cm" or "mm".
    progress : callable
        Wraps the iteration over frames, as ``tqdm`` does.
    """
    path, count, points = Path(path), count_samples(mesh), _points(mesh)
    big = path.suffix.lower() == ".mdd"
    with replacing(path) as temporary, open(temporary, "wb") as stream:
        if big:
            stream.write(struct.pack(">ii", count, points))
            stream.write((np.arange(count) / mesh.fps).astype(">f4").tobytes())
        else:
            stream.write(_PC2.pack(_MAGIC, 1, points, 0.0, 1.0, count))
        for number, vertices in enumerate(progress(samples(mesh), total=count)):
            if number == 0:
                write_obj(rest_mesh(path), vertices, mesh.whole_triangles, mesh.whole_colours, unit)
            stream.write((vertices / UNITS[unit]).astype(">f4" if big else "<f4").tobytes())
