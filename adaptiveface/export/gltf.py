"""glTF 2.0 binary files (.glb): mesh, morph targets, weights animation, head motion as node animation.

This is a writer of our own because libraries leave out what is needed: trimesh writes no morph targets or animations,
and pygltflib only wraps the JSON objects. Morph targets are sparse accessors (most of a head is still), with
normals, so that a morphed face shades as it should. Lengths in metres, y up, z towards the viewer (glTF 2.0, 3.4).
"""

from __future__ import annotations

import json
import os
import struct

import numpy as np

from .. import __version__
from ..errors import FileFormatError
from ..files import replacing
from .animation import METRES, SKIN, AnimatedMesh, linear_colours, unit_normals

_ARRAY, _ELEMENTS = 34962, 34963
_COMPONENT = {
    np.dtype(np.int8): 5120,
    np.dtype(np.int16): 5122,
    np.dtype(np.uint16): 5123,
    np.dtype(np.uint32): 5125,
    np.dtype(np.float32): 5126,
}
_QUANTIZED = "KHR_mesh_quantization"
#: A vertex whose target moves it less than this is left out of the sparse accessor, m (float32 rounds more).
_STILL = 1e-8


class _Builder:
    """Collects accessors and their bytes."""

    def __init__(self) -> None:
        self.views: list[dict] = []
        self.accessors: list[dict] = []
        self.binary = bytearray()

    def view(self, array: np.ndarray, target: int | None = None) -> int:
        self.binary += b"\0" * (-len(self.binary) % 4)
        view = {"buffer": 0, "byteOffset": len(self.binary)}
        if target == _ARRAY and array[0].nbytes % 4:  # attributes start at multiples of four bytes
            padding = -array[0].nbytes % 4 // array.itemsize
            array = np.pad(array, ((0, 0), (0, padding)))
            view["byteStride"] = array[0].nbytes
        view["byteLength"] = array.nbytes
        if target:
            view["target"] = target
        self.binary += np.ascontiguousarray(array).tobytes()
        self.views.append(view)
        return len(self.views) - 1

    def accessor(self, array: np.ndarray, target: int | None = None, bounds: bool = False, **more) -> int:
        kind = "SCALAR" if array.ndim == 1 else f"VEC{array.shape[1]}"
        entry = {"bufferView": self.view(array, target), "componentType": _COMPONENT[array.dtype], "count": len(array)}
        self._add(entry | {"type": kind} | more, array if bounds else None)
        return len(self.accessors) - 1

    def attribute(self, array: np.ndarray, bounds: bool = False) -> int:
        """(V, 3) float32, or integers that stand for -1 to 1."""
        return self.accessor(array, _ARRAY, bounds, **_normalized(array))

    def sparse(self, array: np.ndarray, bounds: bool = False) -> int:
        """As :meth:`attribute`, mostly zero."""
        moving = np.flatnonzero(np.abs(array).max(axis=1) > _STILL)
        if len(moving) > 0.8 * len(array):
            return self.attribute(array, bounds)
        entry = {"componentType": _COMPONENT[array.dtype], "count": len(array), "type": "VEC3"} | _normalized(array)
        kept = np.zeros_like(array)
        if len(moving):
            kept[moving] = array[moving]
            index = moving.astype(np.uint16 if len(array) <= 65535 else np.uint32)
            entry["sparse"] = {
                "count": len(moving),
                "indices": {"bufferView": self.view(index), "componentType": _COMPONENT[index.dtype]},
                "values": {"bufferView": self.view(array[moving])},
            }
        else:  # some readers take an accessor without any data for a mistake
            entry["bufferView"] = self.view(kept, _ARRAY)
        self._add(entry, kept if bounds else None)
        return len(self.accessors) - 1

    def _add(self, entry: dict, bounded: np.ndarray | None) -> None:
        if bounded is not None:
            low, high = np.atleast_1d(bounded.min(axis=0)), np.atleast_1d(bounded.max(axis=0))
            entry |= {"min": low.tolist(), "max": high.tolist()}
        self.accessors.append(entry)


def _normalized(array: np.ndarray) -> dict:
    return {} if array.dtype.kind == "f" else {"normalized": True}


