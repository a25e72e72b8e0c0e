"""glTF and VRM characters as their specifications say: the same head, whatever the file does with it."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from avatar_files import PRESET_SHAPES, Glb, avatar, head, plain_head, vrm_with_presets

from adaptiveface import cli
from adaptiveface.errors import FileFormatError, MissingExtraError
from adaptiveface.formats.gltf import compressed
from adaptiveface.retargeting.arkit import ARKIT_NAMES
from adaptiveface.retargeting.character import Character
from adaptiveface.retargeting.loading import load_character
from adaptiveface.retargeting.retarget import undriven

CASES = Path(__file__).resolve().parents[2] / "shared" / "cases" / "characters"
AVATARS = Path(__file__).resolve().parents[2] / "shared" / "avatars"


def curves(**values: float) -> np.ndarray:
    out = np.zeros((1, len(ARKIT_NAMES)))
    for name, value in values.items():
        out[0, ARKIT_NAMES.index(name)] = value
    return out


def moved(character: Character, **values: float) -> float:
    """mm: how far the farthest vertex goes from rest."""
    shapes = character.shape(character.weights(np.concatenate([curves(), curves(**values)])))
    return float(np.linalg.norm(shapes[1] - shapes[0], axis=1).max())


def same_head(character: Character, tolerance: float = 0.01) -> None:
    """The head of :func:`avatar_files.head`, in place, with its shapes."""
    points, triangles, _, shapes = head()
    np.testing.assert_allclose(character.neutral[: len(points)], 1000 * points, atol=tolerance)
    assert np.array_equal(np.sort(character.triangles[: len(triangles)]), np.sort(triangles))
    for name, shape in shapes.items():
        got = character.expressions[character.expression_names.index(name)][: len(points)]
        np.testing.assert_allclose(got, 1000 * shape, atol=tolerance, err_msg=name)


# ---- what was shown wrong ----


@pytest.mark.parametrize(
    ("name", "size"),
    [
        ("plain.glb", (159, 220, 179)),
        ("skin_cm_zup.glb", (159, 220, 179)),
        ("default_weights.glb", (239, 220, 179)),
        ("whole_and_halves.glb", (159, 220, 179)),
        ("other_scene.glb", (159, 220, 179)),
        ("strip.glb", (159, 220, 179)),
        ("cm_no_scale.glb", (15918, 21973, 17908)),
        ("vrm1_presets.vrm", (159, 220, 179)),
    ],
)
def test_cases(name, size):
    if not CASES.is_dir():
        pytest.skip(f"no cases at {CASES}")
    assert tuple(np.rint(load_character(CASES / name).size).astype(int)) == size


def test_avatars_of_people_have_the_same_head_in_every_compression():
    if not AVATARS.is_dir():
        pytest.skip(f"no avatars at {AVATARS}")
    pytest.importorskip("DracoPy", reason="the extra 'avatars' is not installed")
    plain, *others = (load_character(AVATARS / f"ready_player_me{kind}.glb") for kind in ("", "_quantised", "_draco"))
    for other in others:
        np.testing.assert_allclose(other.size, plain.size, atol=0.5)
        np.testing.assert_allclose(other.neutral.mean(axis=0), plain.neutral.mean(axis=0), atol=1.0)
        for name in ("jawOpen", "eyeBlinkLeft", "mouthSmileRight"):
            assert moved(other, **{name: 1}) == pytest.approx(moved(plain, **{name: 1}), abs=0.5)


def test_an_empty_arkit_shape_leaves_its_place_to_the_vowel():
    pytest.importorskip("meshopt", reason="the extra 'avatars' is not installed")
    if not AVATARS.is_dir():
        pytest.skip(f"no avatars at {AVATARS}")
    character = load_character(AVATARS / "vroid_meshopt.glb")
    assert moved(character, jawOpen=1) > 5  # its own jawOpen moves nothing; Fcl_MTH_A opens the mouth
    assert moved(character, eyeBlinkLeft=1) == pytest.approx(24.3, abs=0.5)  # and is not closed twice by Fcl_EYE_Close_L
    assert any("move nothing" in note and "jawOpen" in note for note in character.notes)


# ---- skins and nodes ----


def skinned(glb: Glb, world: np.ndarray, bind: np.ndarray, weights: np.ndarray, joints: np.ndarray) -> None:
    """Hang the head's mesh on joints: node matrices ``world`` (J, 4, 4), inverse bind matrices ``bind`` (J, 4, 4)."""
    nodes = [{"matrix": matrix.T.ravel().tolist()} for matrix in world]
    inverse = glb.accessor(bind.transpose(0, 2, 1).reshape(-1, 16).astype(np.float32))
    glb.append("skins", {"joints": list(range(len(nodes))), "inverseBindMatrices": inverse})
    attributes = glb.document["meshes"][0]["primitives"][0]["attributes"]
    normalized = {"normalized": True} if weights.dtype != np.float32 else {}
    attributes |= {"JOINTS_0": glb.accessor(joints), "WEIGHTS_0": glb.accessor(weights, **normalized)}
    away = {
        "mesh": 0,
        "skin": 0,
        "translation": [5, 5, 5],
        "scale": [3, 3, 3],
    }  # the mesh node's transform does not count
    glb.document["nodes"] = [*nodes, away]
    glb.document["scenes"] = [{"nodes": list(range(len(nodes) + 1))}]


