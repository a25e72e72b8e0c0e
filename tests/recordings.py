"""Small recordings for tests: a head of the embedded model, rendered to depth, with its features in features.csv."""

from __future__ import annotations

import json
import struct
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
from scenes import coefficients, exact_actor, head_pose, posed_shape, render_frame

from adaptiveface.errors import FileFormatError
from adaptiveface.geometry.camera import Camera
from adaptiveface.geometry.mesh import transform_points
from adaptiveface.model.actor import Actor
from adaptiveface.sensors import RecordingWriter

#: A quarter of VGA: enough for a face at 0.6 m, and quick.
SMALL = Camera(320, 240, 262.5, 262.5, 159.5, 119.5)


def talking_head(folder: Path, frames: int = 8) -> Actor:
    """Write a recording of a slowly turning head that opens its jaw, without colour; returns the exact actor."""
    actor = exact_actor()
    with RecordingWriter(folder, SMALL, depth_scale=10_000) as writer:
        for k in range(frames):
            writer.write(render_frame(actor, _shape(actor, k, frames), _pose(k), k, noise=0.2, camera=SMALL))
    return actor


def true_mesh(actor: Actor, index: int, frames: int = 8) -> np.ndarray:
    """(N, 3) mm, camera frame: the mesh from which :func:`talking_head` rendered a frame."""
    return transform_points(_pose(index), _shape(actor, index, frames))


def _shape(actor: Actor, index: int, frames: int) -> np.ndarray:
    return posed_shape(actor, coefficients(actor, jawOpen=0.5 * index / frames))


def _pose(index: int) -> np.ndarray:
    return head_pose((0.0, 0.01 * index, 0.0))


def edit_intrinsics(folder: Path, **values) -> Path:
    """Change entries of intrinsic.json; NaN and infinity are written as JSON's extensions."""
    path = folder / "intrinsic.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | values))
    return path


def png_header(width: int, height: int) -> bytes:
    """The first bytes of a 16-bit grey PNG of any size, without its pixels."""
    chunk = b"IHDR" + struct.pack(">IIBBBBB", width, height, 16, 0, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + struct.pack(">I", 13) + chunk + struct.pack(">I", zlib.crc32(chunk))


def mutated(content: bytes, seed: int) -> bytes:
    """``content`` with bytes changed, dropped, inserted, or its end cut off; the same seed gives the same damage."""
    rng = np.random.default_rng(seed)
    data = bytearray(content)
    at = int(rng.integers(len(data)))
    match rng.integers(4):
        case 0:
            for _ in range(rng.integers(1, 12)):
                data[rng.integers(len(data))] = rng.integers(256)
        case 1:
            del data[at:]
        case 2:
            del data[at : at + int(rng.integers(1, 200))]
        case _:
            data[at:at] = rng.bytes(int(rng.integers(1, 100)))
    return bytes(data)


def refusals(path: Path, load: Callable[[Path], object], count: int) -> int:
    """How many of ``count`` damaged copies of a file are refused. Each refusal must name the file; no other error may come."""
    content, refused = path.read_bytes(), 0
    for seed in range(count):
        path.write_bytes(mutated(content, seed))
        try:
            load(path)
        except FileFormatError as error:
            assert str(path) in str(error)
            refused += 1
    return refused