class _Packing:
    """How coordinates are stored: float32 metres, or, ``compact``, 16 bits of ``scale`` metres and 8 bits of normals."""

    def __init__(self, mesh: AnimatedMesh, compact: bool) -> None:
        self.compact = compact
        largest = max(max(np.abs(m.neutral).max(), np.abs(m.targets).max(initial=0.0)) for m in (mesh, mesh.inside) if m)
        self.scale = METRES * float(largest) if compact else 1.0

    def lengths(self, millimetres: np.ndarray) -> np.ndarray:
        """(V, 3) as stored."""
        metres = METRES * millimetres
        return np.rint(metres * (32767 / self.scale)).astype(np.int16) if self.compact else metres.astype(np.float32)

    def normals(self, values: np.ndarray) -> np.ndarray:
        """(V, 3) unit vectors or differences of them as stored."""
        return np.rint(127 * values.clip(-1, 1)).astype(np.int8) if self.compact else values

    def weights(self, values: np.ndarray) -> np.ndarray:
        """(F, E) in [0, 1] as stored; others stay float32."""
        inside = self.compact and values.min(initial=0.0) >= 0 and values.max(initial=0.0) <= 1 + 1e-6
        return np.rint(65535 * values.clip(0, 1)).astype(np.uint16) if inside else values.astype(np.float32)