def test_a_skin_places_the_mesh_and_its_node_does_not(tmp_path):
    glb, count = plain_head(), len(head()[0])
    up = np.array([[100, 0, 0, 7], [0, 0, 100, 0], [0, -100, 0, 3], [0, 0, 0, 1.0]])  # joint in cm, lying
    world = np.stack([up, np.eye(4)])
    bind = np.stack([np.linalg.inv(up), np.eye(4)])
    shares = np.tile(np.array([128, 127, 0, 0], np.uint8), (count, 1))
    skinned(glb, world, bind, shares, np.tile(np.array([0, 1, 0, 0], np.uint16), (count, 1)))
    same_head(load_character(glb.save(tmp_path / "skin.glb")))


def test_quantised_positions_and_targets_under_a_skin(tmp_path):
    points, triangles, _, shapes = head()
    middle, half = np.array([0, 1.62, 0]), 0.13
    glb = Glb()
    packed = np.rint(32767 * (points - middle) / half).astype(np.int16)
    primitive = {
        "attributes": {"POSITION": glb.accessor(packed, stride=8, normalized=True)},
        "indices": glb.accessor(triangles.ravel()),
        "targets": [],
    }
    for number, shape in enumerate(shapes.values()):
        if number % 2:
            target = glb.accessor(np.rint(32767 * shape / half).astype(np.int16), stride=8, normalized=True)
        else:
            target = glb.accessor((shape / half).astype(np.float32))
        primitive["targets"].append({"POSITION": target})
    glb.append("meshes", {"primitives": [primitive], "extras": {"targetNames": list(shapes)}})
    glb.document |= {"extensionsUsed": ["KHR_mesh_quantization"], "extensionsRequired": ["KHR_mesh_quantization"]}
    turn = np.diag([half, half, half, 1.0])
    turn[:3, 3] = middle
    weights = np.tile(np.array([255, 0, 0, 0], np.uint8), (len(points), 1))
    skinned(glb, np.eye(4)[None], turn[None], weights, np.zeros((len(points), 4), np.uint8))
    same_head(load_character(glb.save(tmp_path / "quantised.glb")), 0.02)


def test_without_inverse_bind_matrices_the_joints_alone_count(tmp_path):
    glb = plain_head()
    skinned(
        glb,
        np.eye(4)[None],
        np.eye(4)[None],
        np.tile(np.array([1, 0, 0, 0], np.float32), (len(head()[0]), 1)),
        np.zeros((len(head()[0]), 4), np.uint8),
    )
    del glb.document["skins"][0]["inverseBindMatrices"]
    same_head(load_character(glb.save(tmp_path / "bare.glb")))


