"""Describe a face in OSC messages: VMC for avatars, plain OSC and Face Cap's OSC for everything else."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from ..livelink import ARKIT_NAMES
from ..livelink.convention import angles, eye_angles, rotations
from ..retargeting.vrm_presets import PRESETS, VRM0_NAMES, preset_weights
from .animation import NECK_SHARE

Message = tuple[str, list]

#: The bones that are sent, by VRM's names, with their positions relative to their parents in an adult avatar of VRoid
#: Studio: metres, x to the avatar's left, y up, z forward. A receiver sets the bone to the position in the message, so that
#: a position of zero would pull the head into the neck.
OFFSETS = {
    "Head": (0.0, 0.081, 0.010),
    "Neck": (0.0, 0.137, -0.040),
    "LeftEye": (0.016, 0.075, 0.026),
    "RightEye": (-0.016, 0.075, 0.026),
}
#: ARKit's shapes in the order in which Face Cap numbers them (its page on live mode).
FACE_CAP = tuple(
    """
    browInnerUp browDownLeft browDownRight browOuterUpLeft browOuterUpRight eyeLookUpLeft eyeLookUpRight eyeLookDownLeft
    eyeLookDownRight eyeLookInLeft eyeLookInRight eyeLookOutLeft eyeLookOutRight eyeBlinkLeft eyeBlinkRight eyeSquintLeft
    eyeSquintRight eyeWideLeft eyeWideRight cheekPuff cheekSquintLeft cheekSquintRight noseSneerLeft noseSneerRight jawOpen
    jawForward jawLeft jawRight mouthFunnel mouthPucker mouthLeft mouthRight mouthRollUpper mouthRollLower mouthShrugUpper
    mouthShrugLower mouthClose mouthSmileLeft mouthSmileRight mouthFrownLeft mouthFrownRight mouthDimpleLeft
    mouthDimpleRight mouthUpperUpLeft mouthUpperUpRight mouthLowerDownLeft mouthLowerDownRight mouthPressLeft
    mouthPressRight mouthStretchLeft mouthStretchRight tongueOut
    """.split()
)


@dataclass(frozen=True)
class FaceState:
    """A face at one moment.

    Attributes
    ----------
    time : float
        Seconds.
    tracked : bool
        Whether the face was tracked.
    curves : (52,)
        One value for each of ``ARKIT_NAMES``.
    rotation : (3, 3)
        Of the head, in the view frame (x right, y up, z to the viewer).
    place : (3,)
        How far the head has moved since the start, m.
    eyes : (6,), optional
        Yaw, pitch and roll of the left eye, then of the right eye, radians (:mod:`adaptiveface.livelink.convention`).
        Without them, the eyes follow the curves.
    """

    time: float
    tracked: bool
    curves: np.ndarray = field(default_factory=lambda: np.zeros(len(ARKIT_NAMES)))
    rotation: np.ndarray = field(default_factory=lambda: np.eye(3))
    place: np.ndarray = field(default_factory=lambda: np.zeros(3))
    eyes: np.ndarray | None = None

    @property
    def eye_angles(self) -> np.ndarray:
        """(6,) angles of the eyes, radians: the measured ones or, without a measurement, those of the curves."""
        return eye_angles(self.curves[None])[0] if self.eyes is None else self.eyes

    @property
    def head_angles(self) -> np.ndarray:
        """(3,) yaw, pitch and roll of the head in Live Link Face's convention, radians."""
        return angles(self.rotation)


@dataclass(frozen=True)
class VmcAvatar:
    """What is known about the avatar that receives VMC.

    Attributes
    ----------
    offsets : dict
        Bone -> its position relative to its parent, m, as :data:`OFFSETS`.
    arkit, presets : bool
        Whether to send the curves under ARKit's names, and as VRM's presets.
    moves : bool
        Whether the avatar's root follows the head through the room.
    """

    offsets: dict[str, tuple[float, float, float]] = field(default_factory=lambda: dict(OFFSETS))
    arkit: bool = True
    presets: bool = True
    moves: bool = False


