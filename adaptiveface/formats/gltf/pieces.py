"""Place the vertices of a glTF file's meshes at rest, through nodes and skins."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from ..surface import srgb_colours
from .file import FAN, TRIANGLES, GltfFile
from .nodes import Nodes

MAX_PRIMITIVES = 2000
#: Largest number of sets of four joints that may hold a vertex.
MAX_JOINT_SETS = 8


@dataclass
class Held:
    """The nodes (V, K) that hold each of V vertices as joints of a skin, and the share (V, K) of each. Shares sum to 1."""

    joints: np.ndarray
    shares: np.ndarray


@dataclass
class Piece:
    """One primitive of triangles that the default scene shows, with V vertices.

    Attributes
    ----------
    node, mesh : int
        Where it comes from.
    primitive : dict
        Its JSON object.
    vertices : (V, 3)
        Placed as at rest, in the file's unit.
    linear : (3, 3) or (V, 3, 3)
        The matrix that turns displacements as the vertices were turned.
    triangles : (T, 3)
        Vertex numbers.
    colours : (V, 3) uint8 or None
        sRGB.
    held : Held or None
        The joints that hold the vertices. None without a skin.
    kept : (V,)
        Numbers of the vertices in the file.
    count : int
        Number of vertices in the file.
    """

    node: int
    mesh: int
    primitive: dict
    vertices: np.ndarray
    linear: np.ndarray
    triangles: np.ndarray
    colours: np.ndarray | None
    held: Held | None
    kept: np.ndarray
    count: int

    @property
    def has_targets(self) -> bool:
        """Whether it has morph targets."""
        return bool(self.primitive.get("targets"))

    def displacements(self, file: GltfFile) -> Iterator[tuple[int, np.ndarray]]:
        """Yield the number and the displacements (V, 3) of every morph target that moves vertices."""
        for number, target in enumerate(self.primitive.get("targets") or ()):
            if "POSITION" in target:
                shape = file.accessor(target["POSITION"], self.count)
                if shape.shape[1] != 3:
                    raise file.error("a morph target does not hold three coordinates")
                yield number, _turned(self.linear, shape[self.kept].astype(float))

    def only(self, chosen: np.ndarray) -> Piece:
        """The piece with only the ``chosen`` vertices (V,), and the triangles between them."""
        place = np.cumsum(chosen) - 1
        triangles = place[self.triangles[chosen[self.triangles].all(axis=1)]].astype(np.int32)
        held = self.held
        return replace(
            self,
            vertices=self.vertices[chosen],
            linear=self.linear if self.linear.ndim == 2 else self.linear[chosen],
            triangles=triangles,
            colours=None if self.colours is None else self.colours[chosen],
            held=None if held is None else Held(held.joints[chosen], held.shares[chosen]),
            kept=self.kept[chosen],
        )


def read_pieces(file: GltfFile, nodes: Nodes) -> list[Piece]:
    """All pieces of the default scene. Raises :class:`FileFormatError` if there is none."""
    pieces: list[Piece] = []
    for number in nodes.shown:
        node = nodes.entries[number]
        if "mesh" not in node:
            continue
        for primitive in file.item("meshes", node["mesh"])["primitives"]:
            if not TRIANGLES <= primitive.get("mode", TRIANGLES) <= FAN:
                continue
            if len(pieces) >= MAX_PRIMITIVES:
                raise file.error(f"more than {MAX_PRIMITIVES} primitives")
            pieces.append(_piece(file, nodes, number, primitive))
    if not pieces:
        raise file.error("no node of its scene shows a mesh of triangles")
    return pieces


def _piece(file: GltfFile, nodes: Nodes, number: int, primitive: dict) -> Piece:
    node, decoded = nodes.entries[number], file.compressed.draco(primitive)
    attributes, corners = decoded if decoded else ({}, None)

    def attribute(name: str, count: int | None = None) -> np.ndarray:
        found = attributes.get(name)
        return file.accessor(primitive["attributes"][name], count) if found is None else found

    points = attribute("POSITION").astype(float)
    if points.shape[1] != 3:
        raise file.error("POSITION does not hold three coordinates")
    count = len(points)
    triangles = file.triangles(primitive, count, corners)
    transform, held = nodes.world[number], None
    if "skin" in node and "JOINTS_0" in primitive["attributes"]:
        sets = [k for k in range(MAX_JOINT_SETS) if f"JOINTS_{k}" in primitive["attributes"]]
        slots = np.column_stack([attribute(f"JOINTS_{k}", count) for k in sets])
        shares = np.column_stack([attribute(f"WEIGHTS_{k}", count) for k in sets]).astype(float)
        held, transform = _skinned(file, nodes, node["skin"], slots, shares)
    vertices = _turned(transform[..., :3, :3], points) + transform[..., :3, 3]
    if not np.isfinite(vertices).all() or np.abs(vertices).max() > 1e7:
        raise file.error("its vertices are absurdly far away")
    linear = transform[..., :3, :3]
    if np.median(np.linalg.det(linear)) < 0:  # a mirrored node turns triangles inside out
        triangles = triangles[:, ::-1]
    colours = srgb_colours(attribute("COLOR_0", count)[:, :3]) if "COLOR_0" in primitive["attributes"] else None
    return Piece(number, node["mesh"], primitive, vertices, linear, triangles, colours, held, np.arange(count), count)


def _skinned(file: GltfFile, nodes: Nodes, skin, slots: np.ndarray, shares: np.ndarray) -> tuple[Held, np.ndarray]:
    """What holds each vertex, and its transform (V, 4, 4): joint world times inverse bind (glTF 2.0, 3.7.3.3).

    ``slots`` (V, K) are numbers of the skin's joints, ``shares`` (V, K) as the file has them.
    """
    listed, entry = nodes.joints(skin), file.item("skins", skin)
    if slots.dtype.kind != "u" or slots.shape != shares.shape or slots.max() >= len(listed):
        raise file.error(f"JOINTS_0 points outside the {len(listed)} joints of its skin")
    inverse = np.tile(np.eye(4), (len(listed), 1, 1))
    if "inverseBindMatrices" in entry:
        matrices = file.accessor(entry["inverseBindMatrices"])
        if matrices.shape[1] != 16 or len(matrices) < len(listed):
            raise file.error(f"{len(matrices)} inverse bind matrices for {len(listed)} joints")
        inverse = matrices[: len(listed)].astype(float).reshape(-1, 4, 4).transpose(0, 2, 1)
    placed = np.stack([nodes.world[joint] for joint in listed]) @ inverse
    total = shares.sum(axis=1, keepdims=True)
    shares = shares / np.where(np.abs(total) > 1e-6, total, 1.0)
    file.spend(16 * len(slots))
    transform = np.zeros((len(slots), 4, 4))
    for slot, share in zip(slots.T, shares.T, strict=True):
        transform += share[:, None, None] * placed[slot]
    return Held(np.array(listed)[slots], shares), transform


def _turned(linear: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    return vectors @ linear.T if linear.ndim == 2 else np.einsum("vij,vj->vi", linear, vectors)