@pytest.mark.parametrize("damage", ["joint outside", "too few matrices", "no weights", "no joints", "skin outside"])
def test_broken_skins_end_in_one_clear_error(tmp_path, damage):
    glb, count = plain_head(), len(head()[0])
    joints = np.zeros((count, 4), np.uint8)
    joints[3, 0] = 9 if damage == "joint outside" else 0
    skinned(glb, np.eye(4)[None], np.eye(4)[None], np.tile(np.array([1, 0, 0, 0], np.float32), (count, 1)), joints)
    if damage == "too few matrices":
        glb.document["skins"][0]["joints"] = [0, 0]
    if damage == "no joints":
        glb.document["skins"][0]["joints"] = []
    if damage == "no weights":
        del glb.document["meshes"][0]["primitives"][0]["attributes"]["WEIGHTS_0"]
    if damage == "skin outside":
        glb.document["nodes"][-1]["skin"] = 4
    with pytest.raises(FileFormatError, match=r"bad\.glb"):
        load_character(glb.save(tmp_path / "bad.glb"))


# ---- weights, scenes, primitives, names ----


def test_default_weights_stay_unless_a_curve_drives_the_target(tmp_path):
    points, _, _, shapes = head()
    wide = ((points - [0, 1.62, 0]) * [0.5, 0, 0]).astype(np.float32)
    rest = [0.4] + [0.0] * (len(shapes) - 1) + [1.0]
    glb = plain_head(shapes | {"WideHead": wide}, weights=rest)
    character = load_character(glb.save(tmp_path / "mesh.glb"))
    np.testing.assert_allclose(character.neutral, 1000 * (points + wide), atol=0.01)  # jawOpen is driven: shut at rest
    assert character.unknown == ("WideHead",)
    glb.document["nodes"][0]["weights"] = [0.0] * len(shapes) + [-1.0]  # the node's weights replace the mesh's
    character = load_character(glb.save(tmp_path / "node.glb"))
    np.testing.assert_allclose(character.neutral, 1000 * (points - wide), atol=0.01)
    glb.document["nodes"][0]["weights"] = [1.0]
    with pytest.raises(FileFormatError, match="default weights"):
        load_character(glb.save(tmp_path / "short.glb"))


@pytest.mark.parametrize("scene", [0, 1, None])
def test_only_the_default_scene_is_read(tmp_path, scene):
    glb = plain_head()
    glb.document["nodes"] = [
        {"children": [1]},
        {"mesh": 0},
        {"mesh": 0, "translation": [1, 0, 0]},
        {"mesh": 0, "scale": [9, 9, 9]},
    ]
    glb.document["scenes"] = [{"nodes": [0]}, {"nodes": [2]}]
    glb.document["scene"] = scene
    if scene is None:
        del glb.document["scene"]
    character = load_character(glb.save(tmp_path / "scenes.glb"))
    assert len(character.neutral) == len(head()[0])
    assert character.neutral[:, 0].mean() == pytest.approx(1000 if scene == 1 else 0, abs=1)
    glb.document["scene"] = 7
    with pytest.raises(FileFormatError, match="outside the 2 scenes"):
        load_character(glb.save(tmp_path / "bad.glb"))


@pytest.mark.parametrize("mode", ["list", "strip", "fan", "corners"])
def test_triangles_in_every_form(tmp_path, mode):
    """Four corners in a plane that looks along z, as two triangles."""
    square = np.array([[-0.1, 0, 0], [0.1, 0, 0], [-0.1, 0.2, 0], [0.1, 0.2, 0]], np.float32)
    order = {"list": [0, 1, 2, 2, 1, 3], "strip": [0, 1, 2, 3], "fan": [0, 1, 3, 2], "corners": None}[mode]
    points = square[[0, 1, 2, 2, 1, 3]] if order is None else square
    glb = Glb()
    primitive = {
        "attributes": {"POSITION": glb.accessor(points)},
        "targets": [{"POSITION": glb.accessor(0.1 * points)}],
        "mode": {"strip": 5, "fan": 6}.get(mode, 4),
    }
    if order:
        primitive["indices"] = glb.accessor(np.array(order, np.uint8))
    glb.append("meshes", {"primitives": [primitive], "extras": {"targetNames": ["jawOpen"]}})
    glb.document |= {"nodes": [{"mesh": 0}], "scenes": [{"nodes": [0]}]}
    character = load_character(glb.save(tmp_path / f"{mode}.glb"))
    a, b, c = (character.neutral[character.triangles[:, k]] for k in range(3))
    normals = np.cross(b - a, c - a)
    assert len(character.triangles) == 2 and (normals[:, 2] > 0).all()
    assert np.linalg.norm(normals, axis=1).sum() / 2 == pytest.approx(200 * 200)