def read_avatar(path: Path, moves: bool = False) -> VmcAvatar:
    """Read where a ``.vrm`` or ``.glb`` file has its bones, and which expressions its face knows.

    An avatar that knows ARKit's names is sent only those, because presets would move its face a second time. Raises
    :class:`FileFormatError`.
    """
    from ..formats.gltf.bones import find_bones
    from ..formats.gltf.container import GltfContainer, looks_back
    from ..formats.gltf.nodes import Nodes
    from ..retargeting.face_rig import face_rig

    file = GltfContainer(path)
    with file.errors():
        nodes = Nodes(file)
        found = {name.title().replace(" ", ""): number for name, number in find_bones(file, nodes).items()}
        turned = np.array([-1.0, 1.0, -1.0]) if looks_back(file) else np.ones(3)
        offsets = dict(OFFSETS)
        for name, number in found.items():
            above = nodes.world[nodes.parent[number]][:3, 3] if number in nodes.parent else np.zeros(3)
            offsets[name] = tuple(turned * (nodes.world[number][:3, 3] - above))
        rows = [e.row for e in face_rig(file).expressions if e.driven]
    arkit = sum(np.count_nonzero(row) == 1 and row.max() == 1.0 for row in rows) >= 20
    return VmcAvatar(offsets, arkit, not arkit, moves)


def vmc_messages(state: FaceState, avatar: VmcAvatar | None = None) -> list[Message]:
    """VMC messages (https://protocol.vmc.info), in Unity's axes: ``/VMC/Ext/OK``, ``T``, bones and blend values."""
    avatar = VmcAvatar() if avatar is None else avatar
    out: list[Message] = [("/VMC/Ext/OK", [int(state.tracked)])]
    if not state.tracked:
        return out
    out.append(("/VMC/Ext/T", [float(state.time)]))
    if avatar.moves:
        out.append(("/VMC/Ext/Root/Pos", ["root", *_unity_place(state.place), 0.0, 0.0, 0.0, 1.0]))
    turn = Rotation.from_matrix(state.rotation).as_rotvec()
    left, right = rotations(state.eye_angles.reshape(2, 3))
    turns = {
        "Head": Rotation.from_rotvec((1 - NECK_SHARE) * turn),
        "Neck": Rotation.from_rotvec(NECK_SHARE * turn),
        "LeftEye": Rotation.from_matrix(left),
        "RightEye": Rotation.from_matrix(right),
    }
    for bone, rotation in turns.items():
        place = _unity_place(avatar.offsets[bone])
        out.append(("/VMC/Ext/Bone/Pos", [bone, *place, *_unity_turn(rotation)]))
    if avatar.arkit:
        out += [
            ("/VMC/Ext/Blend/Val", [name[0].upper() + name[1:], float(value)])
            for name, value in zip(ARKIT_NAMES, state.curves, strict=True)
        ]
    if avatar.presets:
        for preset, value in zip(PRESETS, preset_weights(state.curves[None])[0].tolist(), strict=True):
            names = dict.fromkeys((preset, VRM0_NAMES.get(preset, preset)))
            out += [("/VMC/Ext/Blend/Val", [name, value]) for name in names]
    return [*out, ("/VMC/Ext/Blend/Apply", [])]


def osc_messages(state: FaceState) -> list[Message]:
    """Plain OSC messages, and those of Face Cap.

    Plain: ``/adaptiveface/tracked`` (0 or 1), ``/adaptiveface/head`` (position in m and quaternion x y z w, view frame) and
    ``/adaptiveface/blendshape`` (name, value). Face Cap: ``/HT`` (m), ``/HR``, ``/ELR`` and ``/ERR`` (degrees), ``/HRQ``
    (quaternion) and ``/W`` (number, value).
    """
    out: list[Message] = [("/adaptiveface/tracked", [int(state.tracked)])]
    if not state.tracked:
        return out
    place, turn = [float(v) for v in state.place], _quaternion(Rotation.from_matrix(state.rotation))
    out.append(("/adaptiveface/head", [*place, *turn]))
    curves = dict(zip(ARKIT_NAMES, (float(v) for v in state.curves), strict=True))
    out += [("/adaptiveface/blendshape", [name, value]) for name, value in curves.items()]
    yaw, pitch, roll = np.degrees(state.head_angles).tolist()
    eyes = np.degrees(state.eye_angles).tolist()
    out += [("/HT", place), ("/HR", [-pitch, yaw, roll]), ("/HRQ", turn)]
    out += [("/ELR", [-eyes[1], eyes[0]]), ("/ERR", [-eyes[4], eyes[3]])]
    return out + [("/W", [number, curves[name]]) for number, name in enumerate(FACE_CAP)]


def _quaternion(turn: Rotation) -> list[float]:
    x, y, z, w = (float(v) for v in turn.as_quat())
    return [x, y, z, w] if w >= 0 else [-x, -y, -z, -w]


def _unity_turn(turn: Rotation) -> list[float]:
    """A rotation in Unity's left-handed axes: mirroring x reverses the rotations about y and z."""
    x, y, z, w = _quaternion(turn)
    return [x, -y, -z, w]


def _unity_place(place) -> list[float]:
    x, y, z = (float(v) for v in place)
    return [-x, y, z]
