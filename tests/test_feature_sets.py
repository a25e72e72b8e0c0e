"""Feature sets: the detector's landmarks on the face model, in actors and in the tracker without depth."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from adaptiveface.errors import FileFormatError
from adaptiveface.geometry.camera import Camera
from adaptiveface.geometry.expression_names import SCORE_NAMES
from adaptiveface.geometry.frame import LANDMARKS, DetectedFace, Features2D, RgbdFrame
from adaptiveface.geometry.mesh import rigid_alignment, rotation_vector_matrix, surface_points, transform_points
from adaptiveface.live.statistics import LiveStatistics
from adaptiveface.model.actor import Actor
from adaptiveface.model.face_model import embedded_face_model
from adaptiveface.model.feature_set import MIDDLE, NOD, TURN, opening_of, pitch_of, yaw_of
from adaptiveface.neutral.capture import build_actor
from adaptiveface.neutral.colour import NEAREST, USUAL, capture_colour, scored_coefficients
from adaptiveface.parameters import Parameters
from adaptiveface.report import write_report
from adaptiveface.result import Result, ResultBuilder
from adaptiveface.synthetic.script import HeadMotion
from adaptiveface.tracking.colour_tracker import ColourTracker

MODEL = embedded_face_model()
SET = MODEL.landmarks
CAMERA = Camera(640, 480, 600.0, 600.0, 319.5, 239.5)
NAMES = list(MODEL.generic_names)


def seen(head: np.ndarray, x: np.ndarray, pose: np.ndarray, index: int = 0, noise: float = 0.0, camera=CAMERA) -> RgbdFrame:
    """A frame of the landmarks alone, as a detector without errors but white noise (px) returns them."""
    skin = head + np.tensordot(x, MODEL.generic_expressions, axes=1)
    rng = np.random.default_rng(index)
    mesh = np.zeros((LANDMARKS, 3))
    points = SET.points(skin)
    pixels = camera.project(transform_points(pose, points)) + SET.slides(pose, camera, points, opening_of(NAMES, x))
    mesh[SET.ids, :2] = pixels + noise * rng.standard_normal(pixels.shape)
    scores = x @ MODEL.generic_weights
    forty = camera.project(transform_points(pose, surface_points(skin, MODEL.feature_triangles, MODEL.feature_weights)))
    face = DetectedFace(mesh, np.array([dict(zip(MODEL.expression_names, scores, strict=True))[n] for n in SCORE_NAMES]))
    features = Features2D(forty, np.full(40, 0.3), face)
    return RgbdFrame(np.zeros((1, 1), np.float32), camera, None, index, index / 30, features)


def expression(**strengths: float) -> np.ndarray:
    x = np.zeros(len(NAMES))
    for name, strength in strengths.items():
        x[NAMES.index(name)] = strength
    return x


def poses(count: int, distance: float = 600.0):
    motion = HeadMotion(3, 0, 30.0, distance)
    return [motion.pose(60 + 4 * k) for k in range(count)]


@pytest.fixture(scope="module")
def identity():
    return np.clip(np.random.default_rng(5).normal(0, 0.7, len(MODEL.identity_modes)), -2, 2)


def difference(a: np.ndarray, b: np.ndarray) -> float:
    """Root mean square distance, mm, of two heads' faces after alignment."""
    a, b = a[MODEL.frontal], b[MODEL.frontal]
    return float(np.sqrt(((transform_points(rigid_alignment(a, b), a) - b) ** 2).sum(axis=1).mean()))


def test_the_set_lies_on_the_face_and_names_its_regions():
    points = SET.points(MODEL.mean)
    nose, chin, eyes = (points[SET.regions == name] for name in ("nose", "chin", "lids"))
    assert 150 < len(SET) < 250 and 20 <= SET.held_out.sum() <= 60
    assert set(SET.regions) == set(SET.regions[SET.held_out]) | {"oval"}  # the oval slides: nothing is measured by it
    assert nose[:, 2].max() > eyes[:, 2].max() + 10 and chin[:, 1].max() < nose[:, 1].min()
    left, right = (points[SET.ids == number][0] for number in (263, 33))  # the subject's left is +x
    assert left[0] > 20 and right[0] < -20 and abs(left[1] - right[1]) < 3
    assert (SET.deviation > 0.3).all() and (SET.personal > 0.1).all()


