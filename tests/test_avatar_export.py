"""The export of an avatar is the avatar: the user's file, byte for byte, with an animation that is right."""

from __future__ import annotations

import base64
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import web
from avatar_files import (
    PRESET_SHAPES,
    SKELETON,
    TEXTURE,
    Glb,
    avatar,
    head,
    parsed,
    plain_head,
    values,
    vrm_with_presets,
)
from avatar_page import page
from scipy.spatial.transform import Rotation
from test_characters_hostile import _mutated_json, pack

from adaptiveface import cli
from adaptiveface.errors import AdaptiveFaceError, FileFormatError, ParameterError
from adaptiveface.export.animation import character_animation
from adaptiveface.export.avatar import ANIMATION, Avatar
from adaptiveface.export.avatar_motion import NECK_SHARE
from adaptiveface.export.gltf import write_glb
from adaptiveface.formats.gltf import compressed
from adaptiveface.livelink.convention import EYE_PITCH, EYE_YAW
from adaptiveface.retargeting.arkit import ARKIT_NAMES
from adaptiveface.retargeting.loading import load_character
from adaptiveface.retargeting.retarget import Performance
from adaptiveface.retargeting.vrm_presets import preset_weights

AVATARS = Path(__file__).resolve().parents[2] / "shared" / "avatars"
FRAMES = 12
#: A public avatar of a third maker: the raccoon of MediaPipe's face sample, in an npm package.
RACCOON = ("@needle-tools/facefilter@1.0.4", "@needle-tools/facefilter/unity/Runtime/Assets/Racoon.glb")


@pytest.fixture(scope="module")
def performance() -> Performance:
    """The head turns to its left, nods and tilts; the mouth opens; the eyes look about."""
    time = np.linspace(0, 1, FRAMES)
    curves = np.zeros((FRAMES, len(ARKIT_NAMES)))
    for name, curve in {
        "jawOpen": time,
        "eyeBlinkLeft": time[::-1],
        "mouthSmileLeft": 0.5 * time,
        "mouthSmileRight": 0.5 * time,
        "eyeLookOutLeft": time,
        "eyeLookInRight": time,
        "eyeLookDownLeft": 0.5 * time,
        "eyeLookDownRight": 0.5 * time,
    }.items():
        curves[:, ARKIT_NAMES.index(name)] = curve
    rigid = np.tile(np.eye(4), (FRAMES, 1, 1))
    rigid[:, :3, :3] = np.diag([1.0, -1, -1]) @ turns(time)
    rigid[:, :3, 3] = np.column_stack([40 * time, -10 * time, 600 + 30 * time])
    return Performance(curves, time, rigid)


def turns(time: np.ndarray) -> np.ndarray:
    """(F, 3, 3) what the head does, in its own axes: x left, y up, z out."""
    return Rotation.from_euler("YXZ", np.column_stack([40 * time, 20 * time, 10 * time]), degrees=True).as_matrix()


@pytest.fixture(scope="session")
def modules(tmp_path_factory):
    return web.install(tmp_path_factory.mktemp("node"), web.VALIDATOR, web.THREE, web.THREE_VRM, RACCOON[0])


def tracks(path: Path) -> dict[tuple[str, str], np.ndarray]:
    """(node's name, path) -> values of the animation that was added to a .glb."""
    document = parsed(path)[0]
    added = document["animations"][-1]
    assert added["name"].startswith(ANIMATION)
    return {
        (document["nodes"][c["target"]["node"]].get("name", ""), c["target"]["path"]): values(
            path, added["samplers"][c["sampler"]]["output"]
        )
        for c in added["channels"]
    }


def world_rotations(path: Path, name: str) -> np.ndarray:
    """(F, 3, 3) world rotation of a node by name while the file plays; scales must be uniform."""
    document, moved = parsed(path)[0], tracks(path)
    nodes = document["nodes"]
    parents = {child: n for n, node in enumerate(nodes) for child in node.get("children", ())}
    at, out = next(n for n, node in enumerate(nodes) if node.get("name") == name), np.eye(3)
    while at is not None:
        rest = [nodes[at].get("rotation", [0, 0, 0, 1])]
        out = Rotation.from_quat(moved.get((nodes[at].get("name", ""), "rotation"), rest)).as_matrix() @ out
        at = parents.get(at)
    return out


