"""Move a user's avatar with a tracked head: its bones or, if it has none, the nodes of the head's meshes.

All rotations are in the avatar's world frame. The neck's bone turns by a share of the tracked rotation, and the head's bone
adds the rest, so that the head has the whole rotation. Without bones, the nodes that carry the head's meshes turn about its
middle. In a scene that shows only a head, they also move.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import Rotation

from ..formats.gltf.bones import find_bones, find_eyes
from ..formats.gltf.container import looks_back
from ..formats.gltf.file import GltfFile
from ..formats.gltf.nodes import Nodes
from ..formats.quaternions import quaternion_matrix, quaternions
from ..livelink.convention import rotations
from ..retargeting.gltf_character import OpenFace
from ..retargeting.retarget import Performance
from .animation import NECK_SHARE, view_motion
from .avatar_gaze import gaze_by_expressions, reached


@dataclass
class AvatarMotion:
    """Tracks of (node, "rotation" or "translation", values (F, 4) or (F, 3)), and ``notes`` on what does not move."""

    tracks: list[tuple[int, str, np.ndarray]] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    def turn(self, node: int, local: np.ndarray) -> None:
        """Add a node's rotations (F, 3, 3) in its parent's frame."""
        self.tracks.append((node, "rotation", quaternions(local)))


def avatar_motion(
    file: GltfFile, nodes: Nodes, face: OpenFace | None, faces: set[int], performance: Performance, unit: float
) -> AvatarMotion:
    """The motion of head, neck and eyes.

    ``face`` is what the meshes tell, or None if they cannot be opened. ``faces`` are the nodes of the scene with driven morph
    targets. ``unit`` is the number of millimetres per unit of the file.
    """
    facing = np.diag([-1.0, 1.0, -1.0]) if looks_back(file) else np.eye(3)
    view = view_motion(performance.head_pose)
    turned = facing @ view[:, :3, :3] @ facing.T
    gaze = rotations(performance.eye_angles.reshape(-1, 2, 3))
    motion, rest = AvatarMotion(), _rest_rotations(nodes)
    bones = find_bones(file, nodes)
    if "head" in bones and not any(_carriers(nodes, n) & set(nodes.below(bones["head"])) for n in faces):
        bones = {}  # a skeleton that does not carry the face
    if "head" not in bones and face is not None and not face.alone and face.carrier is not None:
        bones = {"head": face.carrier}
        motion.notes.append(f"no bone is named head: '{nodes.name(face.carrier)}', which carries the face, is turned")
    if "head" in bones:
        _turn_bones(motion, nodes, rest, bones, turned)
    else:
        path = view[:, :3, 3] - np.median(view[:, :3, 3], axis=0)
        _move_meshes(motion, file, nodes, rest, face, faces, turned, path @ facing.T / unit)
        bones = find_eyes(nodes, {below for node, _, _ in motion.tracks for below in nodes.below(node)})
    _turn_eyes(motion, file, nodes, rest, face, bones, gaze, facing)
    return motion


def _rest_rotations(nodes: Nodes) -> list[np.ndarray]:
    """(3, 3) rotation of every node at rest in the world frame, without scale and shear."""
    rest: list = [np.eye(3)] * len(nodes.entries)
    for number in nodes.world:  # parents first
        above = rest[nodes.parent[number]] if number in nodes.parent else np.eye(3)
        rest[number] = above @ local_rotation(nodes, number)
    return rest


def local_rotation(nodes: Nodes, number: int) -> np.ndarray:
    """(3, 3) rotation of a node in its parent's frame at rest."""
    if number in nodes.ours:
        return np.eye(3)
    if "matrix" not in nodes.entries[number]:
        return quaternion_matrix(nodes.rotation(nodes.entries[number]))
    left, _, right = np.linalg.svd(nodes.local[number][:3, :3])
    near = left @ right
    return near if np.linalg.det(near) > 0 else -near  # a mirrored node; its scale holds the reflection


def _above(nodes: Nodes, rest: list[np.ndarray], number: int) -> np.ndarray:
    return rest[nodes.parent[number]] if number in nodes.parent else np.eye(3)


def _turn_bones(motion: AvatarMotion, nodes: Nodes, rest: list, bones: dict[str, int], turned: np.ndarray) -> None:
    head, neck = bones["head"], bones.get("neck")
    carried = np.eye(3)
    if neck is not None:
        vectors = Rotation.from_matrix(turned).as_rotvec()
        carried = Rotation.from_rotvec(NECK_SHARE * vectors).as_matrix()
        motion.turn(neck, _above(nodes, rest, neck).T @ carried @ rest[neck])
    above = carried @ _above(nodes, rest, head)
    motion.turn(head, np.swapaxes(above, -1, -2) @ turned @ rest[head])