def test_strips_with_stitches_lose_only_the_stitches(tmp_path):
    points = np.array([[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0], [1, 0, 0], [1.1, 0, 0], [1, 0.1, 0]], np.float32)
    glb = Glb()
    strip = [0, 1, 2, 2, 3, 3, 4, 5]
    primitive = {
        "attributes": {"POSITION": glb.accessor(points)},
        "targets": [{"POSITION": glb.accessor(points)}],
        "mode": 5,
        "indices": glb.accessor(np.array(strip, np.uint16)),
    }
    glb.append("meshes", {"primitives": [primitive], "extras": {"targetNames": ["jawOpen"]}})
    glb.document |= {"nodes": [{"mesh": 0}], "scenes": [{"nodes": [0]}]}
    triangles = load_character(glb.save(tmp_path / "strip.glb")).triangles
    assert sorted(map(sorted, triangles.tolist())) == [[0, 1, 2], [3, 4, 5]]


@pytest.mark.parametrize("place", ["mesh", "null", "list", "primitive", "targets", "accessors", "second primitive"])
def test_names_of_targets_in_their_usual_places(tmp_path, place):
    glb = plain_head()
    mesh = glb.document["meshes"][0]
    primitive, names = mesh["primitives"][0], mesh["extras"]["targetNames"]
    if place != "mesh":
        mesh["extras"] = {"null": None, "list": [1]}.get(place, {})
    if place in ("null", "list", "primitive"):
        primitive["extras"] = {"targetNames": names}
    if place == "second primitive":
        mesh["primitives"] = [primitive, json.loads(json.dumps(primitive)) | {"extras": {"targetNames": names}}]
    for target, name in zip(primitive["targets"], names, strict=True):
        if place == "targets":
            target["extras"] = {"name": name}
        if place == "accessors":
            glb.document["accessors"][target["POSITION"]]["name"] = name
    character = load_character(glb.save(tmp_path / "names.glb"))
    assert character.expression_names == tuple(names)


def test_sparse_targets_and_targets_without_data(tmp_path):
    glb, (points, _, _, shapes) = plain_head(), head()
    jaw = shapes["jawOpen"]
    at = np.flatnonzero(np.abs(jaw).max(axis=1) > 0).astype(np.uint16)
    target = glb.document["meshes"][0]["primitives"][0]["targets"][0]
    glb.document["accessors"][target["POSITION"]] = {
        "componentType": 5126,
        "count": len(points),
        "type": "VEC3",
        "sparse": {
            "count": len(at),
            "indices": {"bufferView": glb.view(at.tobytes()), "componentType": 5123},
            "values": {"bufferView": glb.view(jaw[at].tobytes())},
        },
    }
    same_head(load_character(glb.save(tmp_path / "sparse.glb")))


# ---- one movement, once ----


