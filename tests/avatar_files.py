"""Small avatars made for tests: a head on a skeleton, with texture, in the variants that people's files come in."""

from __future__ import annotations

import io
import json
import struct
from pathlib import Path

import numpy as np
from PIL import Image

_CODES = {"int8": 5120, "uint8": 5121, "int16": 5122, "uint16": 5123, "uint32": 5125, "float32": 5126}
_KINDS = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4", 16: "MAT4"}
#: Bone -> its parent and its place in metres; what VRM demands, and neck and eyes.
SKELETON = {
    "hips": (None, (0, 0.9, 0)),
    "spine": ("hips", (0, 1.1, 0)),
    "neck": ("spine", (0, 1.45, 0)),
    "head": ("neck", (0, 1.52, 0)),
    "leftEye": ("head", (0.03, 1.62, 0.07)),
    "rightEye": ("head", (-0.03, 1.62, 0.07)),
    "leftUpperLeg": ("hips", (0.1, 0.85, 0)),
    "leftLowerLeg": ("leftUpperLeg", (0.1, 0.45, 0)),
    "leftFoot": ("leftLowerLeg", (0.1, 0.08, 0)),
    "rightUpperLeg": ("hips", (-0.1, 0.85, 0)),
    "rightLowerLeg": ("rightUpperLeg", (-0.1, 0.45, 0)),
    "rightFoot": ("rightLowerLeg", (-0.1, 0.08, 0)),
    "leftUpperArm": ("spine", (0.18, 1.4, 0)),
    "leftLowerArm": ("leftUpperArm", (0.42, 1.4, 0)),
    "leftHand": ("leftLowerArm", (0.65, 1.4, 0)),
    "rightUpperArm": ("spine", (-0.18, 1.4, 0)),
    "rightLowerArm": ("rightUpperArm", (-0.42, 1.4, 0)),
    "rightHand": ("rightLowerArm", (-0.65, 1.4, 0)),
}
TEXTURE = (40, 90, 220)  # no other thing in the pictures is blue


class Glb:
    """A .glb under construction: ``document`` and its binary chunk."""

    def __init__(self) -> None:
        self.document: dict = {
            "asset": {"version": "2.0"},
            "accessors": [],
            "bufferViews": [],
            "buffers": [],
            "scene": 0,
            "scenes": [{"nodes": []}],
            "nodes": [],
            "meshes": [],
        }
        self.binary = bytearray()

    def view(self, data: bytes, **more) -> int:
        self.binary += b"\0" * (-len(self.binary) % 4)
        view = {"buffer": 0, "byteOffset": len(self.binary), "byteLength": len(data)} | more
        self.document["bufferViews"].append(view)
        self.binary += data
        return len(self.document["bufferViews"]) - 1

    def accessor(self, array: np.ndarray, stride: int = 0, **more) -> int:
        array = np.ascontiguousarray(array)
        rows = array.reshape(len(array), -1)
        entry = {"componentType": _CODES[str(array.dtype)], "count": len(array), "type": _KINDS[rows.shape[1]]} | more
        entry |= {"min": rows.min(axis=0).tolist(), "max": rows.max(axis=0).tolist()}
        data = rows.tobytes()
        if stride:
            wide = np.zeros((len(rows), stride), np.uint8)
            wide[:, : rows.itemsize * rows.shape[1]] = rows.view(np.uint8)
            data = wide.tobytes()
        entry["bufferView"] = self.view(data, **({"byteStride": stride} if stride else {}))
        return self.append("accessors", entry)

    def append(self, name: str, entry: dict) -> int:
        self.document.setdefault(name, []).append(entry)
        return len(self.document[name]) - 1

    def bytes(self, *more_chunks: tuple[bytes, bytes]) -> bytes:
        binary = bytes(self.binary) + b"\0" * (-len(self.binary) % 4)
        self.document["buffers"] = [{"byteLength": len(self.binary)}, *self.document["buffers"][1:]]
        text = json.dumps(self.document).encode()
        text += b" " * (-len(text) % 4)
        chunks = [(b"JSON", text), (b"BIN\0", binary), *more_chunks]
        body = b"".join(struct.pack("<I4s", len(data), kind) + data for kind, data in chunks)
        return struct.pack("<4sII", b"glTF", 2, 12 + len(body)) + body

    def save(self, path: Path, *more_chunks: tuple[bytes, bytes]) -> Path:
        path.write_bytes(self.bytes(*more_chunks))
        return path


