"""Eyes, teeth and tongue: they stay behind the skin, follow jaw and gaze, and come along in every export."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from export_scene import tracked_result
from inside_check import outside, parts_of
from written import read_glb_animation, read_obj_sequence, read_point_cache

from adaptiveface.export.animation import actor_animation
from adaptiveface.export.gltf import write_glb
from adaptiveface.export.inside_parts import TOLERANCE, actor_insides, with_insides
from adaptiveface.export.obj_sequence import write_obj_sequence
from adaptiveface.export.point_cache import write_point_cache
from adaptiveface.export.video import PANEL, tracked_panel
from adaptiveface.formats.gltf.file import GltfFile
from adaptiveface.geometry.frame import FEATURE_IDS
from adaptiveface.geometry.mesh import rotation_vector_matrix, surface_points
from adaptiveface.insides import make_insides
from adaptiveface.model.face_model import embedded_face_model
from adaptiveface.report.pictures import Portraits


@pytest.fixture(scope="module")
def model():
    return embedded_face_model()


@pytest.fixture(scope="module")
def scene():
    """Actor, result, its animated mesh without and with the parts."""
    actor, result, _ = tracked_result()
    mesh = actor_animation(result, actor)
    return actor, result, mesh, with_insides(mesh, result, actor)


def person(model, seed: int) -> np.ndarray:
    """(N, 3) mm: someone's neutral head."""
    return model.neutral(np.clip(np.random.default_rng(seed).normal(0, 0.9, len(model.identity_modes)), -2.2, 2.2))


#: Millimetres: rounding.
NOTHING = 1e-6
#: The expressions that bring skin nearest to eyes and teeth.
CLOSE = ("mouthRoll", "mouthPucker", "mouthRight", "jawOpen", "eyeBlinkLeft")


def poking(model, neutral: np.ndarray, step: int = 1, names=None) -> dict[tuple[str, str], float]:
    """(part, expression) -> mm by which it comes through the skin, of some or of all generic expressions."""
    insides = make_insides(neutral, model.triangles)
    found = {}
    for name in names or ("neutral", *model.generic_names):
        shape = 0.0 if name == "neutral" else model.generic_expressions[model.generic_names.index(name)]
        points = insides.at(neutral + shape)
        for part, rows in parts_of(insides).items():
            found[part, name] = float(outside(points[rows][::step], neutral + shape, model.triangles).max())
    return found


def test_nothing_comes_through_the_skin_of_the_mean_head(model):
    found = poking(model, model.mean, step=12, names=CLOSE)
    assert len(found) == 5 * len(CLOSE)
    assert max(found.values()) < NOTHING, max(found, key=found.get)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(5))
def test_nothing_comes_through_the_skin_of_anyone(model, seed):
    found = poking(model, person(model, seed), step=3)
    assert max(found.values()) < NOTHING, max(found, key=found.get)


def test_the_check_sees_what_comes_through(model):
    insides = make_insides(model.mean, model.triangles)
    forward = insides.at(model.mean)[parts_of(insides)["upper teeth"]] + [0.0, 5.0, 16.0]
    assert outside(forward[::6], model.mean, model.triangles).max() > 1.0


def test_an_eyeball_gives_way_to_a_lid_that_presses_on_it(model):
    insides = make_insides(model.mean, model.triangles)
    pressed = model.mean.copy()
    pressed[model.mean[:, 0] > 0, 2] -= 2.5
    assert insides.retreat(model.mean, 0) == insides.retreat(model.mean, 1) == insides.retreat(pressed, 1) == 0.0
    assert 0.5 < insides.retreat(pressed, 0) <= 2.5
    behind = insides.at(pressed)[parts_of(insides)["left eye"]]
    assert outside(behind[::6], pressed, model.triangles).max() == 0.0


def test_lower_teeth_follow_the_jaw_and_upper_ones_stay(model):
    insides = make_insides(model.mean, model.triangles)
    parts = parts_of(insides)
    jaw = model.generic_expressions[model.generic_names.index("jawOpen")]
    moved = insides.at(model.mean + jaw) - insides.at(model.mean)
    chin = jaw[insides.jaw.chin].mean(axis=0)
    front = moved[parts["lower teeth, tongue"]][: len(insides.upper)]
    assert front[:, 1].min() < 0.6 * chin[1] < -10
    assert not moved[parts["upper teeth"]].any()