def test_contour_landmarks_count_less_on_the_side_that_turns_away():
    far = SET.deviations(35.0)[SET.ids == 132], SET.deviations(-35.0)[SET.ids == 132]
    assert max(far)[0] > 3 * SET.deviations(35.0)[SET.ids == 133][0]
    pose = HeadMotion(0, 0, 30.0, 600.0).pose(0)
    assert abs(yaw_of(pose)) < 1 and (SET.trust(pose) > 0).all()


def test_an_actor_keeps_its_landmarks_and_the_40_entry_arrays(tmp_path):
    actor = build_actor(MODEL, MODEL.mean)
    actor.save(tmp_path / "actor.npz")
    again = Actor.load(tmp_path / "actor.npz")
    assert again.feature_triangles.shape == (40, 3) and len(again.landmarks) == len(SET)
    np.testing.assert_allclose(again.landmarks.points(again.neutral), SET.points(MODEL.mean), atol=1e-3)
    np.testing.assert_allclose(again.landmarks.opened, SET.opened, atol=1e-5)
    without = dataclasses.replace(actor, landmarks=None)
    without.save(tmp_path / "old.npz")
    assert Actor.load(tmp_path / "old.npz").landmarks is None


def test_an_actor_of_an_older_version_leaves_no_landmark_behind(tmp_path):
    path = tmp_path / "actor.npz"
    build_actor(MODEL, MODEL.mean).save(path)
    arrays = dict(np.load(path))
    del arrays["landmark_opened"]
    np.savez(path, **arrays)
    assert not Actor.load(path).landmarks.opened.any()


@pytest.mark.parametrize(
    ("name", "change", "words"),
    [
        ("landmark_triangles", lambda a: a + 10**6, "landmark_triangles"),
        ("landmark_weights", lambda a: 2 * a, "barycentric"),
        ("landmark_ids", lambda a: a + 400, "numbers of landmarks"),
        ("landmark_yaw", lambda a: a[::-1].copy(), "landmark_yaw"),
        ("landmark_deviation", lambda a: -a, "not positive"),
        ("landmark_offset", None, "landmark_offset"),
    ],
)
def test_broken_landmarks_are_named(tmp_path, name, change, words):
    path = tmp_path / "actor.npz"
    build_actor(MODEL, MODEL.mean).save(path)
    arrays = dict(np.load(path))
    if change is None:
        del arrays[name]
    else:
        arrays[name] = change(arrays[name])
    np.savez(path, **arrays)
    with pytest.raises(FileFormatError, match=words):
        Actor.load(path)


def test_scores_become_the_coefficients_they_stand_for():
    x = expression(jawOpen=0.6, mouthSmileLeft=0.8, mouthSmileRight=0.8)
    found = scored_coefficients(seen(MODEL.mean, x, poses(1)[0]).features.face, MODEL)
    assert np.abs(found - x).max() < 0.15


def test_a_smile_from_the_first_frame_on_ends_at_the_same_head_as_a_neutral_start(identity):
    """The smile belongs to the frames, not to the person: heads within 1.5 mm rms, without any neutral frame in one take."""
    head = MODEL.neutral(identity)
    smile = expression(mouthSmileLeft=0.9, mouthSmileRight=0.9, mouthUpperUp=0.4)
    calm = [seen(head, 0 * smile, pose, k, 0.5) for k, pose in enumerate(poses(30))]
    smiling = [seen(head, (0.8 + 0.2 * np.sin(k)) * smile, pose, k, 0.5) for k, pose in enumerate(poses(30))]
    neutral, smiled = (capture_colour(frames).actor for frames in (calm, smiling))
    assert difference(neutral.neutral, smiled.neutral) < 1.5
    size = np.ptp(head[MODEL.frontal], axis=0)[1] / np.ptp(smiled.neutral[MODEL.frontal], axis=0)[1]  # nobody can know it
    assert 0.9 < size < 1.1 and difference(size * smiled.neutral, head) < difference(MODEL.mean, head)


def test_the_head_keeps_its_size_and_its_pose_while_the_mouth_opens(identity):
    head, pose = MODEL.neutral(identity), poses(1)[0]
    tracker, angles = ColourTracker(build_actor(MODEL, head, identity=identity)), []
    for k, opening in enumerate(np.concatenate([np.linspace(0, 0.9, 12), np.full(12, 0.9), np.linspace(0.9, 0, 12)])):
        tracked = tracker.track(seen(head, expression(jawOpen=opening), pose, k, 0.4))
        assert tracked.tracked and abs(tracked.head_pose[2, 3] / pose[2, 3] - 1) < 0.05
        angles.append(np.degrees(np.linalg.norm(tracked.head_pose[:3, :3] - pose[:3, :3]) / np.sqrt(2)))
    assert max(angles) < 1.0


