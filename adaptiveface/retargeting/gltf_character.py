"""Characters from glTF 2.0 and VRM files with morph targets named in the ARKit convention.

Names come from ``mesh.extras.targetNames`` (or the primitive's, as UniVRM writes), and from VRM's own expressions. A
skeleton is ignored: the mesh is taken in its bind pose.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from .arkit import canonical_name
from .character import Character, make_character
from .gltf_file import GltfFile

MAX_TARGETS = 2000
_METRES_TO_MM = 1000.0


@dataclass
class _Piece:
    """One triangle primitive in the scene: mm, its morph targets by name."""

    mesh: int
    vertices: np.ndarray
    triangles: np.ndarray
    shapes: list[np.ndarray]
    names: list[str]
    colours: np.ndarray | None


def load_gltf_character(path: str | Path) -> Character:
    """Read the face of a .glb, .gltf or .vrm file; raises :class:`FileFormatError` with the file and the reason.

    Meshes without morph targets are kept where they lie within the face (eyes, teeth, hair) and left out elsewhere (a
    body); notes say so. The unit is metres, as glTF demands; VRM 0.x looks along -z and is turned round.
    """
    file = GltfFile(Path(path))
    with file.errors():
        pieces = _pieces(file)
        if not any(piece.shapes for piece in pieces):
            raise file.error("no mesh has morph targets; export it with its shape keys (blend shapes)")
        if "VRM" in file.document.get("extensions", {}):
            for piece in pieces:
                piece.vertices *= [-1.0, 1.0, -1.0]
                piece.shapes = [shape * [-1.0, 1.0, -1.0] for shape in piece.shapes]
        pieces, notes = _near_the_face(pieces)
        shapes = _merged(file, pieces)
        if not any(canonical_name(name) for name, _ in shapes):
            some = ", ".join(name for name, _ in shapes[:8])[:200]
            raise file.error(f"no morph target has an ARKit name such as jawOpen (targets: {some or 'none'})")
        starts = np.cumsum([0] + [len(piece.vertices) for piece in pieces])
        vertices = np.concatenate([piece.vertices for piece in pieces])
        triangles = np.concatenate([s + p.triangles for s, p in zip(starts, pieces, strict=False)]).astype(np.int32)
        colours = None
        if any(piece.colours is not None for piece in pieces):
            colours = np.concatenate([_colours(piece) for piece in pieces])
        return make_character(Path(path).stem, vertices, triangles, shapes, colours=colours, notes=notes)


def _pieces(file: GltfFile) -> list[_Piece]:
    pieces, budget = [], 0
    for number, world in file.world_transforms().items():
        node = file.item("nodes", number)
        if "mesh" not in node:
            continue
        transform = np.eye(4) if "skin" in node else world  # a skin's joints place its mesh, not the node (3.7.3.3)
        mesh = file.item("meshes", node["mesh"])
        for primitive in mesh["primitives"]:
            if primitive.get("mode", 4) != 4:
                continue
            budget += 1
            if budget > 2000:
                raise file.error("more than 2000 primitives")
            pieces.append(_piece(file, node["mesh"], mesh, primitive, transform))
    if not pieces:
        raise file.error("no node shows a mesh of triangles")
    return pieces


def _piece(file: GltfFile, number: int, mesh: dict, primitive: dict, transform: np.ndarray) -> _Piece:
    vertices = file.accessor(primitive["attributes"]["POSITION"]).astype(float)
    if vertices.shape[1] != 3:
        raise file.error("POSITION does not hold three coordinates")
    targets = primitive.get("targets", [])
    if len(targets) > MAX_TARGETS:
        raise file.error(f"{len(targets)} morph targets; at most {MAX_TARGETS} are read")
    shapes = []
    for target in targets:
        if "POSITION" in target:
            shape = file.accessor(target["POSITION"], len(vertices)).astype(float)
            if shape.shape != vertices.shape:
                raise file.error("a morph target does not hold three coordinates")
        else:
            file.spend(vertices.size, zeros=True)
            shape = np.zeros_like(vertices)
        shapes.append(_METRES_TO_MM * shape @ transform[:3, :3].T)
    names = mesh.get("extras", {}).get("targetNames") or primitive.get("extras", {}).get("targetNames") or []
    if not isinstance(names, list) or not all(isinstance(name, str) and len(name) <= 256 for name in names):
        raise file.error("extras.targetNames is not a list of short names")
    if names and len(names) != len(shapes):
        raise file.error(f"{len(names)} target names for {len(shapes)} morph targets")
    names = names or [f"target{k}" for k in range(len(shapes))]
    colours = None
    if "COLOR_0" in primitive["attributes"]:
        colours = _srgb(file.accessor(primitive["attributes"]["COLOR_0"], len(vertices))[:, :3])
    placed = _METRES_TO_MM * (vertices @ transform[:3, :3].T + transform[:3, 3])
    if not np.isfinite(placed).all() or np.abs(placed).max() > 1e7:
        raise file.error("vertices that are absurdly far away")
    triangles = file.triangles(primitive, len(vertices))
    if np.linalg.det(transform[:3, :3]) < 0:  # a mirrored node turns triangles inside out
        triangles = triangles[:, ::-1]
    return _Piece(number, placed, triangles, shapes, names, colours)


def _srgb(linear: np.ndarray) -> np.ndarray:
    linear = np.clip(linear.astype(float), 0, 1)
    return np.rint(255 * np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)).astype(
        np.uint8
    )


def _colours(piece: _Piece) -> np.ndarray:
    return np.full(piece.vertices.shape, 200, np.uint8) if piece.colours is None else piece.colours


def _near_the_face(pieces: list[_Piece]) -> tuple[list[_Piece], list[str]]:
    """Pieces with morph targets, and the others whose middle lies in their surroundings."""
    face = np.concatenate([piece.vertices for piece in pieces if piece.shapes])
    low, high = face.min(axis=0), face.max(axis=0)
    margin = 0.25 * (high - low)
    kept = []
    for piece in pieces:
        middle = (piece.vertices.min(axis=0) + piece.vertices.max(axis=0)) / 2
        if piece.shapes or ((middle > low - margin) & (middle < high + margin)).all():
            kept.append(piece)
    left = len(pieces) - len(kept)
    return kept, [f"{left} meshes without morph targets left out"] if left else []


def _merged(file: GltfFile, pieces: list[_Piece]) -> list[tuple[str, np.ndarray]]:
    """Shapes of all pieces under one name each, over all vertices; VRM's expressions take part under their names."""
    starts = np.cumsum([0] + [len(piece.vertices) for piece in pieces])
    order: dict[str, np.ndarray] = {}

    def add(name: str, piece: int, shape: np.ndarray, weight: float = 1.0) -> None:
        """Add a piece's share to the shape of that name."""
        if name not in order:
            file.spend(3 * int(starts[-1]), zeros=True)
            order[name] = np.zeros((starts[-1], 3))
        order[name][starts[piece] : starts[piece + 1]] += weight * shape

    for number, piece in enumerate(pieces):
        for name, shape in zip(piece.names, piece.shapes, strict=True):
            add(name, number, shape)
    known = {canonical_name(name) for name in order}
    for name, binds in _vrm_expressions(file):
        if canonical_name(name) is None or canonical_name(name) in known:
            continue
        for mesh, index, weight in binds:
            for number, piece in enumerate(pieces):
                if piece.mesh == mesh and 0 <= index < len(piece.shapes):
                    add(name, number, piece.shapes[index], weight)
    return list(order.items())


def _vrm_expressions(file: GltfFile) -> list[tuple[str, list[tuple[int, int, float]]]]:
    """VRM 0.x and 1.0 expressions: name, binds of (mesh, target, weight)."""
    extensions = file.document.get("extensions", {})
    found = []
    groups = extensions.get("VRM", {}).get("blendShapeMaster", {}).get("blendShapeGroups", [])
    for group in groups[:1000]:
        binds = [(b["mesh"], int(b["index"]), float(b["weight"]) / 100) for b in (group.get("binds") or [])]
        found.append((str(group.get("name", "")), binds))
    for entry in extensions.get("VRMC_vrm", {}).get("expressions", {}).values():
        for name, expression in list(entry.items())[:1000]:
            binds = [(file.item("nodes", b["node"]).get("mesh"), int(b["index"]), float(b["weight"]))
                     for b in expression.get("morphTargetBinds", [])]  # fmt: skip
            found.append((name, binds))
    return [(name, [b for b in binds if np.isfinite(b[2]) and abs(b[2]) <= 10]) for name, binds in found]
