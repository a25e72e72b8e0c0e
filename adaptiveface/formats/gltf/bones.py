"""Find the bones that a performance turns (head, neck and eyes), by VRM's humanoid or by the usual names."""

from __future__ import annotations

import re

from .container import GltfContainer, extensions
from .nodes import Nodes

#: Words in names of bones that tell the rig, not the bone.
_RIG = set(
    """
    mixamorig j bip adj c cc base def org valve biped armature bone jnt joint jt b m mid center
    x bind skin rig character avatar sk bn facial
    """.split()
)
_SIDES = {"l": "left", "left": "left", "r": "right", "right": "right"}
_JOINED = {
    "lefteye": "left eye",
    "righteye": "right eye",
    "eyeleft": "left eye",
    "eyeright": "right eye",
    "leye": "left eye",
    "reye": "right eye",
}
#: Names of bones in MikuMikuDance.
_JAPANESE = {"頭": {"head"}, "首": {"neck"}, "左目": {"left", "eye"}, "右目": {"right", "eye"}}
_EYES = ({"eye"}, {"eyeball"}, {"face", "eye"})
_VRM = {"head": "head", "neck": "neck", "leftEye": "left eye", "rightEye": "right eye"}


def find_bones(file: GltfContainer, nodes: Nodes) -> dict[str, int]:
    """Find the bones "head", "neck", "left eye" and "right eye", and return the node number of each one that was found.

    The neck and the eyes count only if they are connected with the head.
    """
    bones = _humanoid(file, nodes) or _named(nodes, _joints(file, nodes))
    if "head" not in bones:
        return {}
    above, below = nodes.ancestors(bones["head"]), nodes.below(bones["head"])
    return {name: n for name, n in bones.items() if n in (above if name == "neck" else below)}


def _humanoid(file: GltfContainer, nodes: Nodes) -> dict[str, int]:
    found: dict[str, int] = {}
    one = (extensions(file.document).get("VRMC_vrm") or {}).get("humanoid") or {}
    zero = (extensions(file.document).get("VRM") or {}).get("humanoid") or {}
    listed = [(name, entry["node"]) for name, entry in (one.get("humanBones") or {}).items()]
    listed += [(entry["bone"], entry["node"]) for entry in zero.get("humanBones") or ()]
    for name, node in listed:
        if name in _VRM:
            file.item("nodes", node)
            found[_VRM[name]] = node
    return {name: node for name, node in found.items() if node in nodes.world}


def _joints(file: GltfContainer, nodes: Nodes) -> list[int]:
    skins = {nodes.entries[n]["skin"] for n in nodes.shown if "mesh" in nodes.entries[n] and "skin" in nodes.entries[n]}
    joints = {joint for skin in sorted(skins) for joint in nodes.joints(skin)}
    return [n for n in nodes.shown if n in joints]  # parents first


def _named(nodes: Nodes, joints: list[int]) -> dict[str, int]:
    found: dict[str, int] = {}
    words = {number: _words(nodes.name(number)) for number in joints}
    for number in joints:
        if words[number] == {"head"}:
            found.setdefault("head", number)
    if "head" not in found:
        return {}
    necks = [number for number in nodes.ancestors(found["head"]) if words.get(number) in ({"neck"}, {"neck", "twist"})]
    if necks:
        found["neck"] = necks[-1]  # the lowest of several, at which a neck bends
    for number in nodes.below(found["head"]):
        for side in ("left", "right"):
            if words.get(number, set()) - {side} in _EYES and side in words[number]:
                found.setdefault(f"{side} eye", number)
    return found


def _words(name: str) -> set[str]:
    """The words of a bone's name without those of its rig, with the side spelt out: {"head"} for "J_Bip_C_Head"."""
    if name in _JAPANESE:
        return _JAPANESE[name]
    spaced = re.sub(r"(?<=[a-z0-9])(?=[A-Z])|[^A-Za-z]+", " ", name.rsplit(":", 1)[-1][:256]).lower()
    words = " ".join(_JOINED.get(word, word) for word in spaced.split()).split()
    return {_SIDES.get(word, word) for word in words if word not in _RIG}


def find_eyes(nodes: Nodes, candidates: set[int]) -> dict[str, int]:
    """Find "left eye" and "right eye" by their names among nodes that are no bones."""
    found: dict[str, int] = {}
    for number in sorted(candidates):
        words = _words(nodes.name(number))
        for side in ("left", "right"):
            if side in words and words - {side} in _EYES:
                found.setdefault(f"{side} eye", number)
    return found