def turned(yaw: float, pitch: float, distance: float = 600.0) -> np.ndarray:
    """(4, 4) a head that turns to its left and nods, degrees, about the middle of its landmarks."""
    pose, to_middle = np.eye(4), np.eye(4)
    pose[:3, :3] = np.diag([1.0, -1.0, -1.0]) @ rotation_vector_matrix(np.radians([pitch, yaw, 0.0]))
    pose[2, 3], to_middle[:3, 3] = distance, -MIDDLE
    return pose @ to_middle


def detected(frame: RgbdFrame, pixels: np.ndarray) -> RgbdFrame:
    """The frame with its landmarks seen at ``pixels`` (L, 2)."""
    mesh = frame.features.face.mesh.copy()
    mesh[SET.ids, :2] = pixels
    face = dataclasses.replace(frame.features.face, mesh=mesh)
    return dataclasses.replace(frame, features=dataclasses.replace(frame.features, face=face))


def off_by(pose: np.ndarray, other: np.ndarray) -> float:
    """Degrees between two poses."""
    return float(np.degrees(np.linalg.norm(pose[:3, :3] - other[:3, :3]) / np.sqrt(2)))


@pytest.mark.parametrize(("yaw", "pitch"), [(0.0, 18.0), (0.0, -18.0), (20.0, 0.0), (-15.0, 12.0)])
def test_a_detector_that_flattens_nods_does_not_flatten_the_head(yaw, pitch):
    """What it sees of a head that nods by 18 degrees is a head that nods by 15."""
    pose, flat = turned(yaw, pitch), turned((1 + TURN) * yaw, (1 + NOD) * pitch)
    assert yaw_of(pose) == pytest.approx(yaw, abs=3) and pitch_of(pose) == pytest.approx(pitch, abs=3)
    points = SET.points(MODEL.mean)
    moved = (SET.offset + points) @ pose[:3, :3].T + pose[:3, 3] - transform_points(pose, points)
    seen_at = CAMERA.project(transform_points(flat, points)) + moved[:, :2] * CAMERA.fx / 600.0
    tracker = ColourTracker(build_actor(MODEL, MODEL.mean))
    frame = detected(seen(MODEL.mean, np.zeros(len(NAMES)), pose), seen_at)
    for _ in range(4):
        tracked = tracker.track(frame)
    assert tracked.tracked and off_by(tracked.head_pose, pose) < 0.5 * off_by(flat, pose)


def test_a_chin_that_the_detector_leaves_behind_does_not_tip_the_head():
    """It follows a chin less than three quarters of the way down; head, jaw and held-out chin stay right."""
    pose, opened = poses(1)[0], expression(jawOpen=0.9)
    skin = MODEL.mean + np.tensordot(opened, MODEL.generic_expressions, axes=1)
    chin, down = SET.regions == "chin", (SET.points(skin) - SET.points(MODEL.mean))[:, 1]
    assert (SET.opened[chin, 1] > 0.1 * -down[chin]).mean() > 0.5 and np.abs(SET.opened[SET.regions == "lids"]).max() < 2.0
    behind = CAMERA.project(transform_points(pose, SET.points(skin) + 0.9 * SET.opened))
    frame = detected(seen(MODEL.mean, opened, pose), behind + SET.slides(pose, CAMERA, SET.points(skin)))
    tracker = ColourTracker(build_actor(MODEL, MODEL.mean))
    for _ in range(12):
        tracked = tracker.track(frame)
    errors = dict(zip(tracker.held_out.regions, tracked.held_out, strict=True))
    assert off_by(tracked.head_pose, pose) < 1.0 and errors["chin"] < 3.0
    assert tracked.coefficients_initial[NAMES.index("jawOpen")] == pytest.approx(0.9, abs=0.12)