def parsed(path: Path) -> tuple[dict, list[tuple[bytes, bytes]]]:
    """JSON object and the other chunks (kind, data) of a .glb."""
    data = path.read_bytes()
    at, chunks = 12, []
    while at < len(data):
        size, kind = struct.unpack_from("<I4s", data, at)
        chunks.append((kind, data[at + 8 : at + 8 + size]))
        at += 8 + size
    return json.loads(chunks[0][1]), chunks[1:]


def values(path: Path, accessor: int) -> np.ndarray:
    """(count, width) float32 of an accessor that was added at the end of a .glb."""
    document, chunks = parsed(path)
    entry = document["accessors"][accessor]
    view = document["bufferViews"][entry["bufferView"]]
    width = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}[entry["type"]]
    return np.frombuffer(chunks[0][1], np.float32, entry["count"] * width, view["byteOffset"]).reshape(-1, width)


def ball(centre, radii, rows: int = 14, columns: int = 18) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Vertices (V, 3), triangles (T, 3) and texture coordinates (V, 2) of an ellipsoid."""
    a, b = np.meshgrid(np.linspace(0.02, np.pi - 0.02, rows), np.linspace(0, 2 * np.pi, columns), indexing="ij")
    unit = np.stack([np.sin(a) * np.sin(b), np.cos(a), np.sin(a) * np.cos(b)], axis=-1).reshape(-1, 3)
    i = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)).ravel()
    triangles = np.concatenate([np.stack([i, i + columns, i + 1], 1), np.stack([i + 1, i + columns, i + columns + 1], 1)])
    return (
        unit * radii + centre,
        triangles.astype(np.uint16),
        np.stack([b, a], axis=-1).reshape(-1, 2) / [2 * np.pi, np.pi],
    )


def head() -> tuple[np.ndarray, np.ndarray, np.ndarray, dict[str, np.ndarray]]:
    """A head of 160 x 240 x 200 mm around (0, 1.62, 0), metres: vertices, triangles, texture coordinates, shapes."""
    points, triangles, uv = ball([0, 1.62, 0], [0.08, 0.12, 0.10])
    x, y, z = (points - [0, 1.62, 0]).T
    front = (z > 0.02).astype(float)

    def spot(across: float, up: float, wide: float, high: float, way: list[float]) -> np.ndarray:
        near = np.exp(-(((x - across) / wide) ** 2) - ((y - up) / high) ** 2) * front
        return near[:, None] * np.array(way)

    shapes = {
        "jawOpen": (np.clip(-y - 0.02, 0, None) / 0.1 * front)[:, None] * [0.0, -0.03, 0.005],
        "eyeBlinkLeft": spot(0.03, 0.02, 0.015, 0.015, [0, -0.012, 0]),
        "eyeBlinkRight": spot(-0.03, 0.02, 0.015, 0.015, [0, -0.012, 0]),
        "mouthSmileLeft": spot(0.03, -0.05, 0.02, 0.02, [0.01, 0.012, 0]),
        "mouthSmileRight": spot(-0.03, -0.05, 0.02, 0.02, [-0.01, 0.012, 0]),
        "browInnerUp": spot(0.0, 0.06, 1.0, 0.015, [0, 0.01, 0.002]),
        "mouthPucker": spot(0.0, -0.05, 0.03, 0.02, [0, 0, 0.015]),
    }
    return points, triangles, uv, {name: shape.astype(np.float32) for name, shape in shapes.items()}


def plain_head(shapes: dict[str, np.ndarray] | None = None, **mesh) -> Glb:
    """Only a head, one node, no skeleton."""
    glb = Glb()
    points, triangles, _, own = head()
    shapes = own if shapes is None else shapes
    primitive = {
        "attributes": {"POSITION": glb.accessor(points.astype(np.float32))},
        "indices": glb.accessor(triangles.ravel()),
        "targets": [{"POSITION": glb.accessor(shape)} for shape in shapes.values()],
    }
    glb.append("meshes", {"primitives": [primitive], "extras": {"targetNames": list(shapes)}} | mesh)
    glb.document["nodes"] = [{"mesh": 0}]
    glb.document["scenes"] = [{"nodes": [0]}]
    return glb


def avatar(kind: str = "", names: dict[str, str] | None = None, bones: str = "{}", eye_targets: bool = False) -> Glb:
    """A figure with a textured head, a body and two eyes, skinned to a skeleton.

    kind: "" (glTF), "VRM" (0.x, looks along -z) or "VRMC_vrm" (1.0); names: shape -> its name in the file, None: ARKit's own;
    bones: pattern of the bones' node names; eye_targets: gaze targets that move the eyes.
    """
    glb = Glb()
    back = np.array([-1, 1, -1]) if kind == "VRM" else np.ones(3, int)
    points, triangles, uv, shapes = head()
    order = list(SKELETON)
    places = {bone: np.array(place) * back for bone, (_, place) in SKELETON.items()}
    for bone, (parent, _) in SKELETON.items():
        above = places[parent] if parent else np.zeros(3)
        node = {"name": bones.format(bone[0].upper() + bone[1:]), "translation": (places[bone] - above).tolist()}
        glb.append("nodes", node)
        if parent:
            glb.document["nodes"][order.index(parent)].setdefault("children", []).append(len(glb.document["nodes"]) - 1)
    inverse = np.tile(np.eye(4, dtype=np.float32), (len(order), 1, 1))
    inverse[:, 3, :3] = [-places[bone] for bone in order]  # column-major
    glb.append("skins", {"joints": list(range(len(order))), "inverseBindMatrices": glb.accessor(inverse.reshape(-1, 16))})
    picture = io.BytesIO()
    Image.new("RGB", (8, 8), TEXTURE).save(picture, "PNG")
    glb.append("images", {"bufferView": glb.view(picture.getvalue()), "mimeType": "image/png"})
    glb.append("textures", {"source": 0})
    skin = {"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}, "metallicFactor": 0.0}, "doubleSided": True}
    grey = {"pbrMetallicRoughness": {"baseColorFactor": [0.3, 0.3, 0.3, 1], "metallicFactor": 0.0}, "doubleSided": True}
    glb.document["materials"] = [skin, grey]
    look = {
        f"eyeLook{way}{side}": {"Up": [0, 0.01, 0], "Down": [0, -0.01, 0], "In": [-0.01, 0, 0], "Out": [0.01, 0, 0]}[way]
        for way in ("Up", "Down", "In", "Out")
        for side in ("Left", "Right")
    }

    def mesh(name: str, geometry, bone: str, material: int, targets: dict) -> None:
        vertices, corners, coordinates = geometry
        joints = np.zeros((len(vertices), 4), np.uint8)
        joints[:, 0] = order.index(bone)
        attributes = {
            "POSITION": glb.accessor((vertices * back).astype(np.float32)),
            "JOINTS_0": glb.accessor(joints),
            "TEXCOORD_0": glb.accessor(coordinates.astype(np.float32)),
            "WEIGHTS_0": glb.accessor(np.tile(np.array([1, 0, 0, 0], np.float32), (len(vertices), 1))),
        }
        primitive = {"attributes": attributes, "indices": glb.accessor(corners.ravel()), "material": material}
        entry = {"name": name, "primitives": [primitive]}
        if targets:
            primitive["targets"] = [{"POSITION": glb.accessor((shape * back).astype(np.float32))} for shape in targets.values()]
            entry["extras"] = {"targetNames": list(targets)}
        number = glb.append("meshes", entry)
        glb.document["scenes"][0]["nodes"].append(glb.append("nodes", {"name": name, "mesh": number, "skin": 0}))

    called = {shape: (names or {}).get(shape, shape) for shape in shapes} if names is None else names
    glb.document["scenes"][0]["nodes"].append(0)
    mesh("Face", (points, triangles, uv), "head", 0, {called[s]: shapes[s] for s in shapes if s in called})
    mesh("Body", ball([0, 1.15, 0], [0.2, 0.3, 0.12]), "spine", 1, {})
    for side, x in (("left", 0.03), ("right", -0.03)):
        eye = ball([x, 1.62, 0.085], [0.014, 0.014, 0.014], 6, 8)
        moves = {name: np.tile(way, (len(eye[0]), 1)) for name, way in look.items() if name.lower().endswith(side)}
        mesh(f"{side}EyeBall", eye, f"{side}Eye", 1, moves if eye_targets else {})
    if kind:
        glb.document["extensionsUsed"] = [kind]
        glb.document["extensions"] = {kind: _vrm0(order) if kind == "VRM" else _vrm1(order)}
    return glb


def _vrm1(order: list[str]) -> dict:
    human = {bone: {"node": number} for number, bone in enumerate(order)}
    meta = {"name": "test", "version": "1", "authors": ["test"], "licenseUrl": "https://vrm.dev/licenses/1.0/"}
    return {
        "specVersion": "1.0",
        "meta": meta,
        "humanoid": {"humanBones": human},
        "expressions": {"preset": {}, "custom": {}},
    }


def _vrm0(order: list[str]) -> dict:
    human = [{"bone": bone, "node": number, "useDefaultValues": True} for number, bone in enumerate(order)]
    return {
        "specVersion": "0.0",
        "exporterVersion": "test",
        "meta": {"title": "test", "version": "1", "author": "test"},
        "humanoid": {"humanBones": human},
        "blendShapeMaster": {"blendShapeGroups": []},
        "materialProperties": [],
        "firstPerson": {},
        "secondaryAnimation": {"boneGroups": [], "colliderGroups": []},
    }


#: Preset of VRM 1.0 -> the head's shape that shows it.
PRESET_SHAPES = {
    "aa": "jawOpen",
    "blinkLeft": "eyeBlinkLeft",
    "blinkRight": "eyeBlinkRight",
    "happy": "mouthSmileLeft",
    "ou": "mouthPucker",
    "sad": "browInnerUp",
}


def vrm_with_presets(kind: str) -> Glb:
    """An avatar whose morph targets have meaningless names and are reached by VRM's presets only."""
    shapes = list(head()[3])
    glb = avatar(kind, {shape: f"shape_{number}" for number, shape in enumerate(shapes)})
    face = next(n for n, node in enumerate(glb.document["nodes"]) if node.get("name") == "Face")
    if kind == "VRMC_vrm":
        glb.document["extensions"][kind]["expressions"]["preset"] = {
            preset: {
                "isBinary": False,
                "overrideBlink": "none",
                "overrideLookAt": "none",
                "overrideMouth": "none",
                "morphTargetBinds": [{"node": face, "index": shapes.index(shape), "weight": 1.0}],
            }
            for preset, shape in PRESET_SHAPES.items()
        }
    else:
        old = {"aa": "a", "blinkLeft": "blink_l", "blinkRight": "blink_r", "happy": "joy", "ou": "u", "sad": "sorrow"}
        mesh = glb.document["nodes"][face]["mesh"]
        glb.document["extensions"][kind]["blendShapeMaster"]["blendShapeGroups"] = [
            {
                "name": f"group {preset}",
                "presetName": old[preset],
                "isBinary": False,
                "materialValues": [],
                "binds": [{"mesh": mesh, "index": shapes.index(shape), "weight": 100}],
            }
            for preset, shape in PRESET_SHAPES.items()
        ]
    return glb
