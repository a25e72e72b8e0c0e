"""The whole tracker on rendered performances with known truth, and on rubbish."""

from dataclasses import replace

import numpy as np
import pytest
from scenes import CAMERA, coefficients, exact_actor, head_pose, posed_shape, render_frame

from adaptiveface.geometry.frame import Features2D, RgbdFrame
from adaptiveface.parameters import Parameters
from adaptiveface.tracking.tracker import FaceTracker
from adaptiveface.tracking.types import SampleState


def lump(actor, size=5.0):
    """(N, 3) a bulge on one cheek that no blendshape makes."""
    centre = np.array([38.0, -20.0, 0.0])
    distance = np.linalg.norm((actor.neutral - centre)[:, :2], axis=1)
    normal_ish = np.array([0.5, 0.0, 0.87])
    return size * np.exp(-((distance / 18.0) ** 2))[:, None] * normal_ish * actor.frontal[:, None]


@pytest.fixture(scope="module")
def scene():
    """60 frames: jaw, smile and a cheek bulge outside the blendshapes, while the head turns; truth in the head frame."""
    actor = exact_actor()
    frames, shapes, poses = [], [], []
    for i in range(60):
        phase = 0.5 - 0.5 * np.cos(2 * np.pi * i / 30)
        x = coefficients(actor, jawOpen=0.35 * phase, mouthSmileLeft=0.6 * phase)
        shape = posed_shape(actor, x) + phase * lump(actor)
        pose = head_pose((0.05 * np.sin(i / 7), 0.2 * np.sin(i / 9), 0.0), (8 * np.sin(i / 6), 0.0, 600.0))
        frames.append(render_frame(actor, shape, pose, i, noise=0.6, pixel_noise=0.4))
        shapes.append(shape)
        poses.append(pose)
    return actor, frames, shapes, poses


def errors(result, shape, pose, actor, stage):
    placed = result.in_camera(getattr(result, stage))
    truth = shape @ pose[:3, :3].T + pose[:3, 3]
    return np.linalg.norm(placed - truth, axis=1)[actor.frontal & actor.depth_valid]


def test_tracks_learns_and_beats_the_blendshapes(scene):
    actor, frames, shapes, poses = scene
    tracker = FaceTracker(actor)
    results = [tracker.track(f) for f in frames]
    assert all(r.tracked for r in results)
    late = range(40, 56)
    bulge = np.linalg.norm(lump(actor), axis=1)[actor.frontal & actor.depth_valid] > 2.0
    v1 = np.mean([errors(results[i], shapes[i], poses[i], actor, "v1")[bulge].mean() for i in late])
    v4 = np.mean([errors(results[i], shapes[i], poses[i], actor, "v4")[bulge].mean() for i in late])
    assert v4 < 0.8 * v1
    everywhere = [errors(results[i], shapes[i], poses[i], actor, "v4").mean() for i in late]
    assert np.mean(everywhere) < 0.6
    assert results[-1].corrective_updates > 10
    assert any(r.sample_state is SampleState.LEARNED for r in results)
    assert results[45].adaptive_distance < 0.5 * results[45].anchor_distance


def test_learning_off_keeps_the_adaptive_space_empty(scene):
    actor, frames, *_ = scene
    tracker = FaceTracker(actor, Parameters().replace(adaptive_pca__learn=False))
    results = [tracker.track(f) for f in frames[:20]]
    assert tracker.model.correctives.shape[1] == 0 and results[-1].corrective_updates == 0
    np.testing.assert_allclose(results[15].adaptive_distance, results[15].anchor_distance)


def test_figure_11_measures_a_frame_before_it_is_learned_from():
    """A new expression is as far from the adaptive space as from the anchors, and the distance drops within frames."""
    actor = exact_actor()
    tracker = FaceTracker(actor)
    bulge = [0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 1.0, 1.0]
    results = []
    for index, size in enumerate(bulge):
        shape = actor.neutral + lump(actor, 5.0 * size)
        frame = render_frame(actor, shape, head_pose(), index, noise=0.3, pixel_noise=0.2)
        known = tracker.model.correctives.copy()
        results.append(result := tracker.track(frame))
        moved = (result.v2 - actor.neutral)[actor.frontal].ravel()
        for basis in (tracker.model.anchors, known):
            moved = moved - basis @ (basis.T @ moved)
        assert result.adaptive_distance == pytest.approx(np.linalg.norm(moved.reshape(-1, 3), axis=1).mean(), rel=1e-4)
    first = next(k for k, result in enumerate(results) if result.sample_state is SampleState.LEARNED)
    assert first == bulge.index(1.0)
    assert results[first].adaptive_distance == pytest.approx(results[first].anchor_distance)
    assert max(r.adaptive_distance for r in results[first + 1 :]) < 0.5 * results[first].adaptive_distance
    assert min(r.anchor_distance for r in results[first + 1 :]) > 0.9 * results[first].anchor_distance
    assert results[first].corrective_updates == results[first - 1].corrective_updates + 1, "it was learned all the same"


def hidden(frame, actor, what: str):
    """The frame with less to see: depth missing on half of the face, or a board in front of the mouth."""
    depth = frame.depth.copy()
    if what == "missing":
        depth[:, : int(np.median(np.nonzero(depth)[1])) + 15] = 0
    else:
        (left, top), (right, bottom) = (
            frame.features.pixels[20:].min(axis=0).astype(int) - 4,
            frame.features.pixels[20:].max(axis=0).astype(int) + 4,
        )
        depth[top:bottom, left:right] -= 40.0 * (depth[top:bottom, left:right] > 0)
    return replace(frame, depth=depth)