@pytest.mark.parametrize(
    ("names", "driven", "reach"),
    [
        (("browInnerUp", "browInnerUp_L", "browInnerUp_R"), {"browInnerUp"}, 1),
        (("browInnerUpLeft", "browInnerUp", "browInnerUpRight"), {"browInnerUp"}, 1),
        (("browInnerUp_L", "browInnerUp_R"), {"browInnerUp"}, 2),
        (("jawOpen", "JawOpen", "jaw_open"), {"jawOpen"}, 1),
        (("mouthSmile", "mouthSmileLeft", "mouthSmileRight"), {"mouthSmileLeft", "mouthSmileRight"}, 2),
        (("mouthSmile",), {"mouthSmile"}, 1),
        (("eyeBlink_L", "eyeBlinkLeft", "eyeBlink"), {"eyeBlink_L"}, 1),
        (("mouthOpen", "jawOpen"), {"jawOpen"}, 1),
        (("mouthOpen",), {"mouthOpen"}, 1),
        (("eyesClosed", "eyeBlinkLeft"), {"eyeBlinkLeft"}, 1),
        (("Cheek.Puff.L", "Cheek.Puff.R", "cheekPuff"), {"cheekPuff"}, 1),
    ],
)
def test_a_whole_and_its_halves_are_not_added_up(tmp_path, names, driven, reach):
    shape = np.zeros((len(head()[0]), 3), np.float32)
    shape[:, 1] = 0.01
    glb = plain_head(dict.fromkeys(names, shape))
    character = load_character(glb.save(tmp_path / "halves.glb"))
    everything = dict.fromkeys(ARKIT_NAMES, 1.0)
    assert moved(character, **everything) == pytest.approx(10 * reach, abs=0.01)
    assert set(character.expression_names) - set(character.unknown) == driven
    if len(names) > 1 and not names == ("browInnerUp_L", "browInnerUp_R"):
        assert any("not driven" in note for note in character.notes)


def test_directions_are_no_halves(tmp_path):
    shape = np.full((len(head()[0]), 3), 0.01, np.float32)
    character = load_character(plain_head({"jaw": shape, "mouth": shape, "jawLeft": shape}).save(tmp_path / "jaw.glb"))
    assert character.unknown == ("jaw", "mouth")


# ---- VRM ----


@pytest.mark.parametrize("kind", ["VRM", "VRMC_vrm"])
def test_vrm_presets_drive_what_has_no_arkit_names(tmp_path, kind):
    character = load_character(vrm_with_presets(kind).save(tmp_path / "presets.vrm"))
    shapes = head()[3]
    for preset, curve in {"aa": "jawOpen", "blinkLeft": "eyeBlinkLeft", "blinkRight": "eyeBlinkRight"}.items():
        expected = 1000 * float(np.linalg.norm(shapes[PRESET_SHAPES[preset]], axis=1).max())
        assert moved(character, **{curve: 1}) == pytest.approx(expected, abs=0.01), preset
    assert moved(character, mouthSmileLeft=1, mouthSmileRight=1) == pytest.approx(
        800 * float(np.linalg.norm(shapes["mouthSmileLeft"], axis=1).max()), abs=0.01
    )
    assert any("VRM presets" in note for note in character.notes)
    assert "shape_0" not in "".join(undriven(character))  # a part of a preset is not said to be left alone
    mouth = character.neutral[
        np.linalg.norm(character.shape(character.weights(curves(jawOpen=1))[0]) - character.neutral, axis=1) > 5
    ]
    assert mouth[:, 2].mean() > 0  # 0.x looks along -z, and is turned round


def test_presets_and_arkit_names_do_not_add_up(tmp_path):
    glb = vrm_with_presets("VRMC_vrm")
    names = glb.document["meshes"][0]["extras"]["targetNames"]
    names[list(head()[3]).index("jawOpen")] = "jawOpen"
    presets = glb.document["extensions"]["VRMC_vrm"]["expressions"]["preset"]
    presets["blink"] = {
        "morphTargetBinds": [*presets["blinkLeft"]["morphTargetBinds"], *presets["blinkRight"]["morphTargetBinds"]]
    }
    presets["ih"] = {"morphTargetBinds": []}
    character = load_character(glb.save(tmp_path / "both.vrm"))
    shapes = head()[3]
    assert moved(character, jawOpen=1) == pytest.approx(1000 * np.linalg.norm(shapes["jawOpen"], axis=1).max(), abs=0.01)
    assert moved(character, eyeBlinkLeft=1) == pytest.approx(
        1000 * np.linalg.norm(shapes["eyeBlinkLeft"], axis=1).max(), abs=0.01
    )
    driven = set(character.expression_names) - set(character.unknown)
    assert "jawOpen" in driven and "aa" not in driven and "blink" not in driven and "ih" not in driven


