"""Write an animated mesh as a glTF 2.0 binary file (.glb), with animated weights of its morph targets and the head's motion.

Morph targets are sparse accessors, because most of a head does not move. They have normals, so that a morphed face is shaded
correctly. Lengths are metres; y points up, z towards the viewer (glTF 2.0, section 3.4).
"""

from __future__ import annotations

import os
from typing import Any

import numpy as np

from .. import __version__
from ..formats.gltf.build import ATTRIBUTE, INDICES, GltfBuilder, normalized
from ..formats.quaternions import quaternions
from ..formats.surface import linear_colours, normal_changes, unit_normals
from .animation import METRES, SKIN, AnimatedMesh

_QUANTIZED = "KHR_mesh_quantization"


class _Packing:
    """How numbers are stored: as float32 metres or, if ``compact``, as 16-bit shares of ``scale`` metres, and 8-bit normals."""

    def __init__(self, mesh: AnimatedMesh, compact: bool) -> None:
        self.compact = compact
        largest = max(max(np.abs(m.neutral).max(), np.abs(m.targets).max(initial=0.0)) for m in (mesh, mesh.inside) if m)
        self.scale = METRES * float(largest) if compact else 1.0

    def lengths(self, millimetres: np.ndarray) -> np.ndarray:
        """Lengths (V, 3) as they are stored."""
        metres = METRES * millimetres
        return np.rint(metres * (32767 / self.scale)).astype(np.int16) if self.compact else metres.astype(np.float32)

    def normals(self, values: np.ndarray) -> np.ndarray:
        """Unit vectors (V, 3), or differences of them, as they are stored."""
        return np.rint(127 * values.clip(-1, 1)).astype(np.int8) if self.compact else values

    def weights(self, values: np.ndarray) -> np.ndarray:
        """Weights (F, E) as they are stored. Those outside [0, 1] stay float32."""
        inside = self.compact and values.min(initial=0.0) >= 0 and values.max(initial=0.0) <= 1 + 1e-6
        return np.rint(65535 * values.clip(0, 1)).astype(np.uint16) if inside else values.astype(np.float32)


def write_glb(path: str | os.PathLike, mesh: AnimatedMesh, compact: bool = False) -> None:
    """Write an animated mesh as ``.glb``, whole or not at all.

    The node "performance" carries the node "head", which the head's pose animates. At rest, it has the pose of the first
    frame, so that viewers show the face in the middle. "performance" moves the median position of the head to the origin. The
    names of the targets are in ``mesh.extras.targetNames``. The inside parts are the node "insides" beside "head".

    Parameters
    ----------
    path : path-like
        The file to write.
    mesh : AnimatedMesh
        What to write.
    compact : bool
        Whether to use 16-bit coordinates and weights, and 8-bit normals (``KHR_mesh_quantization``), for less than half the
        size. A step is half of the head's extent / 32767, or 6 micrometres. Sums over many shapes are exact to 0.05 mm.
    """
    builder, packing = GltfBuilder(), _Packing(mesh, compact)
    document: dict[str, Any] = {
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
    builder.write(path, document)


def _add_inside(document: dict, builder: GltfBuilder, inside: AnimatedMesh, packing: _Packing) -> None:
    """Add a second mesh that moves with the head.

    It is not a child of the head, because three.js applies a node's weights to all nodes below it. Its channels come first,
    because earlier readers use the last ones for the head.
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
        output = builder.accessor(values, **normalized(values))
        times = animation["samplers"][0]["input"]
        animation["samplers"].append({"input": times, "output": output, "interpolation": "LINEAR"})
        channels.append({"sampler": len(animation["samplers"]) - 1, "target": {"node": 2, "path": "weights"}})
    animation["channels"] = channels + animation["channels"]


def _metres(vector: np.ndarray) -> list[float]:
    return [float(v) for v in METRES * np.asarray(vector, float)]


def _mesh(builder: GltfBuilder, mesh: AnimatedMesh, packing: _Packing, material: int = 0) -> dict:
    triangles = mesh.triangles.astype(np.uint16 if len(mesh.neutral) <= 65535 else np.uint32)
    normals = unit_normals(mesh.neutral, mesh.triangles)
    attributes = {
        "POSITION": builder.attribute(packing.lengths(mesh.neutral), bounds=True),
        "NORMAL": builder.attribute(packing.normals(normals)),
    }
    if mesh.colours is not None:
        linear = np.column_stack([linear_colours(mesh.colours), np.ones(len(mesh.colours))])
        colours = np.rint(65535 * linear).astype(np.uint16)
        attributes["COLOR_0"] = builder.accessor(colours, ATTRIBUTE, normalized=True)
    targets = []
    for target in mesh.targets:
        turned = normal_changes(mesh.neutral, target, mesh.triangles, normals)
        targets.append(
            {
                "POSITION": builder.sparse(packing.lengths(target), bounds=True),
                "NORMAL": builder.sparse(packing.normals(turned)),
            }
        )
    primitive = {"attributes": attributes, "indices": builder.accessor(triangles.ravel(), INDICES)}
    primitive["material"] = material
    entry: dict[str, Any] = {"name": mesh.name, "primitives": [primitive]}
    if targets:
        primitive["targets"] = targets
        entry |= {"weights": [0.0] * len(targets), "extras": {"targetNames": list(mesh.target_names)}}
    return entry


def _animation(builder: GltfBuilder, mesh: AnimatedMesh, packing: _Packing) -> dict:
    times = builder.accessor((mesh.codes / mesh.fps).astype(np.float32), bounds=True)
    position = (METRES * mesh.head_pose[:, :3, 3]).astype(np.float32)
    curves = {"translation": position, "rotation": quaternions(mesh.head_pose[:, :3, :3]).astype(np.float32)}
    if mesh.targets.size:
        curves["weights"] = np.ascontiguousarray(packing.weights(mesh.weights)).ravel()
    samplers = [
        {"input": times, "output": builder.accessor(values, **normalized(values)), "interpolation": "LINEAR"}
        for values in curves.values()
    ]
    channels = [{"sampler": k, "target": {"node": 1, "path": path}} for k, path in enumerate(curves)]
    return {"name": "performance", "samplers": samplers, "channels": channels}
