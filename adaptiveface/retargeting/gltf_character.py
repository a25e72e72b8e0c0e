"""Read characters from glTF 2.0 and VRM files: the neutral face as the file shows it, and what drives it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ..formats import UNITS
from ..formats.gltf.bones import find_bones
from ..formats.gltf.container import looks_back
from ..formats.gltf.file import GltfFile
from ..formats.gltf.nodes import Nodes
from ..formats.gltf.pieces import Piece, read_pieces
from .arkit import ARKIT_NAMES
from .character import Character
from .face_rig import Expression, FaceRig, face_rig
from .units import LARGEST_HEAD, size_note

_GAZE = np.array([name.startswith("eyeLook") for name in ARKIT_NAMES])


def load_gltf_character(path: str | Path, unit: float | None = None) -> Character:
    """Read the face of a .glb, .gltf or .vrm file.

    Meshes without morph targets are kept if they lie within the face (eyes, teeth, hair). Others, such as a body, are left out,
    and notes tell that. Characters of VRM 0.x look along -z, and are turned round.

    Parameters
    ----------
    path : path-like
        The file. Compressed meshes need the extra ``avatars``.
    unit : float, optional
        Millimetres per unit of length of the file, by default 1000, as glTF demands.

    Raises
    ------
    FileFormatError
        The message names the file and the reason.
    MissingExtraError
        The meshes are compressed, and the library that opens them is not installed.
    """
    file = GltfFile(Path(path))
    with file.errors():
        rig = face_rig(file)
        face = open_face(file, Nodes(file), rig, UNITS["m"] if unit is None else unit)
        return replace(face.character, notes=face.character.notes + face.left_out)


@dataclass
class OpenFace:
    """A character, and what its meshes tell about the nodes that carry it.

    Attributes
    ----------
    character : Character
        The face.
    left_out : tuple of str
        What the character does not show of the file, one line each.
    nodes : set of int
        Nodes whose meshes belong to the head.
    alone : bool
        Whether the scene shows nothing but the head.
    middle : (3,)
        Middle of the head, in the file's unit.
    eyes : set of int
        Nodes that hold vertices which the gaze moves.
    carrier : int or None
        The joint that holds most of the moving face. None without a skin.
    """

    character: Character
    left_out: tuple[str, ...]
    nodes: set[int]
    alone: bool
    middle: np.ndarray
    eyes: set[int]
    carrier: int | None


def open_face(file: GltfFile, nodes: Nodes, rig: FaceRig, unit: float) -> OpenFace:
    """Open the meshes of a file whose rig and nodes are known. Raises what :func:`load_gltf_character` raises.

    ``unit`` is the number of millimetres per unit of the file.
    """
    file.compressed.check()
    pieces = read_pieces(file, nodes)
    if not any(piece.has_targets for piece in pieces):
        raise file.error("no mesh of its scene has morph targets; export it with its shape keys (blend shapes)")
    everything = {piece.node for piece in pieces}
    pieces, notes = _near_the_face(_heads(file, nodes, pieces, unit))
    starts = np.cumsum([0] + [len(piece.vertices) for piece in pieces])
    neutral, shapes, holders = _shapes(file, nodes, rig, pieces, starts)
    triangles = np.concatenate([s + p.triangles for s, p in zip(starts, pieces, strict=False)]).astype(np.int32)
    colours = None
    if any(piece.colours is not None for piece in pieces):
        colours = np.concatenate([_colours(piece) for piece in pieces])
    middle = (neutral.min(axis=0) + neutral.max(axis=0)) / 2
    turn = unit * np.array([-1.0, 1.0, -1.0] if looks_back(file) else [1.0, 1.0, 1.0])
    neutral *= turn
    shapes *= turn
    character = Character(
        file.path.stem,
        neutral,
        triangles,
        tuple(e.name for e in rig.expressions),
        shapes,
        colours,
        notes=(*rig.notes, *size_note(file.path, float(np.ptp(neutral[:, 1])))),
        mix=np.array([e.row for e in rig.expressions]),
        parts=rig.parts,
    )
    head = {piece.node for piece in pieces}
    return OpenFace(character, tuple(notes), head, head == everything, middle, holders.eyes, holders.carrier())


def _shapes(
    file: GltfFile, nodes: Nodes, rig: FaceRig, pieces: list[Piece], starts: np.ndarray
) -> tuple[np.ndarray, np.ndarray, _Holders]:
    """The neutral (V, 3) of all pieces, the displacements (E, V, 3) of the rig's expressions, and the joints that hold them.

    ``starts`` (P + 1,) are the numbers of the pieces' first vertices. Undriven morph targets keep their weights at rest.
    """
    file.spend(3 * int(starts[-1]) * len(rig.expressions), zeros=True)
    shapes = np.zeros((len(rig.expressions), starts[-1], 3))
    neutral = np.concatenate([piece.vertices for piece in pieces])
    holders = _Holders()
    for start, piece in zip(starts, pieces, strict=False):
        part = slice(start, start + len(piece.vertices))
        rest, driven = rest_weights(file, nodes, rig, piece.node), set(rig.driven_targets(piece.mesh))
        users = _users(rig, piece.mesh)
        for target, shape in piece.displacements(file):
            if target not in driven and rest[target]:
                neutral[part] += rest[target] * shape
            for expression, weight in users.get(target, ()):
                shapes[expression, part] += weight * shape
                holders.count(piece, shape, rig.expressions[expression])
    return neutral, shapes, holders


class _Holders:
    """Counts which joints hold the vertices that move in the face, and which hold those that the gaze moves."""

    def __init__(self) -> None:
        self.eyes: set[int] = set()
        self._held: dict[int, float] = {}

    def count(self, piece: Piece, shape: np.ndarray, expression: Expression) -> None:
        """Count the vertices that an expression moves by ``shape`` (V, 3)."""
        held = piece.held
        if held is None or not expression.driven:
            return
        length = np.linalg.norm(shape, axis=1)
        moving = length > 0.05 * max(length.max(initial=0.0), 1e-9)
        for joints, shares in zip(held.joints[moving].T, held.shares[moving].T, strict=True):
            for joint in np.unique(joints[shares > 0]):
                self._held[joint] = self._held.get(joint, 0.0) + float(shares[joints == joint].sum())
        if expression.row[_GAZE].any():
            strongest = held.joints[moving, held.shares[moving].argmax(axis=1)]
            self.eyes |= set(np.unique(strongest).tolist())

    def carrier(self) -> int | None:
        """The joint that holds most of them, or None."""
        return int(max(self._held, key=self._held.__getitem__)) if self._held else None


def rest_weights(file: GltfFile, nodes: Nodes, rig: FaceRig, node: int) -> np.ndarray:
    """(T,) weights at rest of a node's morph targets: the node's, else its mesh's, else zero (glTF 2.0, 3.7.2.2)."""
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
    """The expressions that move each morph target of a mesh, and by how much."""
    users: dict[int, list[tuple[int, float]]] = {}
    for number, expression in enumerate(rig.expressions):
        for (owner, target), weight in expression.binds.items():
            if owner == mesh:
                users.setdefault(target, []).append((number, weight))
    return users