def unchanged(before: Path, after: Path) -> dict:
    """Everything of a .glb is in another one, and only an animation's things were added; returns the new document."""
    (old, old_chunks), (new, new_chunks) = parsed(before), parsed(after)
    for key, value in old.items():
        if key == "buffers":
            assert [b | {"byteLength": 0} for b in new[key]] == [b | {"byteLength": 0} for b in value]
        elif key in ("accessors", "bufferViews", "animations"):
            assert new[key][: len(value)] == value
        else:
            assert new[key] == value, key
    assert new.keys() - old.keys() <= {"animations"}
    for (kind, data), (new_kind, new_data) in zip(old_chunks, new_chunks, strict=True):
        assert kind == new_kind and (new_data.startswith(data) if kind == b"BIN\0" else new_data == data)
    return new


# ---- the file ----


@pytest.mark.parametrize("kind", ["", "VRM", "VRMC_vrm"])
def test_everything_else_is_kept_byte_for_byte(tmp_path, performance, kind):
    glb = avatar(kind)
    glb.document |= {"extras": {"mine": [1, 2.5e-7, "ä"]}, "unknownThing": {"deep": [None, True]}}
    times = glb.accessor(np.array([0, 1], np.float32))
    samplers = [{"input": times, "output": glb.accessor(np.zeros((2, 3), np.float32))}]
    glb.document["animations"] = [
        {"samplers": samplers, "channels": [{"sampler": 0, "target": {"node": 0, "path": "translation"}}]}
    ]
    path = glb.save(tmp_path / "avatar.glb", (b"XTRA", b"somebody's own chunk"))
    said = Avatar(path).write(tmp_path / "out.glb", performance)
    new = unchanged(path, tmp_path / "out.glb")
    assert len(new["animations"]) == 2 and any("1 animations are kept" in line for line in said)
    body = next(m for m in new["meshes"] if m["name"] == "Body")
    assert body and new["images"] and new["skins"] and new["materials"]


def test_a_second_performance_has_a_name_of_its_own(tmp_path, performance):
    avatar().save(tmp_path / "0.glb")
    for take in range(3):
        Avatar(tmp_path / f"{take}.glb").write(tmp_path / f"{take + 1}.glb", performance)
    names = [animation["name"] for animation in parsed(tmp_path / "3.glb")[0]["animations"]]
    assert names == ["performance", "performance 2", "performance 3"]


def test_weights_are_the_curves_and_default_weights_stay(tmp_path, performance):
    shapes = head()[3]
    glb = plain_head(shapes | {"WideHead": shapes["mouthPucker"]}, weights=[0.0] * len(shapes) + [0.75])
    Avatar(glb.save(tmp_path / "a.glb")).write(tmp_path / "out.glb", performance)
    weights = tracks(tmp_path / "out.glb")["", "weights"].reshape(FRAMES, -1)
    for number, name in enumerate(shapes):
        np.testing.assert_allclose(weights[:, number], performance.curves[:, ARKIT_NAMES.index(name)], atol=1e-6)
    np.testing.assert_allclose(weights[:, -1], 0.75)


@pytest.mark.parametrize("kind", ["VRM", "VRMC_vrm"])
def test_presets_drive_their_targets(tmp_path, performance, kind):
    Avatar(vrm_with_presets(kind).save(tmp_path / "a.vrm")).write(tmp_path / "out.vrm", performance)
    weights = tracks(tmp_path / "out.vrm")["Face", "weights"].reshape(FRAMES, -1)
    expected = preset_weights(performance.curves, tuple(PRESET_SHAPES))
    for column, shape in zip(expected.T, PRESET_SHAPES.values(), strict=True):
        np.testing.assert_allclose(weights[:, list(head()[3]).index(shape)], column, atol=1e-6)


def test_times_are_those_of_the_performance(tmp_path, performance):
    Avatar(avatar().save(tmp_path / "a.glb")).write(tmp_path / "out.glb", performance)
    animation = parsed(tmp_path / "out.glb")[0]["animations"][0]
    for sampler in animation["samplers"]:
        np.testing.assert_allclose(values(tmp_path / "out.glb", sampler["input"])[:, 0], performance.timestamps, atol=1e-6)


@pytest.mark.parametrize("frames", [1, 2])
def test_short_takes(tmp_path, performance, modules, frames):
    short = Performance(performance.curves[:frames], performance.timestamps[:frames], performance.head_pose[:frames])
    path = avatar().save(tmp_path / "a.glb")
    Avatar(path).write(tmp_path / "out.glb", short)
    before, after = web.validation(modules, path, tmp_path / "out.glb")
    assert after == before