def test_eyeballs_turn_by_the_gaze(model):
    insides = make_insides(model.mean, model.triangles)
    parts = parts_of(insides)
    gaze = np.array([[0.3, 0.0], [0.0, -0.2]])
    turned = insides.at(model.mean, gaze)
    for side, name in enumerate(("left eye", "right eye")):
        yaw, pitch = gaze[side]
        pupil = turned[parts[name]][0] - turned[parts[name]][[0, -1]].mean(axis=0)
        expected = [np.cos(pitch) * np.sin(yaw), np.sin(pitch), np.cos(pitch) * np.cos(yaw)]
        np.testing.assert_allclose(pupil / np.linalg.norm(pupil), expected, atol=1e-9)


def iris_place(neutral: np.ndarray, insides, side: int) -> float:
    """Where the pupil of an eye that looks ahead lies between the lids: 0 at the lower, 1 at the upper one."""
    centre, rim = insides.eye_centres[side], neutral[insides.lid_loops[side]]
    near = rim[np.abs(rim[:, 0] - centre[0]) < 5.0, 1]
    return float((centre[1] - near.min()) / np.ptp(near))


@pytest.mark.parametrize("degrees", (-20, 0, 20))
def test_eyes_that_look_ahead_look_ahead_whatever_slope_the_lids_have(model, degrees):
    neutral = person(model, 3)
    turn = rotation_vector_matrix(np.radians([degrees, 0.0, 0.0]))
    for loop in make_insides(neutral, model.triangles).lid_loops:
        middle = neutral[loop].mean(axis=0)
        neutral[loop] = (neutral[loop] - middle) @ turn.T + middle
    insides = make_insides(neutral, model.triangles)
    assert all(0.5 < iris_place(neutral, insides, side) < 0.62 for side in (0, 1))


@pytest.mark.parametrize("seed", range(3))
def test_lips_at_rest_cover_the_teeth(model, seed):
    neutral = person(model, seed)
    insides = make_insides(neutral, model.triangles)
    marks = surface_points(neutral, model.feature_triangles, model.feature_weights)
    upper, lower = (marks[list(FEATURE_IDS).index(number)] for number in (62, 66))
    parts, points = parts_of(insides), insides.at(neutral)
    assert points[parts["upper teeth"]][:, 1].min() > upper[1]
    assert points[parts["lower teeth, tongue"]][: len(insides.upper), 1].max() < lower[1]


def test_the_mouth_opens_behind_lips_that_cross_in_the_neutral(model):
    """Fitted to a smile, the lips of a neutral may cross: the mouth was inside out then, and hid the teeth."""
    usual = make_insides(model.mean, model.triangles)
    rim = usual.mouth_loop
    upper = usual.mouth_height > 0
    crossed = model.mean.copy()
    crossed[rim[upper], 1] -= 2.0
    crossed[rim[~upper], 1] += 2.0
    insides = make_insides(crossed, model.triangles)
    behind = insides.at(crossed)[parts_of(insides)["mouth"]][: len(rim)]  # the ring next to the lips
    widened = behind[:, 1] - crossed[rim, 1]
    assert widened[upper].min() > 0.0 > widened[insides.mouth_height < 0].max()
    lip = model.generic_expressions[model.generic_names.index("mouthUpperUp")][rim, 1]
    assert lip[upper].mean() > 2.0 > 1.0 > lip[~upper].mean()


def test_meshes_of_other_models_have_no_parts(model):
    assert make_insides(model.mean, model.triangles[:-1]) is None


def test_the_parts_move_as_they_should_and_the_skin_is_what_it_was(scene):
    actor, result, plain, whole = scene
    assert whole.targets is plain.targets
    insides = actor_insides(result, actor)
    frames = np.arange(0, len(result), 5)
    for frame, skin in zip(frames, result.head_meshes(frames), strict=True):
        off = np.linalg.norm(whole.inside.shape(frame) - insides.at(skin), axis=1).max()
        assert off <= 1.01 * TOLERANCE
    assert whole.inside.weights.min() >= 0
    assert whole.inside.weights.max() <= 1 + 1e-9


@pytest.mark.parametrize("compact", [False, True])
def test_glb_carries_the_parts_and_is_read_as_before(scene, tmp_path, compact):
    _, _, plain, whole = scene
    write_glb(tmp_path / "plain.glb", plain, compact)
    write_glb(tmp_path / "whole.glb", whole, compact)
    with_parts, without = read_glb_animation(tmp_path / "whole.glb"), read_glb_animation(tmp_path / "plain.glb")
    atol = 0.02 if compact else 0.0  # its step is that of the largest of both meshes
    np.testing.assert_allclose(with_parts.neutral, without.neutral, atol=atol)
    np.testing.assert_allclose(with_parts.shape(3), without.shape(3), atol=2.5 * atol)
    file = GltfFile(tmp_path / "whole.glb")
    nodes = file.items("nodes")
    assert [node["name"] for node in nodes] == ["performance", "head", "insides"]
    assert "children" not in nodes[1]  # three.js would give the head's weights to them
    assert {k: nodes[2].get(k) for k in ("translation", "rotation", "scale")} == {
        k: nodes[1].get(k) for k in ("translation", "rotation", "scale")
    }
    assert file.items("animations")[0]["channels"][-1]["target"]["node"] == 1  # early readers take the last weights