def _turn_eyes(motion, file, nodes, rest, face: OpenFace | None, bones: dict, gaze: np.ndarray, facing: np.ndarray) -> None:
    """Turn the eyes' bones by ``gaze`` (F, 2, 3, 3), left and right eye, unless morph targets move the same eyes."""
    eyes = {name: bones[name] for name in ("left eye", "right eye") if name in bones}
    if not eyes or gaze_by_expressions(file):
        return
    held = None if face is None else {number for eye in eyes.values() for number in nodes.below(eye)} & face.eyes
    if held or held is None:
        motion.notes.append("the eyes follow their morph targets, so their bones stay at rest")
        return
    for side, name in enumerate(("left eye", "right eye")):
        if name in eyes:
            turned = facing @ reached(file, gaze[:, side], side) @ facing.T
            motion.turn(eyes[name], _above(nodes, rest, eyes[name]).T @ turned @ rest[eyes[name]])


def _move_meshes(motion, file, nodes: Nodes, rest, face: OpenFace | None, faces: set[int], turned, path: np.ndarray) -> None:
    """Without bones, turn the nodes that carry the head's meshes about its middle, and move them if there is no body."""
    head = faces if face is None else face.nodes
    shown = [number for number in nodes.shown if "mesh" in nodes.entries[number]]
    alone = set(shown) == head if face is None else face.alone
    carriers = {number: _carriers(nodes, number) for number in shown}
    others = set().union(*(carriers[number] for number in shown if number not in head))
    mine = set().union(*(carriers[number] for number in shown if number in head)) - others
    tops = _tops(nodes, mine, others)
    if not tops:
        motion.notes.append("the head does not move: no bone is named head, and its meshes hang on the body's bones")
        return
    middle = _middle(file, nodes, faces) if face is None else face.middle
    motions = np.tile(np.eye(4), (len(turned), 1, 1))
    motions[:, :3, :3] = turned
    motions[:, :3, 3] = middle - turned @ middle + (path if alone else 0.0)
    for node in tops:
        parent = nodes.world[nodes.parent[node]] if node in nodes.parent else np.eye(4)
        above = _above(nodes, rest, node)
        motion.turn(node, above.T @ turned @ rest[node])
        places = (np.linalg.inv(parent) @ motions @ nodes.world[node])[:, :3, 3]
        motion.tracks.append((node, "translation", places))


def _carriers(nodes: Nodes, number: int) -> set[int]:
    """The nodes that place a mesh: its own, or the joints of its skin."""
    entry = nodes.entries[number]
    return set(nodes.joints(entry["skin"])) if "skin" in entry else {number}


def _tops(nodes: Nodes, mine: set[int], others: set[int]) -> list[int]:
    """The topmost nodes that have some of ``mine``, and none of ``others``, at or below them."""
    counts = np.zeros((len(nodes.entries), 2), int)
    for number in reversed(nodes.shown):  # children before their parents
        counts[number] += [number in mine, number in others]
        if number in nodes.parent:
            counts[nodes.parent[number]] += counts[number]
    only = (counts[:, 0] > 0) & (counts[:, 1] == 0)
    shown = set(nodes.shown)
    tops = [n for n in nodes.shown if only[n] and not (nodes.parent.get(n) in shown and only[nodes.parent[n]])]
    return [_lowest(nodes, top, counts[:, 0], mine) for top in tops]


def _lowest(nodes: Nodes, number: int, held: np.ndarray, mine: set[int]) -> int:
    """The lowest node that has the same of ``mine`` at or below it as ``number``; ``held``: how many each node has."""
    while number not in mine:
        below = [child for child in nodes.children[number] if held[child] == held[number]]
        if not below:
            break
        number = below[0]
    return number


def _middle(file: GltfFile, nodes: Nodes, faces: set[int]) -> np.ndarray:
    """(3,) middle of meshes that are not opened, from the bounds that their accessors declare."""
    corners = []
    for number in faces:
        for primitive in file.item("meshes", nodes.entries[number]["mesh"])["primitives"]:
            bounds = file.item("accessors", primitive["attributes"]["POSITION"])
            box = np.array([bounds["min"], bounds["max"]], float)
            corners.append(box @ nodes.world[number][:3, :3].T + nodes.world[number][:3, 3])
    points = np.concatenate(corners)
    return (points.min(axis=0) + points.max(axis=0)) / 2