def test_landmarks_far_off_do_not_turn_the_head():
    """A sneer that the rig does not have pulls the skin beside the nose up by 8 mm."""
    pose, points = poses(1)[0], SET.points(MODEL.mean)
    frame = seen(MODEL.mean, np.zeros(len(NAMES)), pose)
    pulled = frame.features.face.mesh[SET.ids, :2].copy()
    pulled[np.isin(SET.ids, [50, 280, 101, 330, 205, 425, 36, 266, 203, 423, 129, 358])] -= [0.0, 8.0]
    frames = [frame] * 2 + [detected(frame, pulled)] * 6
    tracker = ColourTracker(build_actor(MODEL, MODEL.mean))
    off = [off_by(tracker.track(seen_frame).head_pose, pose) for seen_frame in frames]
    assert len(points) == len(SET) and off[1] < 0.3 and off[-1] < 0.8


def test_a_guessed_focal_length_cannot_put_the_head_into_the_camera():
    cropped = dataclasses.replace(CAMERA, fx=200.0, fy=200.0)
    frames = [seen(MODEL.mean, np.zeros(len(NAMES)), pose, k) for k, pose in enumerate(poses(6))]
    frames = [dataclasses.replace(frame, camera=cropped) for frame in frames]
    capture = capture_colour(frames, guessed_focal=True)
    assert capture.focal == pytest.approx(USUAL / 200.0, rel=0.1) and 200.0 < NEAREST
    assert capture_colour(frames).focal == 1.0


def tracked_result(head: np.ndarray, seen_head: np.ndarray):
    actor = build_actor(MODEL, head)
    tracker, builder = ColourTracker(actor), ResultBuilder(actor, Parameters(), 5, colour_only=True)
    for k, pose in enumerate(poses(5)):
        builder.add(tracker.track(seen(seen_head, np.zeros(len(NAMES)), pose, k, 0.3)))
    return builder.finish()


def test_held_out_landmarks_tell_how_well_the_face_fits(tmp_path, identity):
    """The same head fits; another one does not, and that is said first."""
    head = MODEL.neutral(identity)
    right, wrong = tracked_result(head, head), tracked_result(head * [1.0, 1.4, 1.0], head)
    assert right.tracked.all() and right.held_out.shape == (5, len(right.held_out_regions))
    assert {"nose", "chin", "lips", "lids"} <= set(right.held_out_regions)
    assert 0 < np.median(right.held_out) < 3 < np.median(wrong.held_out[wrong.tracked])
    assert right.summary().splitlines()[-1].startswith("held-out landmarks: off by")
    assert "does not fit what is seen" in wrong.summary().splitlines()[0] and "does not fit" not in right.summary()
    right.save(tmp_path / "result.npz")
    again = Result.load(tmp_path / "result.npz")
    np.testing.assert_array_equal(again.held_out, right.held_out)
    assert again.held_out_regions == right.held_out_regions and again[1:3].held_out.shape[0] == 2


def test_a_result_without_landmarks_has_none(tmp_path):
    actor = dataclasses.replace(build_actor(MODEL, MODEL.mean), landmarks=None)
    builder = ResultBuilder(actor, Parameters(), 1, colour_only=True)
    builder.add(ColourTracker(actor).track(seen(MODEL.mean, np.zeros(len(NAMES)), poses(1)[0])))
    result = builder.finish()
    assert result.held_out is None and "held-out" not in result.summary()
    result.save(tmp_path / "result.npz")
    assert Result.load(tmp_path / "result.npz").held_out is None


def test_the_report_and_the_live_figures_say_how_well_it_fits(tmp_path, identity):
    head = MODEL.neutral(identity)
    actor = build_actor(MODEL, head)
    for seen_head, fits in ((head, True), (head * [1.0, 1.4, 1.0], False)):
        result = tracked_result(head, seen_head)
        text = write_report(result, None, actor, tmp_path).read_text(encoding="utf-8")
        assert "Does the face fit?" in text and ("The face does not fit what is seen" in text) != fits
        figures = LiveStatistics(held_out=float(np.median(result.held_out.max(axis=1))))
        assert "worst region off by" in str(figures) and str(figures).startswith("the face does not fit") != fits
    assert "off by" not in str(LiveStatistics())


def test_noise_does_not_shrink_the_head(identity):
    """Residuals in millimetres at the head are smaller for a smaller head; those in the picture are not."""
    head = MODEL.neutral(identity)
    sizes = []
    for noise in (0.2, 2.0):
        frames = [seen(head, np.zeros(len(NAMES)), pose, k, noise) for k, pose in enumerate(poses(24))]
        sizes.append(np.ptp(capture_colour(frames).actor.neutral[MODEL.frontal], axis=0)[1])
    assert abs(sizes[1] / sizes[0] - 1) < 0.03