def test_vroid_targets_without_their_vrm_part(tmp_path):
    shapes = head()[3]
    named = {
        "Fcl_MTH_A": shapes["jawOpen"],
        "Fcl_EYE_Close_L": shapes["eyeBlinkLeft"],
        "Fcl_HA_Hide": shapes["mouthPucker"],
    }
    character = load_character(plain_head(named).save(tmp_path / "vroid.glb"))
    assert moved(character, jawOpen=1) > 10 and moved(character, eyeBlinkLeft=1) > 5 and moved(character, mouthPucker=1) < 0.01


# ---- size ----


@pytest.mark.parametrize(("unit", "scale"), [("cm", 100), ("mm", 1000), ("m", 1)])
def test_a_head_of_implausible_size_is_said_and_the_unit_can_be_given(tmp_path, capsys, unit, scale):
    glb = plain_head()
    glb.document["nodes"][0]["scale"] = [scale] * 3
    path = glb.save(tmp_path / "big.glb")
    take = tmp_path / "take.csv"
    write_take_of_one_second(take)
    said = []
    for options in ([], ["--unit", unit]):
        assert cli.main(["export", str(take), "--character", str(path), "--out", str(tmp_path / "x.glb"), *options]) == 0
        said.append(capsys.readouterr().out.splitlines())
    warned = [line for line in said[0] if "high" in line and "--unit" in line]
    assert len(warned) == (unit != "m") and all(f"{0.24 * scale:g} m" in line for line in warned)
    size = "{:.0f} x {:.0f} x {:.0f} mm".format(*1000 * np.ptp(head()[0], axis=0))
    assert not any("--unit" in line for line in said[1]) and any(size in line for line in said[1])


def write_take_of_one_second(path: Path) -> None:
    from adaptiveface.export.arkit_csv import write_arkit_csv
    from adaptiveface.retargeting.retarget import Performance

    rng = np.random.default_rng(0)
    write_arkit_csv(
        path,
        Performance(rng.uniform(0, 1, (30, 52)), np.arange(30) / 30, np.tile(np.diag([1.0, -1, -1, 1]), (30, 1, 1))),
    )


def test_of_a_mesh_that_is_face_and_body_the_head_is_measured(tmp_path):
    glb = avatar()
    meshes = glb.document["meshes"]
    body = meshes[1]["primitives"][0]
    zero = np.zeros((glb.document["accessors"][body["attributes"]["POSITION"]]["count"], 3), np.float32)
    body["targets"] = [{"POSITION": glb.accessor(zero)} for _ in meshes[0]["primitives"][0]["targets"]]
    meshes[0]["primitives"].append(body)
    character = load_character(glb.save(tmp_path / "one.glb"))
    assert character.size[1] == pytest.approx(240, abs=5) and not any("--unit" in note for note in character.notes)


# ---- compressed meshes ----


def draco(glb: Glb) -> Glb:
    """The head's first primitive with its geometry in Draco, and nowhere else."""
    library = pytest.importorskip("DracoPy", reason="the extra 'avatars' is not installed")
    points, triangles, _, _ = head()
    data = library.encode(points.astype(np.float32), triangles.astype(np.uint32), preserve_order=True, quantization_bits=16)
    primitive = glb.document["meshes"][0]["primitives"][0]
    for number in (primitive["attributes"]["POSITION"], primitive["indices"]):
        del glb.document["accessors"][number]["bufferView"]
    name = "KHR_draco_mesh_compression"
    primitive["extensions"] = {name: {"bufferView": glb.view(data), "attributes": {"POSITION": 0}}}
    glb.document |= {"extensionsUsed": [name], "extensionsRequired": [name]}
    return glb


