"""Gaze from irises: known directions come back, closed and turned eyes are unknown, and everything that looks follows."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from export_scene import tracked_result

from adaptiveface.export.animation import actor_animation
from adaptiveface.export.inside_parts import actor_insides, with_insides
from adaptiveface.geometry.camera import Camera
from adaptiveface.geometry.frame import IRIS_CENTRES, DetectedFace, Features2D, RgbdFrame
from adaptiveface.geometry.mesh import rotation_vector_matrix, surface_points, transform_points
from adaptiveface.insides import make_insides
from adaptiveface.insides.gaze import GazeEstimator, GazeTrack
from adaptiveface.insides.head import gaze_rotation
from adaptiveface.insides.parts import CORNEA
from adaptiveface.landmarks.irises import IrisFinder
from adaptiveface.livelink import ARKIT_NAMES
from adaptiveface.livelink.convention import eye_angles, eyes_of_gaze, with_look
from adaptiveface.result import Result
from adaptiveface.retargeting.retarget import retarget

CAMERA = Camera(640, 480, 570.0, 570.0, 319.5, 239.5)


@pytest.fixture(scope="module")
def scene():
    return tracked_result()[:2]


def head_pose(turn=(0.0, 0.0, 0.0)) -> np.ndarray:
    pose = np.eye(4)
    pose[:3, :3] = np.diag([1.0, -1.0, -1.0]) @ rotation_vector_matrix(np.array(turn))
    pose[:3, 3] = [20.0, -10.0, 600.0]
    return pose


def seen(actor, pose: np.ndarray, gaze: np.ndarray, shift=(0.0, 0.0), closed=()) -> Features2D:
    """What a perfect detector says of eyes that look along ``gaze`` (2, 2); ``shift`` px of everything it finds."""
    insides = make_insides(actor.neutral, actor.triangles)
    marks = surface_points(actor.neutral, actor.feature_triangles, actor.feature_weights)
    pixels = CAMERA.project(transform_points(pose, marks)) + shift
    for upper, lower in closed:
        pixels[upper - 28] = pixels[lower - 28]  # iBUG 36 is the ninth feature
    mesh = np.zeros((478, 3))
    for side, number in enumerate(IRIS_CENTRES):
        arm = gaze_rotation(*gaze[side]) @ [0.0, 0.0, (1 + CORNEA) * insides.eye_radii[side]]
        mesh[number, :2] = CAMERA.project(transform_points(pose, (insides.eye_centres[side] + arm)[None]))[0] + shift
    return Features2D(pixels, np.full(40, 0.3), DetectedFace(mesh))


@pytest.mark.parametrize("turn", [(0.0, 0.0, 0.0), (0.1, 0.4, 0.0), (-0.2, -0.3, 0.2)])
def test_a_known_gaze_comes_back_however_the_head_is_turned(scene, turn):
    actor, pose = scene[0], head_pose(turn)
    gaze = np.array([[0.25, 0.12], [0.2, 0.12]])
    measured = GazeEstimator(actor).measure(actor.neutral, pose, CAMERA, seen(actor, pose, gaze))
    np.testing.assert_allclose(measured, gaze, atol=1e-6)


def test_a_detector_that_is_off_by_pixels_does_not_turn_the_eyes(scene):
    actor, pose = scene[0], head_pose()
    gaze = np.array([[-0.2, -0.1], [-0.2, -0.1]])
    measured = GazeEstimator(actor).measure(actor.neutral, pose, CAMERA, seen(actor, pose, gaze, shift=(3.0, -2.0)))
    np.testing.assert_allclose(measured, gaze, atol=1e-6)


def test_closed_turned_and_unseen_eyes_are_unknown(scene):
    actor, pose, straight = scene[0], head_pose(), np.zeros((2, 2))
    estimator = GazeEstimator(actor)
    shut = estimator.measure(actor.neutral, pose, CAMERA, seen(actor, pose, straight, closed=((43, 47), (44, 46))))
    assert np.isnan(shut[0]).all() and np.isfinite(shut[1]).all()
    features = seen(actor, pose, straight)
    away = replace(features, confidence=np.zeros(40))
    bare = replace(features, face=DetectedFace(features.face.mesh[:468]))
    one = replace(features, face=None, irises=np.vstack([features.iris_centres[0], [np.nan, np.nan]]))
    half = estimator.measure(actor.neutral, pose, CAMERA, one)
    assert np.isfinite(half[0]).all() and np.isnan(half[1]).all()
    for found in (away, bare, replace(features, face=None), None):
        assert np.isnan(estimator.measure(actor.neutral, pose, CAMERA, found)).all()
    assert not GazeEstimator(replace(actor, triangles=actor.triangles[:-1])).available


def test_what_is_unknown_is_held_and_jumps_pass(scene):
    track = GazeTrack(scene[0])
    unknown, left = np.full((2, 2), np.nan), np.array([[0.3, 0.0], [0.3, 0.0]])
    assert track.arrays() == {}
    for measured in (unknown, left, unknown, None, left - 0.4, left - 0.41):
        track.add(measured)
    found = track.arrays()
    np.testing.assert_allclose(found["gaze"][:4, 0, 0], [0.0, 0.3, 0.3, 0.3], atol=1e-6)
    assert found["gaze"][4, 0, 0] == pytest.approx(-0.1)  # a jump, at once
    assert -0.11 < found["gaze"][5, 0, 0] < -0.1  # jitter, calmed
    assert found["gaze_known"].all(axis=1).tolist() == [False, True, False, False, True, True]


def test_one_eye_stands_for_both(scene):
    track = GazeTrack(scene[0])
    np.testing.assert_allclose(track.add(np.array([[np.nan, np.nan], [0.2, 0.1]])), [[0.2, 0.1], [0.2, 0.1]])


def test_eye_curves_and_angles_say_the_same():
    gaze = np.array([[[0.3, -0.2], [0.25, -0.2]], [[-0.1, 0.3], [-0.15, 0.3]]])
    eyes = eyes_of_gaze(gaze)
    curves = with_look(np.full((2, 52), 0.5), eyes)
    np.testing.assert_allclose(eye_angles(curves), eyes, atol=1e-12)
    level = dict(zip(ARKIT_NAMES, curves[0], strict=True))
    assert level["eyeLookOutLeft"] > 0.4 and level["eyeLookInRight"] > 0.4  # to the subject's left
    assert level["eyeLookDownLeft"] > 0.3 and level["eyeLookUpLeft"] == 0.0 and level["jawOpen"] == 0.5


def looking(result: Result) -> Result:
    gaze = np.zeros((len(result), 2, 2), np.float32)
    gaze[:, :, 0] = 0.3 * np.sin(np.arange(len(result)))[:, None]
    return replace(result, gaze=gaze, gaze_known=np.ones((len(result), 2), bool))


def test_results_keep_it_and_old_ones_load(scene, tmp_path):
    result = looking(scene[1])
    result.save(tmp_path / "new.npz")
    scene[1].save(tmp_path / "old.npz")
    np.testing.assert_array_equal(Result.load(tmp_path / "new.npz").gaze, result.gaze)
    assert Result.load(tmp_path / "new.npz").gaze_known.all()
    assert Result.load(tmp_path / "old.npz").gaze is None
    assert result[3:7].gaze.shape == (4, 2, 2)


def test_curves_and_eyeballs_follow_it(scene):
    actor, result = scene[0], looking(scene[1])
    performance = retarget(result)
    np.testing.assert_allclose(performance.eyes[:, 0], -result.gaze[:, 0, 0], atol=1e-6)
    assert np.ptp(performance.curves[:, ARKIT_NAMES.index("eyeLookOutLeft")]) > 0.4
    assert retarget(scene[1]).eyes is None
    inside = with_insides(actor_animation(result, actor), result, actor).inside
    insides, ball = actor_insides(result, actor), slice(0, len(make_insides(actor.neutral, actor.triangles).eyeball))
    for frame in (2, 5):
        points = inside.shape(frame)[ball]
        axis = points[0] - points[-1]
        assert np.arctan2(axis[0], axis[2]) == pytest.approx(result.gaze[frame, 0, 0], abs=0.01)
        assert len(insides.colours) == len(inside.neutral)


def test_a_frame_gives_its_gaze(scene):
    actor, pose = scene[0], head_pose()
    gaze = np.array([[0.1, 0.2], [0.1, 0.2]])
    frame = RgbdFrame(np.zeros((480, 640), np.float32), CAMERA, features=seen(actor, pose, gaze))
    tracked = SimpleNamespace(tracked=True, v4=actor.neutral, head_pose=pose)
    np.testing.assert_allclose(GazeTrack(actor).see(tracked, frame), gaze, atol=1e-6)
    lost = SimpleNamespace(tracked=False)
    np.testing.assert_array_equal(GazeTrack(actor).see(lost, frame), 0)


def test_irises_are_found_beside_features_that_come_without(scene):
    actor, pose = scene[0], head_pose()
    gaze = np.array([[0.1, 0.2], [0.1, 0.2]])
    known = seen(actor, pose, gaze)
    bare = RgbdFrame(
        np.zeros((480, 640), np.float32), CAMERA, np.zeros((480, 640, 3), np.uint8), features=replace(known, face=None)
    )
    detector = SimpleNamespace(detect=lambda frame: seen(actor, pose, gaze, shift=(2.0, -3.0)), close=lambda: None)
    finder = IrisFinder(detector)
    frame = finder.onto(bare)
    assert frame.features.pixels is bare.features.pixels
    np.testing.assert_allclose(frame.features.irises, known.iris_centres)  # that the detector is off by pixels does not count
    tracked = SimpleNamespace(tracked=True, v4=actor.neutral, head_pose=pose)
    np.testing.assert_allclose(GazeTrack(actor).see(tracked, frame), gaze, atol=1e-6)
    colourless = replace(bare, colour=None)
    assert finder.onto(colourless) is colourless


def test_results_take_it_even_where_the_last_frame_was_interrupted(scene):
    actor, result = scene
    track = GazeTrack(actor)
    assert track.onto(result) is result
    for _ in range(len(result) - 1):
        track.add(np.full((2, 2), 0.1))
    whole = track.onto(result)
    assert whole.gaze.shape == (len(result), 2, 2) and whole.gaze[-1] == pytest.approx(0.1)


def test_a_stream_looks_where_the_irises_do(scene, monkeypatch):
    from adaptiveface.export.stream import Sender, Streamer

    sent = []
    monkeypatch.setattr(Sender, "send", lambda self, state: sent.append(state))
    actor, pose = scene[0], head_pose()
    gaze = np.array([[0.3, -0.1], [0.3, -0.1]])
    frame = RgbdFrame(np.zeros((480, 640), np.float32), CAMERA, features=seen(actor, pose, gaze))
    tracked = SimpleNamespace(tracked=True, v4=actor.neutral, head_pose=pose, timestamp=0.0, coefficients=np.zeros(23))
    streamer = Streamer(actor)
    streamer.send(tracked)
    streamer.send(tracked, frame)
    assert sent[0].eyes is None
    np.testing.assert_allclose(sent[1].eyes, eyes_of_gaze(gaze), atol=1e-6)
    assert sent[1].curves[ARKIT_NAMES.index("eyeLookOutLeft")] == pytest.approx(0.3 / 0.605, abs=1e-6)