# ---- bones ----


@pytest.mark.parametrize(
    ("kind", "bones"),
    [
        ("", "{}"),
        ("", "mixamorig:{}"),
        ("", "J_Bip_C_{}"),
        ("", "CC_Base_{}"),
        ("", "DEF-{}"),
        ("", "Bip01 {}"),
        ("", "{}.x"),
        ("", "c_{}_jnt"),
        ("", "ValveBiped.Bip01_{}1"),
        ("VRM", "Bone{}_x"),
        ("VRMC_vrm", "irgendwas{}"),
    ],
)
def test_head_neck_and_eyes_turn_as_the_performer(tmp_path, performance, kind, bones):
    Avatar(avatar(kind, bones=bones).save(tmp_path / "a.glb")).write(tmp_path / "out.glb", performance)
    facing = np.diag([-1.0, 1, -1]) if kind == "VRM" else np.eye(3)
    time = performance.timestamps
    expected = facing @ turns(time) @ facing
    out = tmp_path / "out.glb"
    np.testing.assert_allclose(world_rotations(out, bones.format("Head")), expected, atol=1e-6)
    share = Rotation.from_rotvec(NECK_SHARE * Rotation.from_matrix(expected).as_rotvec()).as_matrix()
    np.testing.assert_allclose(world_rotations(out, bones.format("Neck")), share, atol=1e-6)
    assert (bones.format("Spine"), "rotation") not in tracks(out)
    for side in ("Left", "Right"):
        eye = np.swapaxes(expected, 1, 2) @ world_rotations(out, bones.format(f"{side}Eye"))
        look = (facing @ eye @ facing)[:, :, 2]  # where the eye looks, in the head's own axes
        np.testing.assert_allclose(np.arctan2(look[:, 0], look[:, 2]), EYE_YAW * time, atol=0.02)  # to the subject's left
        np.testing.assert_allclose(np.arcsin(look[:, 1]), -0.5 * EYE_PITCH * time, atol=0.02)  # down


def test_bones_with_rest_rotations_scales_and_matrices(tmp_path, performance, modules):
    glb = avatar()
    nodes = glb.document["nodes"]
    by = {node["name"]: node for node in nodes}
    by["Hips"] |= {"rotation": Rotation.from_euler("x", -90, degrees=True).as_quat().tolist(), "scale": [0.01] * 3}
    by["Head"]["rotation"] = Rotation.from_euler("xyz", [30, 40, 50], degrees=True).as_quat().tolist()
    matrix = np.eye(4)
    matrix[:3, :3] = 2 * Rotation.from_euler("y", 70, degrees=True).as_matrix()
    matrix[:3, 3] = by["Neck"].pop("translation")
    by["Neck"]["matrix"] = matrix.T.ravel().tolist()
    rest = Rotation.from_euler("x", -90, degrees=True) * Rotation.from_euler("y", 70, degrees=True)
    rest = (rest * Rotation.from_euler("xyz", [30, 40, 50], degrees=True)).as_matrix()
    path = glb.save(tmp_path / "a.glb")
    Avatar(path, unit=1000).write(tmp_path / "out.glb", performance)
    np.testing.assert_allclose(world_rotations(tmp_path / "out.glb", "Head"), turns(performance.timestamps) @ rest, atol=1e-6)
    neck = next(n for n in parsed(tmp_path / "out.glb")[0]["nodes"] if n["name"] == "Neck")
    assert "matrix" not in neck
    np.testing.assert_allclose(neck["scale"], [2, 2, 2], atol=1e-9)
    np.testing.assert_allclose(neck["translation"], matrix[:3, 3], atol=1e-9)
    before, after = web.validation(modules, path, tmp_path / "out.glb")
    assert [code for code in after if code not in before] == []


def test_eyes_that_morph_targets_move_are_not_turned_as_well(tmp_path, performance):
    said = Avatar(avatar(eye_targets=True).save(tmp_path / "a.glb")).write(tmp_path / "out.glb", performance)
    moved = tracks(tmp_path / "out.glb")
    assert ("LeftEye", "rotation") not in moved and any("morph targets" in line for line in said)
    assert moved["leftEyeBall", "weights"].max() == pytest.approx(1)