def meshopt(glb: Glb) -> Glb:
    """All buffer views of a file compressed by meshoptimizer, without a fallback."""
    library = pytest.importorskip("meshopt", reason="the extra 'avatars' is not installed")
    document, before = glb.document, bytes(glb.binary)
    glb.binary = bytearray()
    indices = {p["indices"] for mesh in document["meshes"] for p in mesh["primitives"]}
    views, document["bufferViews"] = document["bufferViews"], []
    for number, entry in enumerate(document["accessors"]):
        view = views[entry["bufferView"]]
        data = before[view["byteOffset"] : view["byteOffset"] + view["byteLength"]]
        width = len(data) // entry["count"]
        rows = np.frombuffer(data, np.uint8).reshape(-1, width)
        if number in indices:
            mode, packed = "TRIANGLES", library.encode_gltf_buffer(rows.view(np.uint16).ravel(), "TRIANGLES")
        else:
            mode, packed = "ATTRIBUTES", library.encode_gltf_buffer(rows, "ATTRIBUTES")
        glb.view(packed)
        kept = document["bufferViews"][-1]
        compressed = {
            "buffer": 0,
            "byteOffset": kept["byteOffset"],
            "byteLength": len(packed),
            "byteStride": width,
            "count": entry["count"],
            "mode": mode,
        }
        kept |= {
            "buffer": 1,
            "byteOffset": view["byteOffset"],
            "byteLength": len(data),
            "extensions": {"EXT_meshopt_compression": compressed},
        }
        if mode == "ATTRIBUTES":
            kept["byteStride"] = width
        entry["bufferView"] = number
    document["buffers"] = [
        {},
        {"byteLength": len(before), "extensions": {"EXT_meshopt_compression": {"fallback": True}}},
    ]
    document |= {"extensionsUsed": ["EXT_meshopt_compression"], "extensionsRequired": ["EXT_meshopt_compression"]}
    return glb


@pytest.mark.parametrize("compress", [draco, meshopt])
def test_compressed_heads_are_the_same_heads(tmp_path, compress):
    same_head(load_character(compress(plain_head()).save(tmp_path / "packed.glb")), 0.02)


@pytest.mark.parametrize(("compress", "package"), [(draco, "DracoPy"), (meshopt, "meshopt")])
def test_without_the_library_the_exact_pip_line_is_said(tmp_path, monkeypatch, compress, package):
    path = compress(plain_head()).save(tmp_path / "packed.glb")
    monkeypatch.setattr(compressed, "_library", lambda name: None)
    with pytest.raises(MissingExtraError, match=r"packed\.glb.*pip install 'adaptiveface\[avatars\]'"):
        load_character(path)


@pytest.mark.parametrize("seed", range(40))
@pytest.mark.parametrize("compress", [draco, meshopt])
def test_damaged_compressed_data_end_in_one_clear_error(tmp_path, compress, seed):
    glb = compress(plain_head())
    rng = np.random.default_rng(seed)
    view = glb.document["bufferViews"][-1 if compress is draco else int(rng.integers(len(glb.document["bufferViews"])))]
    place = view.get("extensions", {}).get("EXT_meshopt_compression", view)
    start, size = place["byteOffset"], place["byteLength"]
    for at in rng.integers(start, start + size, 4):
        glb.binary[at] = rng.integers(256)
    if seed % 3 == 0:
        place["byteLength"] = int(rng.integers(1, size))
    if seed % 5 == 0 and compress is meshopt:
        place["count"] = int(rng.integers(1, 2**31))
    try:
        character = load_character(glb.save(tmp_path / "bad.glb"))
    except FileFormatError as error:
        assert "bad.glb" in str(error) and "\n" not in str(error)
    else:
        assert np.isfinite(character.neutral).all() and character.triangles.max() < len(character.neutral)


def test_draco_data_that_promise_more_than_declared_are_refused_before_decoding(tmp_path, monkeypatch):
    glb = draco(plain_head())
    start = glb.document["bufferViews"][-1]["byteOffset"]
    at = start + 11 + (glb.binary[start + 8] == 1)
    glb.binary[at : at + 5] = b"\xff\xff\xff\xff\x07"
    import DracoPy

    monkeypatch.setattr(DracoPy, "decode", lambda data: pytest.fail("decoded"))
    with pytest.raises(FileFormatError, match="more than declared"):
        load_character(glb.save(tmp_path / "bomb.glb"))
