"""Characters from glTF 2.0 and VRM files: the neutral of the face as the file shows it, and what drives it."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from .character import Character
from .face_rig import FaceRig, face_rig
from .gltf_bones import find_bones
from .gltf_container import extensions
from .gltf_file import GltfFile
from .gltf_nodes import Nodes
from .gltf_pieces import Piece, read_pieces
from .units import LARGEST_HEAD, METRES, size_note


def load_gltf_character(path: str | Path, unit: float | None = None) -> Character:
    """Read the face of a .glb, .gltf or .vrm file.

    Meshes without morph targets are kept where they lie within the face (eyes, teeth, hair) and left out elsewhere (a
    body); notes say so. VRM 0.x looks along -z and is turned round.

    Parameters
    ----------
    path : path-like
        The file. Compressed meshes need the extra ``avatars``.
    unit : float, optional
        Millimetres per unit of length of the file; 1000 as glTF demands where it is not given.

    Raises
    ------
    FileFormatError
        With the file and the reason.
    MissingExtraError
        The meshes are compressed, and the library that opens them is not installed.
    """
    file = GltfFile(Path(path))
    with file.errors():
        rig = face_rig(file)
        return open_character(file, Nodes(file), rig, METRES if unit is None else unit)


def open_character(file: GltfFile, nodes: Nodes, rig: FaceRig, unit: float) -> Character:
    """The character in a file whose rig and nodes are known; raises as :func:`load_gltf_character` does."""
    file.compressed.check()
    pieces = read_pieces(file, nodes)
    if not any(piece.has_targets for piece in pieces):
        raise file.error("no mesh of its scene has morph targets; export it with its shape keys (blend shapes)")
    pieces, notes = _near_the_face(_heads(file, nodes, pieces, unit))
    turn = unit * np.array([-1.0, 1.0, -1.0] if looks_back(file) else [1.0, 1.0, 1.0])
    starts = np.cumsum([0] + [len(piece.vertices) for piece in pieces])
    file.spend(3 * int(starts[-1]) * len(rig.expressions), zeros=True)
    shapes = np.zeros((len(rig.expressions), starts[-1], 3))
    neutral = np.concatenate([piece.vertices for piece in pieces])
    for start, piece in zip(starts, pieces, strict=False):
        part = slice(start, start + len(piece.vertices))
        rest, driven = rest_weights(file, nodes, rig, piece.node), set(rig.driven_targets(piece.mesh))
        users = _users(rig, piece.mesh)
        for target, shape in piece.displacements(file):
            if target not in driven and rest[target]:
                neutral[part] += rest[target] * shape
            for expression, weight in users.get(target, ()):
                shapes[expression, part] += weight * shape
    triangles = np.concatenate([s + p.triangles for s, p in zip(starts, pieces, strict=False)]).astype(np.int32)
    colours = None
    if any(piece.colours is not None for piece in pieces):
        colours = np.concatenate([_colours(piece) for piece in pieces])
    neutral *= turn
    shapes *= turn
    notes += size_note(file.path, float(np.ptp(neutral[:, 1])))
    return Character(file.path.stem, neutral, triangles, tuple(e.name for e in rig.expressions), shapes, colours,
                     notes=(*rig.notes, *notes), mix=np.array([e.row for e in rig.expressions]))  # fmt: skip


def looks_back(file: GltfFile) -> bool:
    """Whether the face looks along -z, as VRM 0.x demands."""
    return "VRM" in extensions(file.document) and "VRMC_vrm" not in extensions(file.document)


def rest_weights(file: GltfFile, nodes: Nodes, rig: FaceRig, node: int) -> np.ndarray:
    """(T,) weights of the morph targets of a node's mesh at rest: the node's, else the mesh's, else zero (3.7.2.2)."""
    mesh = nodes.entries[node]["mesh"]
    count = rig.counts.get(mesh, 0)
    for place in (nodes.entries[node], file.item("meshes", mesh)):
        if place.get("weights"):
            weights = np.array(place["weights"], float)
            if weights.shape != (count,) or not (np.abs(weights) < 1e6).all():
                raise file.error(f"{weights.size} default weights for the {count} morph targets of mesh {mesh}")
            return weights
    return np.zeros(count)


def _users(rig: FaceRig, mesh: int) -> dict[int, list[tuple[int, float]]]:
    """Morph target of a mesh -> the expressions that move it, and by how much."""
    users: dict[int, list[tuple[int, float]]] = {}
    for number, expression in enumerate(rig.expressions):
        for (owner, target), weight in expression.binds.items():
            if owner == mesh:
                users.setdefault(target, []).append((number, weight))
    return users


def _heads(file: GltfFile, nodes: Nodes, pieces: list[Piece], unit: float) -> list[Piece]:
    """Where the mesh of the face holds a body too: of it only what the head's bone carries."""
    faces = np.concatenate([piece.vertices for piece in pieces if piece.has_targets])
    head = find_bones(file, nodes).get("head")
    if unit * np.ptp(faces[:, 1]) <= LARGEST_HEAD or head is None:
        return pieces
    below = nodes.below(head)
    parts = []
    for piece in pieces:
        if piece.joints is not None and piece.has_targets:
            carried = (piece.shares * np.isin(piece.joints, below)).sum(axis=1) > 0.5
            piece = piece.only(carried)
        if len(piece.triangles):
            parts.append(piece)
    return parts if any(piece.has_targets for piece in parts) else pieces


def _near_the_face(pieces: list[Piece]) -> tuple[list[Piece], list[str]]:
    """Pieces with morph targets, and the others whose middle lies in their surroundings."""
    face = np.concatenate([piece.vertices for piece in pieces if piece.has_targets])
    low, high = face.min(axis=0), face.max(axis=0)
    margin = 0.25 * (high - low)
    kept = []
    for piece in pieces:
        middle = (piece.vertices.min(axis=0) + piece.vertices.max(axis=0)) / 2
        if piece.has_targets or ((middle > low - margin) & (middle < high + margin)).all():
            kept.append(piece)
    left = len(pieces) - len(kept)
    return kept, [f"{left} meshes without morph targets left out of views of the head"] if left else []


def _colours(piece: Piece) -> np.ndarray:
    return np.full(piece.vertices.shape, 200, np.uint8) if piece.colours is None else piece.colours