@pytest.mark.parametrize("kind", ["VRM", "VRMC_vrm"])
def test_vrm_range_maps_hold_the_eyes(tmp_path, performance, kind):
    glb = avatar(kind)
    if kind == "VRMC_vrm":
        limit = {"inputMaxValue": 90, "outputScale": 9}
        names = ("HorizontalInner", "HorizontalOuter", "VerticalDown", "VerticalUp")
        glb.document["extensions"][kind]["lookAt"] = {"type": "bone"} | {f"rangeMap{name}": limit for name in names}
    else:
        limit = {"curve": [0, 0, 0, 1, 1, 1, 1, 0], "xRange": 90, "yRange": 9}
        names = ("HorizontalInner", "HorizontalOuter", "VerticalDown", "VerticalUp")
        glb.document["extensions"][kind]["firstPerson"] = {"lookAtTypeName": "Bone"} | {f"lookAt{n}": limit for n in names}
    Avatar(glb.save(tmp_path / "a.vrm")).write(tmp_path / "out.vrm", performance)
    eye = Rotation.from_quat(tracks(tmp_path / "out.vrm")["LeftEye", "rotation"][-1])
    assert np.degrees(eye.magnitude()) == pytest.approx(np.hypot(np.degrees(EYE_YAW), np.degrees(EYE_PITCH / 2)) / 10, rel=0.02)


def test_a_head_without_bones_turns_about_itself_and_moves(tmp_path, performance):
    glb = plain_head()
    Avatar(glb.save(tmp_path / "a.glb")).write(tmp_path / "out.glb", performance)
    moved, points = tracks(tmp_path / "out.glb"), head()[0]
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    turn = Rotation.from_quat(moved["", "rotation"]).as_matrix()
    np.testing.assert_allclose(turn, turns(performance.timestamps), atol=1e-6)
    places = turn @ middle + moved["", "translation"]  # of the head's middle
    path = performance.head_pose[:, :3, 3] * [1e-3, -1e-3, -1e-3]
    np.testing.assert_allclose(places - middle, path - np.median(path, axis=0), atol=1e-6)


def test_of_a_figure_without_bones_only_the_head_turns(tmp_path, performance):
    glb = plain_head()
    glb.append("meshes", {"primitives": [{"attributes": glb.document["meshes"][0]["primitives"][0]["attributes"]}]})
    glb.document["nodes"] = [
        {"name": "root", "scale": [2] * 3, "children": [1, 2, 4]},
        {"name": "body", "mesh": 1, "translation": [0, -1, 0]},
        {"name": "headGroup", "translation": [0, 0.1, 0], "children": [3, 5]},
        {"name": "face", "mesh": 0},
        {"name": "foot", "mesh": 1, "translation": [0, -2, 0]},
        {"name": "hair", "mesh": 1},
    ]
    Avatar(glb.save(tmp_path / "a.glb")).write(tmp_path / "out.glb", performance)
    assert {name for name, path in tracks(tmp_path / "out.glb") if path != "weights"} == {"headGroup"}


def test_a_character_that_we_exported_performs_again(tmp_path, performance):
    """It rests in its first frame's pose, which neither its neutral nor the next performance may have in it."""
    hag = load_character("hag")
    tilted = performance.head_pose.copy()
    tilted[:, :3, :3] = performance.head_pose[:1, :3, :3] @ Rotation.from_euler("y", 30, degrees=True).as_matrix()
    write_glb(tmp_path / "hag.glb", character_animation(hag, replace(performance, head_pose=tilted)))
    again = load_character(tmp_path / "hag.glb")
    np.testing.assert_allclose(again.neutral - again.neutral.mean(0), hag.neutral - hag.neutral.mean(0), atol=0.01)
    Avatar(tmp_path / "hag.glb").write(tmp_path / "out.glb", performance)
    np.testing.assert_allclose(world_rotations(tmp_path / "out.glb", "head"), turns(performance.timestamps), atol=1e-6)


def test_where_no_bone_is_named_head_the_one_that_carries_the_face_turns(tmp_path, performance):
    said = Avatar(avatar(bones="knochen{}q").save(tmp_path / "a.glb")).write(tmp_path / "out.glb", performance)
    assert any("knochenHeadq" in line for line in said)
    np.testing.assert_allclose(world_rotations(tmp_path / "out.glb", "knochenHeadq"), turns(performance.timestamps), atol=1e-6)