@pytest.mark.parametrize("what", ["missing", "behind a board"])
def test_a_hidden_face_has_a_state_of_its_own(scene, what):
    actor, frames, *_ = scene
    tracker = FaceTracker(actor)
    for frame in frames[:10]:
        seen = tracker.track(frame)
    updates = seen.corrective_updates
    result = tracker.track(hidden(frames[10], actor, what))
    assert result.tracked and result.sample_state is SampleState.HIDDEN and int(result.sample_state) == 4
    assert result.corrective_updates == updates
    assert tracker.track(frames[11]).sample_state in (SampleState.LEARNED, SampleState.IN_ANCHOR_SPACE)
    allowed = Parameters().replace(adaptive_pca__min_coverage=0.0, adaptive_pca__max_occluded=1.0)
    tracker = FaceTracker(actor, allowed)
    for frame in frames[:10]:
        tracker.track(frame)
    assert tracker.track(hidden(frames[10], actor, what)).sample_state is not SampleState.HIDDEN


def test_stages_differ_only_where_the_paper_says(scene):
    actor, frames, *_ = scene
    tracker = FaceTracker(actor)
    for frame in frames[:16]:
        result = tracker.track(frame)
    outside = ~actor.frontal
    np.testing.assert_array_equal(result.v2[outside], result.v1[outside])
    np.testing.assert_array_equal(result.v4[outside], result.v3[outside])
    assert np.abs(result.v2 - result.v1).max() > 0.5
    limits = tracker.parameters.blendshapes
    for x in (result.coefficients, result.coefficients_initial):
        assert x.min() >= limits.lower and x.max() <= limits.upper


def test_results_are_bit_identical_twice(scene):
    actor, frames, *_ = scene
    runs = []
    for _ in range(2):
        tracker = FaceTracker(actor)
        runs.append([tracker.track(f) for f in frames[:25]])
    for a, b in zip(*runs, strict=True):
        np.testing.assert_array_equal(a.vertices, b.vertices)
        np.testing.assert_array_equal(a.coefficients, b.coefficients)


def garbage_frames(kind, count=60):
    rng = np.random.default_rng(11)
    shape = (CAMERA.height, CAMERA.width)
    for i in range(count):
        features = Features2D(rng.uniform(0, 400, size=(40, 2)), np.ones(40)) if kind != "no features" else None
        depth = {
            "empty": lambda: np.zeros(shape),
            "noise": lambda: rng.uniform(300, 1200, size=shape),
            "wall": lambda: np.full(shape, 600.0),
            "no features": lambda: rng.uniform(590, 610, size=shape),
        }[kind]().astype(np.float32)
        yield RgbdFrame(depth, CAMERA, None, 100 + i, 4.0 + i / 30, features)


@pytest.mark.parametrize("kind", ["empty", "noise", "wall", "no features"])
def test_nothing_is_learned_from_garbage_and_tracking_recovers(scene, kind):
    actor, frames, shapes, poses = scene
    tracker = FaceTracker(actor)
    for frame in frames[:40]:
        tracker.track(frame)
    before, updates = tracker.model.correctives.copy(), tracker.model.updates
    assert updates > 0
    for frame in garbage_frames(kind):
        result = tracker.track(frame)
        assert not result.tracked and result.reason
        assert result.sample_state is SampleState.UNTRACKED
    np.testing.assert_array_equal(tracker.model.correctives, before)
    assert tracker.model.updates == updates
    basis = np.hstack([tracker.model.anchors, tracker.model.correctives])
    np.testing.assert_allclose(basis.T @ basis, np.eye(basis.shape[1]), atol=1e-9)
    result = tracker.track(frames[40])
    assert result.tracked
    assert errors(result, shapes[40], poses[40], actor, "v4").mean() < 1.5


def test_a_jump_of_the_head_is_found_again(scene):
    actor, frames, shapes, poses = scene
    tracker = FaceTracker(actor)
    tracker.track(frames[0])
    pose = head_pose((0.1, -0.4, 0.1), (110.0, 40.0, 700.0))
    result = tracker.track(render_frame(actor, actor.neutral, pose, 77, noise=0.6, pixel_noise=0.4))
    assert result.tracked
    assert errors(result, actor.neutral, pose, actor, "v4").mean() < 1.0


@pytest.mark.parametrize("also", [{}, {"noseSneer": 1.3, "browDown": 1.3}])
def test_a_face_that_comes_with_a_strong_expression_is_found(scene, also):
    """The resting face is more than ``max_residual`` away from it; a photograph of a laughing person was lost like this."""
    actor = scene[0]
    x = coefficients(actor, jawForward=1.3, cheekPuff=1.3, mouthSmileLeft=1.3, mouthSmileRight=1.3, **also)
    shape, pose = posed_shape(actor, x), head_pose((0.05, -0.1, 0.0))
    tracker = FaceTracker(actor)
    result = tracker.track(render_frame(actor, shape, pose, 5, noise=0.6, pixel_noise=0.4))
    assert result.tracked
    result = tracker.track(render_frame(actor, shape, pose, 6, noise=0.6, pixel_noise=0.4))
    assert errors(result, shape, pose, actor, "v4").mean() < 1.5


def test_tracks_without_features_once_started(scene):
    actor, frames, shapes, poses = scene
    tracker = FaceTracker(actor)
    tracker.track(frames[0])
    for i in range(1, 15):
        result = tracker.track(RgbdFrame(frames[i].depth, CAMERA, None, i, i / 30))
        assert result.tracked
    assert errors(result, shapes[14], poses[14], actor, "v4").mean() < 2.0


def test_paper_parameters_run(scene):
    actor, frames, *_ = scene
    tracker = FaceTracker(actor, Parameters.paper())
    results = [tracker.track(f) for f in frames[:12]]
    assert all(r.tracked for r in results)