def test_usd_carries_the_parts_and_is_read_as_before(scene, tmp_path):
    usd = pytest.importorskip("pxr.Usd", exc_type=ImportError)
    from pxr import UsdGeom, UsdSkel
    from written import read_usd

    from adaptiveface.export.usd import write_usd

    _, _, plain, whole = scene
    write_usd(tmp_path / "whole.usdc", whole)
    back = read_usd(tmp_path / "whole.usdc")
    assert back.target_names == plain.target_names
    np.testing.assert_allclose(back.shape(7), plain.shape(7), atol=2e-3)
    stage = usd.Stage.Open(str(tmp_path / "whole.usdc"))
    UsdSkel.BakeSkinning(stage.Traverse())
    bodies = [UsdGeom.Mesh(prim) for prim in stage.Traverse() if prim.IsA(UsdGeom.Mesh)]
    assert len(bodies) == 2
    place = np.array(UsdGeom.XformCache(7).GetLocalToWorldTransform(bodies[1].GetPrim()))
    points = np.array(bodies[1].GetPointsAttr().Get(7), float) @ place[:3, :3] + place[3, :3]
    np.testing.assert_allclose(1e3 * points, whole.inside.shape(7, posed=True) - whole.centre, atol=2e-3)


def test_obj_and_caches_have_the_parts_behind_the_skin(scene, tmp_path):
    _, _, plain, whole = scene
    short = [replace(m, weights=m.weights[:2], timestamps=m.timestamps[:2], head_pose=m.head_pose[:2]) for m in (plain, whole)]
    inside = whole.inside
    short[1] = replace(
        short[1],
        inside=replace(inside, weights=inside.weights[:2], timestamps=inside.timestamps[:2], head_pose=inside.head_pose[:2]),
    )
    n = len(plain.neutral)
    meshes = []
    for name, mesh in zip("ab", short, strict=True):
        write_obj_sequence(tmp_path / name, mesh, "mm")
        write_point_cache(tmp_path / f"{name}.pc2", mesh, "mm")
        meshes.append((*read_obj_sequence(tmp_path / name), read_point_cache(tmp_path / f"{name}.pc2")))
    np.testing.assert_array_equal(meshes[1][0][:, :n], meshes[0][0])
    np.testing.assert_array_equal(meshes[1][1][: len(plain.triangles)], meshes[0][1])
    np.testing.assert_array_equal(meshes[1][2][:, :n], meshes[0][2])
    assert meshes[1][0].shape[1] == meshes[1][2].shape[1] == n + len(inside.neutral)


def test_films_and_portraits_show_them(scene):
    actor, result, _, _ = scene
    bare, full = tracked_panel(result)(5), tracked_panel(result, actor_insides(result, actor))(5)
    assert bare.shape == full.shape == (PANEL, PANEL, 3)
    assert 50 < (bare != full).any(axis=2).sum() < 0.1 * PANEL**2
    portraits = Portraits(actor, (230, 260))
    opened = actor.neutral + actor.blendshapes[actor.expression_names.index("jawOpen")]
    picture = portraits.draw(opened)[..., :3].astype(int)
    white = (picture.min(axis=2) > 150) & (np.ptp(picture, axis=2) < 35)  # sclera and teeth, which skin is not
    assert white.sum() > 60


def test_the_command_leaves_them_out_when_asked(scene, tmp_path):
    actor, result, _, _ = scene
    result.save(tmp_path / "result.npz")
    actor.save(tmp_path / "actor.npz")
    names = []
    for options in ([], ["--no-insides"]):
        command = [sys.executable, "-m", "adaptiveface", "export", str(tmp_path / "result.npz"), *options]
        subprocess.run([*command, "--out", str(tmp_path / "x.glb")], check=True, capture_output=True, timeout=120)
        names.append([entry["name"] for entry in GltfFile(tmp_path / "x.glb").items("meshes")])
    assert names == [["actor", "insides"], ["actor"]]