def test_a_skeleton_that_the_face_does_not_hang_on_is_left_alone(tmp_path, performance):
    glb = avatar()
    face = next(node for node in glb.document["nodes"] if node.get("name") == "Face")
    del face["skin"]
    attributes = glb.document["meshes"][face["mesh"]]["primitives"][0]["attributes"]
    del attributes["JOINTS_0"], attributes["WEIGHTS_0"]
    Avatar(glb.save(tmp_path / "a.glb")).write(tmp_path / "out.glb", performance)
    moved = tracks(tmp_path / "out.glb")
    assert ("Face", "rotation") in moved and ("Head", "rotation") not in moved


def test_japanese_bones(tmp_path, performance):
    glb, names = avatar(), {"Head": "頭", "Neck": "首", "LeftEye": "左目", "RightEye": "右目"}
    for node in glb.document["nodes"]:
        node["name"] = names.get(node["name"], node["name"] + "骨")
    Avatar(glb.save(tmp_path / "a.glb")).write(tmp_path / "out.glb", performance)
    assert {(name, "rotation") for name in names.values()} <= tracks(tmp_path / "out.glb").keys()


# ---- .gltf, files beside it, names ----


def gltf_with_files(folder: Path, buffers: int = 1) -> Path:
    """An avatar as .gltf with a buffer and a picture beside it."""
    glb = avatar()
    folder.mkdir()
    document, view = glb.document, glb.document["bufferViews"][glb.document["images"][0]["bufferView"]]
    (folder / "my skin.png").write_bytes(glb.binary[view["byteOffset"] : view["byteOffset"] + view["byteLength"]])
    document["images"] = [{"uri": "my%20skin.png"}]
    (folder / "data.bin").write_bytes(glb.binary)
    document["buffers"] = [{"uri": "data.bin", "byteLength": len(glb.binary)}]
    if buffers == 2:  # the last accessor's data in a second buffer
        last = document["bufferViews"][-1]
        (folder / "more.bin").write_bytes(glb.binary[last["byteOffset"] : last["byteOffset"] + last["byteLength"]])
        last |= {"buffer": 1, "byteOffset": 0}
        document["buffers"].append({"uri": "more.bin", "byteLength": last["byteLength"]})
    (folder / "avatar.gltf").write_text(json.dumps(document))
    return folder / "avatar.gltf"


@pytest.mark.parametrize("buffers", [1, 2])
@pytest.mark.parametrize("out", ["avatar/out.gltf", "elsewhere.gltf", "avatar/out.glb", "elsewhere.glb"])
def test_gltf_with_files_beside_it(tmp_path, performance, modules, out, buffers):
    path = gltf_with_files(tmp_path / "avatar", buffers)
    before = {file.name: file.read_bytes() for file in path.parent.iterdir()}
    assert not any("skin.png" in line for line in Avatar(path).write(tmp_path / out, performance))
    assert {file.name: file.read_bytes() for file in path.parent.iterdir() if file.name in before} == before
    same_place = out == "avatar/out.gltf"
    old, new = web.validation(modules, path, tmp_path / out)
    assert [code for code in new if code not in old] in ([], ["DATA_URI_GLB"] * (buffers - 1))
    if not same_place:
        for file in before:
            (path.parent / file).unlink()
    again = Avatar(tmp_path / out)
    np.testing.assert_allclose(again.character.neutral[: len(head()[0])], 1000 * head()[0], atol=0.01)
    picture = again.file.items("images")[0]
    if same_place:
        assert picture == {"uri": "my%20skin.png"} and again.file.items("buffers")[0]["uri"] == "data.bin"
    elif out.endswith("glb"):
        assert picture["mimeType"] == "image/png" and "uri" not in picture
    else:
        assert base64.b64decode(picture["uri"].partition(",")[2])[:4] == b"\x89PNG"


def test_a_missing_picture_is_said_and_left(tmp_path, performance):
    path = gltf_with_files(tmp_path / "avatar")
    (path.parent / "my skin.png").unlink()
    said = Avatar(path).write(tmp_path / "out.glb", performance)
    assert any("my skin.png" in line and "no such file" in line for line in said)
    assert parsed(tmp_path / "out.glb")[0]["images"] == [{"uri": "my%20skin.png"}]