def _heads(file: GltfFile, nodes: Nodes, pieces: list[Piece], unit: float) -> list[Piece]:
    """If the mesh of the face includes a body, keep only what the head's bone carries."""
    faces = np.concatenate([piece.vertices for piece in pieces if piece.has_targets])
    head = find_bones(file, nodes).get("head")
    if unit * np.ptp(faces[:, 1]) <= LARGEST_HEAD or head is None:
        return pieces
    below = nodes.below(head)
    parts = []
    for piece in pieces:
        if piece.held is not None and piece.has_targets:
            carried = (piece.held.shares * np.isin(piece.held.joints, below)).sum(axis=1) > 0.5
            piece = piece.only(carried)
        if len(piece.triangles):
            parts.append(piece)
    return parts if any(piece.has_targets for piece in parts) else pieces


def _near_the_face(pieces: list[Piece]) -> tuple[list[Piece], list[str]]:
    """Pieces with morph targets, and other pieces whose middle lies near them; and a note about those left out."""
    face = np.concatenate([piece.vertices for piece in pieces if piece.has_targets])
    low, high = face.min(axis=0), face.max(axis=0)
    margin = 0.25 * (high - low)
    kept = []
    for piece in pieces:
        middle = (piece.vertices.min(axis=0) + piece.vertices.max(axis=0)) / 2
        if piece.has_targets or ((middle > low - margin) & (middle < high + margin)).all():
            kept.append(piece)
    left = len(pieces) - len(kept)
    return kept, [f"{left} meshes without morph targets left out"] if left else []


def _colours(piece: Piece) -> np.ndarray:
    return np.full(piece.vertices.shape, 200, np.uint8) if piece.colours is None else piece.colours
