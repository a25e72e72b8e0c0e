"""Read the nodes of a glTF file: which of them the default scene shows, where they are at rest, and its skins."""

from __future__ import annotations

import numpy as np

from ..quaternions import quaternion_matrix
from .container import GltfContainer

#: Largest number of a skin's joints. Real ones have a few hundred.
MAX_JOINTS = 10_000


class Nodes:
    """The tree of nodes.

    Raises :class:`FileFormatError` if a node has two parents, lies in a circle, or has a malformed transform.

    Attributes
    ----------
    entries : list of dict
        The nodes' JSON objects.
    children : list of list of int
        Children of each node.
    parent : dict
        Parent of each node that has one.
    local : list of (4, 4)
        Each node's transform at rest in its parent's frame.
    world : dict of (4, 4)
        Each node's transform at rest in the scene.
    shown : list of int
        Nodes of the default scene, parents first.
    ours : set of int
        Heads in files that this package wrote. They count as unturned.
    """

    def __init__(self, file: GltfContainer) -> None:
        self._file = file
        self.entries = file.items("nodes")
        self.children = [self._numbers_of(node, "children", len(self.entries)) for node in self.entries]
        self.parent: dict[int, int] = {}
        for number, below in enumerate(self.children):
            for child in below:
                if child in self.parent:
                    raise file.error(f"node {child} has two parents")
                self.parent[child] = number
        roots = [number for number in range(len(self.entries)) if number not in self.parent]
        order = self._below(roots)
        if len(order) < len(self.entries):
            lost = min(set(range(len(self.entries))) - set(order))
            raise file.error(f"node {lost} lies in a circle of nodes")
        self.local = [self._local(node) for node in self.entries]
        self.ours = {number for number, node in enumerate(self.entries) if self._posed_by_us(node)}
        for number in self.ours:  # the scale stays: compact files hold coordinates in units of it
            scale = np.linalg.norm(self.local[number][:3, :3], axis=0)
            self.local[number] = np.diag([*scale, 1.0])
        self.world: dict[int, np.ndarray] = {}
        for number in order:
            above = self.world[self.parent[number]] if number in self.parent else np.eye(4)
            self.world[number] = above @ self.local[number]
        self.shown = self._below(self._scene(roots))

    def _posed_by_us(self, node: dict) -> bool:
        """Whether the node is the head of a file that we wrote. Its rest is its first frame, not a neutral."""
        maker = str((self._file.document.get("asset") or {}).get("generator"))
        return maker.startswith("adaptiveface ") and node.get("name") == "head" and "mesh" in node

    def _scene(self, roots: list[int]) -> list[int]:
        """Roots of the default scene, which is the one that the file names, else its first one, else all nodes."""
        scenes = self._file.items("scenes")
        if not scenes and "scene" not in self._file.document:
            return roots
        scene = self._file.item("scenes", self._file.document.get("scene", 0))
        return self._numbers_of(scene, "nodes", len(self.entries))

    def _below(self, roots: list[int]) -> list[int]:
        """The nodes and all nodes below them, each once, parents first."""
        stack = list(reversed(roots))
        out: dict[int, None] = {}
        while stack:
            number = stack.pop()
            if number not in out:
                out[number] = None
                stack += reversed(self.children[number])
        return list(out)

    def below(self, number: int) -> list[int]:
        """The node and all nodes below it."""
        return self._below([number])

    def ancestors(self, number: int) -> list[int]:
        """Parents of a node, the nearest first."""
        out = []
        while number in self.parent:
            number = self.parent[number]
            out.append(number)
        return out

    def name(self, number: int) -> str:
        """The name of a node, or "" if it has none."""
        name = self.entries[number].get("name")
        return name if isinstance(name, str) else ""

    def _numbers_of(self, entry: dict, key: str, count: int) -> list[int]:
        numbers = entry.get(key, [])
        if not isinstance(numbers, list) or any(type(c) is not int or not 0 <= c < count for c in numbers):
            raise self._file.error(f"'{key}' of a node or scene point outside the {count} nodes")
        return numbers

    def joints(self, skin: int) -> list[int]:
        """Node numbers of a skin's joints."""
        joints = self._numbers_of(self._file.item("skins", skin), "joints", len(self.entries))
        if not 0 < len(joints) <= MAX_JOINTS:
            raise self._file.error(f"a skin of {len(joints)} joints")
        return joints

    def _local(self, node: dict) -> np.ndarray:
        if "matrix" in node:
            return self._numbers(node["matrix"], 16).reshape(4, 4).T
        out = np.eye(4)
        out[:3, :3] = quaternion_matrix(self.rotation(node)) * self._numbers(node.get("scale", [1, 1, 1]), 3)
        out[:3, 3] = self._numbers(node.get("translation", [0, 0, 0]), 3)
        return out

    def rotation(self, node: dict) -> np.ndarray:
        """(4,) quaternion x, y, z, w of a node. Its length may be any but zero."""
        rotation = self._numbers(node.get("rotation", [0, 0, 0, 1]), 4)
        if rotation @ rotation < 1e-12:
            raise self._file.error("a node's rotation is zero")
        return rotation

    def _numbers(self, values, count: int) -> np.ndarray:
        if not isinstance(values, list) or len(values) != count or any(type(v) not in (int, float) for v in values):
            raise self._file.error(f"a node's transform is not made of {count} numbers")
        out = np.array(values, float)
        if not (np.abs(out) < 1e9).all():
            raise self._file.error("a node's transform is not finite")
        return out