def test_a_glb_becomes_gltf_where_that_is_asked_for(tmp_path, performance, modules):
    path = avatar("VRMC_vrm").save(tmp_path / "a.vrm")
    Avatar(path).write(tmp_path / "out.gltf", performance)
    before, after = web.validation(modules, path, tmp_path / "out.gltf")
    assert [code for code in after if code not in before] == []
    np.testing.assert_allclose(Avatar(tmp_path / "out.gltf").character.neutral, Avatar(path).character.neutral)


@pytest.mark.parametrize(
    ("name", "out", "reason"),
    [
        ("a.glb", "a.glb", "also read"),
        ("a.glb", "out.vrm", "must end in .glb or .gltf"),
        ("a.vrm", "out.obj", ".vrm"),
        ("a.vrm", "a.vrm", "also read"),
    ],
)
def test_names_that_are_refused(tmp_path, performance, name, out, reason):
    path = avatar("VRMC_vrm" if name.endswith("vrm") else "").save(tmp_path / name)
    before = path.read_bytes()
    with pytest.raises((ParameterError, AdaptiveFaceError), match=reason):
        Avatar(path).write(tmp_path / out, performance)
    assert path.read_bytes() == before and len(list(tmp_path.iterdir())) == 1


def test_a_scene_without_faces_is_refused(tmp_path):
    glb = plain_head()
    glb.document["scenes"] = [{"nodes": []}]
    with pytest.raises(FileFormatError, match=r"a\.glb"):
        Avatar(glb.save(tmp_path / "a.glb"))


def test_the_command_writes_the_avatar(tmp_path, capsys):
    from export_scene import tracked_result

    actor, result, _ = tracked_result()
    actor.save(tmp_path / "actor.npz")
    result.save(tmp_path / "result.npz")
    path = avatar("VRMC_vrm").save(tmp_path / "me.vrm")
    assert cli.main(["export", str(tmp_path / "result.npz"), "--character", str(path), "--smooth"]) == 0
    out = tmp_path / "result-me.glb"
    assert f"{out}: me, " in capsys.readouterr().out
    unchanged(path, out)
    assert len(tracks(out)["Head", "rotation"]) == len(result)


# ---- meshes that stay closed ----


@pytest.mark.parametrize("name", ["ready_player_me_draco.glb", "vroid_meshopt.glb", "ready_player_me.glb"])
@pytest.mark.parametrize("library", [True, False])
def test_peoples_avatars_are_passed_on(tmp_path, performance, modules, monkeypatch, name, library):
    if not AVATARS.is_dir():
        pytest.skip(f"no avatars at {AVATARS}")
    if library:
        pytest.importorskip("DracoPy"), pytest.importorskip("meshopt")
    else:
        monkeypatch.setattr(compressed, "_library", lambda name: None)
    path = AVATARS / name
    person = Avatar(path)
    assert (person.face is None) == (not library and name != "ready_player_me.glb")
    person.write(tmp_path / "out.glb", performance)
    unchanged(path, tmp_path / "out.glb")
    before, after = web.validation(modules, path, tmp_path / "out.glb")
    assert after == before
    moved = tracks(tmp_path / "out.glb")
    assert {("Head", "rotation"), ("Neck", "rotation")} <= moved.keys()
    if person.face is None:
        assert any("unopened" in note and "pip install" in note for note in person.character.notes)


@pytest.mark.parametrize(("extension", "opened"), [("KHR_texture_basisu", True), ("ACME_secret_geometry", False)])
def test_extensions_that_we_do_not_know(tmp_path, performance, extension, opened):
    glb = avatar()
    glb.document |= {"extensionsUsed": [extension], "extensionsRequired": [extension]}
    path = glb.save(tmp_path / "a.glb")
    person = Avatar(path)
    person.write(tmp_path / "out.glb", performance)
    unchanged(path, tmp_path / "out.glb")
    assert (person.face is not None) == opened
    if not opened:
        with pytest.raises(FileFormatError, match=extension):
            load_character(path)


@pytest.mark.parametrize("seed", range(150))
def test_mutated_avatars_are_written_or_end_in_one_clear_error(tmp_path, performance, seed):
    glb = vrm_with_presets(("VRM", "VRMC_vrm")[seed % 2]) if seed % 3 else avatar()
    for _ in range(1 + seed % 3):
        glb.document = _mutated_json(glb.document, np.random.default_rng([seed, 0xA7A]))
    chunk = json.dumps(glb.document).encode()
    path, out = tmp_path / "bad.glb", tmp_path / "out.glb"
    path.write_bytes(pack(chunk, bytes(glb.binary)))
    try:
        Avatar(path).write(out, performance)
    except AdaptiveFaceError as error:
        assert "bad.glb" in str(error) and "\n" not in str(error) and not out.exists()
    else:
        assert parsed(out)[0]["animations"][-1]["name"] == ANIMATION