def write_glb(path: str | os.PathLike, mesh: AnimatedMesh, compact: bool = False) -> None:
    """Write an animated mesh as ``.glb``, whole or not at all.

    ``compact``: 16-bit coordinates and weights, 8-bit normals (``KHR_mesh_quantization``), under half the size. A step is
    the head's half extent / 32767, 6 micrometres; sums over many shapes come out within 0.05 mm.

    Node "performance" carries node "head", which is animated by the head's pose and rests in that of the first frame, so
    that viewers frame the face; "performance" is placed so that the median position of the head is the origin. Target
    names are in ``mesh.extras.targetNames``. Inside parts are the node "insides" beside "head".
    """
    builder, packing = _Builder(), _Packing(mesh, compact)
    document = {
        "asset": {"version": "2.0", "generator": f"adaptiveface {__version__}"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [
            {"name": "performance", "children": [1], "translation": _metres(-mesh.centre)},
            {
                "name": "head",
                "mesh": 0,
                "translation": _metres(mesh.head_pose[0, :3, 3]),
                "rotation": quaternions(mesh.head_pose[:1, :3, :3])[0].tolist(),
            },  # at rest it is where the first frame is
        ],
        "meshes": [_mesh(builder, mesh, packing)],
        "materials": [
            {"name": "skin", "doubleSided": True, "pbrMetallicRoughness": {"metallicFactor": 0.0, "roughnessFactor": 0.6}}
        ],
        "animations": [_animation(builder, mesh, packing)],
    }
    if compact:
        document["nodes"][1]["scale"] = 3 * [packing.scale]
        document |= {"extensionsUsed": [_QUANTIZED], "extensionsRequired": [_QUANTIZED]}
    if mesh.inside is not None:
        _add_inside(document, builder, mesh.inside, packing)
    if mesh.colours is None:
        document["materials"][0]["pbrMetallicRoughness"]["baseColorFactor"] = [*map(float, linear_colours(SKIN)), 1.0]
    document |= {"accessors": builder.accessors, "bufferViews": builder.views, "buffers": [{"byteLength": len(builder.binary)}]}
    _write(path, document, builder.binary)


def _add_inside(document: dict, builder: _Builder, inside: AnimatedMesh, packing: _Packing) -> None:
    """A second mesh that moves as the head does.

    It is not a child of the head, because three.js applies a node's weights to all nodes below it. Its channels come first,
    because earlier readers took the last ones for those of the head.
    """
    nodes, animation = document["nodes"], document["animations"][0]
    nodes[0]["children"].append(2)
    nodes.append(nodes[1] | {"name": "insides", "mesh": 1})
    document["meshes"].append(_mesh(builder, inside, packing, material=1))
    surface = {"metallicFactor": 0.0, "roughnessFactor": 0.3}
    document["materials"].append({"name": "insides", "doubleSided": True, "pbrMetallicRoughness": surface})
    moves = [c for c in animation["channels"] if c["target"]["path"] != "weights"]
    channels = [c | {"target": c["target"] | {"node": 2}} for c in moves]
    if inside.targets.size:
        values = np.ascontiguousarray(packing.weights(inside.weights)).ravel()
        output = builder.accessor(values, **_normalized(values))
        times = animation["samplers"][0]["input"]
        animation["samplers"].append({"input": times, "output": output, "interpolation": "LINEAR"})
        channels.append({"sampler": len(animation["samplers"]) - 1, "target": {"node": 2, "path": "weights"}})
    animation["channels"] = channels + animation["channels"]


def _metres(vector: np.ndarray) -> list[float]:
    return [float(v) for v in METRES * np.asarray(vector, float)]


def _mesh(builder: _Builder, mesh: AnimatedMesh, packing: _Packing, material: int = 0) -> dict:
    triangles = mesh.triangles.astype(np.uint16 if len(mesh.neutral) <= 65535 else np.uint32)
    normals = unit_normals(mesh.neutral, mesh.triangles)
    attributes = {
        "POSITION": builder.attribute(packing.lengths(mesh.neutral), bounds=True),
        "NORMAL": builder.attribute(packing.normals(normals)),
    }
    if mesh.colours is not None:
        linear = np.column_stack([linear_colours(mesh.colours), np.ones(len(mesh.colours))])
        colours = np.rint(65535 * linear).astype(np.uint16)
        attributes["COLOR_0"] = builder.accessor(colours, _ARRAY, normalized=True)
    targets = []
    for target in mesh.targets:
        turned = unit_normals(mesh.neutral + target, mesh.triangles) - normals
        turned[np.abs(turned).max(axis=1) < 1e-4] = 0.0
        targets.append(
            {
                "POSITION": builder.sparse(packing.lengths(target), bounds=True),
                "NORMAL": builder.sparse(packing.normals(turned)),
            }
        )
    primitive = {"attributes": attributes, "indices": builder.accessor(triangles.ravel(), _ELEMENTS)}
    primitive["material"] = material
    entry = {"name": mesh.name, "primitives": [primitive]}
    if targets:
        primitive["targets"] = targets
        entry |= {"weights": [0.0] * len(targets), "extras": {"targetNames": list(mesh.target_names)}}
    return entry


def _animation(builder: _Builder, mesh: AnimatedMesh, packing: _Packing) -> dict:
    times = builder.accessor((mesh.codes / mesh.fps).astype(np.float32), bounds=True)
    position = (METRES * mesh.head_pose[:, :3, 3]).astype(np.float32)
    curves = {"translation": position, "rotation": quaternions(mesh.head_pose[:, :3, :3]).astype(np.float32)}
    if mesh.targets.size:
        curves["weights"] = np.ascontiguousarray(packing.weights(mesh.weights)).ravel()
    samplers = [
        {"input": times, "output": builder.accessor(values, **_normalized(values)), "interpolation": "LINEAR"}
        for values in curves.values()
    ]
    channels = [{"sampler": k, "target": {"node": 1, "path": path}} for k, path in enumerate(curves)]
    return {"name": "performance", "samplers": samplers, "channels": channels}


def quaternions(rotations: np.ndarray) -> np.ndarray:
    """(F, 4) unit quaternions x, y, z, w of rotations (F, 3, 3), neighbours in one hemisphere."""
    from scipy.spatial.transform import Rotation

    out = Rotation.from_matrix(rotations).as_quat()
    flips = np.cumprod(np.where((out[1:] * out[:-1]).sum(axis=1) < 0, -1.0, 1.0))
    out[1:] *= flips[:, None]
    return out


def _write(path: str | os.PathLike, document: dict, binary: bytearray) -> None:
    text = json.dumps(document, separators=(",", ":"), allow_nan=False).encode()
    text += b" " * (-len(text) % 4)
    binary += b"\0" * (-len(binary) % 4)
    total = 12 + 8 + len(text) + 8 + len(binary)
    if total >= 1 << 32:
        raise FileFormatError(f"{path}: {total >> 20} MiB do not fit into a .glb file; export fewer frames")
    with replacing(path) as temporary, open(temporary, "wb") as stream:
        stream.write(struct.pack("<4sII", b"glTF", 2, total))
        stream.write(struct.pack("<I4s", len(text), b"JSON") + text)
        stream.write(struct.pack("<I4s", len(binary), b"BIN\0") + binary)