# ---- three.js ----


def played(folder: Path, modules: Path, file: Path, bone: str | None, times: list[float]) -> tuple[dict, list[np.ndarray]]:
    answer = web.ask(folder / "page", modules, page(f"x{file.suffix}", times, bone), {f"x{file.suffix}": file})
    return answer, [web.picture(f["picture"], folder / f"{n}.png") for n, f in enumerate(answer["frames"])]


def angle(a: list[float], b: list[float]) -> float:
    """Degrees between two quaternions."""
    return float(np.degrees((Rotation.from_quat(a).inv() * Rotation.from_quat(b)).magnitude()))


@pytest.mark.parametrize("kind", ["", "VRM", "VRMC_vrm"])
def test_three_vrm_plays_it_with_its_texture(tmp_path, performance, modules, kind):
    file = tmp_path / ("out.vrm" if kind else "out.glb")
    glb = vrm_with_presets(kind) if kind else avatar()
    Avatar(glb.save(tmp_path / "a.glb")).write(file, performance)
    answer, pictures = played(tmp_path, modules, file, "Head", [0.0, 0.999])
    assert answer["vrm"] == {"": None, "VRM": "0", "VRMC_vrm": "1"}[kind]
    assert answer["moved"][1] > 0.02  # the jaw opens by 30 mm
    assert angle(answer["frames"][0]["head"], answer["frames"][1]["head"]) == pytest.approx(
        np.degrees(Rotation.from_matrix(turns(np.array([1.0]))).magnitude()[0]), abs=0.1
    )
    index = list(head()[3]).index("jawOpen")
    assert answer["frames"][1]["weights"]["Face"][index] == pytest.approx(0.999, abs=1e-3)
    for picture in pictures:  # the face has the blue of its texture, the picture's middle above all
        blue = (picture[..., 2] > picture[..., 0].astype(int) + 40) & (picture[..., 2] > 60)
        assert blue.mean() > 0.03 and blue[180:240, 180:240].mean() > 0.5, TEXTURE
    assert (np.abs(pictures[0].astype(int) - pictures[1]) > 24).any(axis=2).sum() > 300


@pytest.mark.parametrize(
    ("name", "bone", "pixels"),
    [
        ("ready_player_me.glb", "Head", 3000),
        ("ready_player_me_draco.glb", "Head", 3000),
        ("vroid_meshopt.glb", "Head", 3000),
        ("raccoon", "head_geo002", 3000),
    ],
)
def test_three_js_plays_avatars_of_three_makers(tmp_path, performance, modules, name, bone, pixels):
    path = modules / RACCOON[1] if name == "raccoon" else AVATARS / name
    if not path.is_file():
        pytest.skip(f"no avatar at {path}")
    Avatar(path).write(tmp_path / "out.glb", performance)
    assert web.validation(modules, path, tmp_path / "out.glb")[0] == web.validation(modules, tmp_path / "out.glb")[0]
    answer, pictures = played(tmp_path, modules, tmp_path / "out.glb", bone, [0.0, 0.5, 0.999])
    assert answer["textured"] and max(answer["moved"]) > 0.01
    whole = np.degrees(Rotation.from_matrix(turns(np.array([1.0]))).magnitude()[0])
    assert angle(answer["frames"][0]["head"], answer["frames"][2]["head"]) == pytest.approx(whole, abs=0.2)
    assert (np.abs(pictures[0].astype(int) - pictures[2]) > 24).any(axis=2).sum() > pixels
    assert len(np.unique(pictures[1].reshape(-1, 3) // 16, axis=0)) > 60  # a texture, not one colour of clay


def test_glb_builder_is_valid(tmp_path, modules):
    """The avatars made for these tests are what they claim to be."""
    files = [avatar(kind).save(tmp_path / f"a{kind}.glb") for kind in ("", "VRM", "VRMC_vrm")]
    own_name = ["INVALID_EXTENSION_NAME_FORMAT"]  # what the validator says to every VRM 0.x file
    assert web.validation(modules, *files) == [[], own_name, []]
    assert isinstance(avatar(), Glb) and len(SKELETON) == 18
