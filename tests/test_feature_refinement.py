"""Detected features refined by the neutral's colours: what is gathered, how far it gets, and when it keeps away."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from adaptiveface.errors import FileFormatError
from adaptiveface.files import records
from adaptiveface.geometry.frame import FEATURE_IDS, FEATURE_REGIONS, Features2D, RgbdFrame
from adaptiveface.geometry.mesh import surface_points, transform_points
from adaptiveface.model.actor import Actor
from adaptiveface.model.appearance import BLURS
from adaptiveface.neutral.appearance import gather_appearance
from adaptiveface.neutral.capture import build_actor, capture_actor
from adaptiveface.parameters import Parameters
from adaptiveface.synthetic.sensor import SyntheticSensor
from adaptiveface.tracking.feature_refinement import FeatureRefinement
from adaptiveface.tracking.patch_alignment import GAIN, OFFSET, _normal_equations, align_patches
from adaptiveface.tracking.tracker import FaceTracker

PARAMETERS = Parameters()
NEUTRAL = 12


@pytest.fixture(scope="module")
def sensor() -> SyntheticSensor:
    return SyntheticSensor(7, "truedepth", NEUTRAL, 60, repeats=1, feature_noise=0.0)


@pytest.fixture(scope="module")
def actor(sensor) -> Actor:
    plain = build_actor(sensor.performer.model, sensor.performer.neutral)
    views = [(sensor.read(index), sensor.ground_truth(index).head_pose) for index in range(0, NEUTRAL, 3)]
    return replace(plain, appearance=gather_appearance(plain, views, PARAMETERS.refinement))


def misread(frame: RgbdFrame, seed: int = 0, size: float = 1.3) -> RgbdFrame:
    """The frame as a detector sees it: errors of ``size`` px, alike for each region and side, at a detector's confidence."""
    rng, features = np.random.default_rng(seed), frame.features
    side = features.pixels[:, 0] > np.nanmean(features.pixels[:, 0])
    shift = np.zeros((40, 2))
    for region in np.unique(FEATURE_REGIONS):
        for half in (False, True):
            shift[(FEATURE_REGIONS == region) & (side == half)] = rng.normal(0.0, size, 2)
    return replace(frame, features=Features2D(features.pixels + shift, 0.3 * features.confidence))


def refined(actor: Actor, frame: RgbdFrame, mesh: np.ndarray, pose: np.ndarray) -> Features2D:
    refinement = FeatureRefinement(actor, PARAMETERS.refinement)
    return refinement.refine(frame, mesh, pose, lambda features, mesh: mesh)


def head_mesh(sensor: SyntheticSensor, index: int) -> np.ndarray:
    """The true head of a frame in its own frame, mm."""
    truth = sensor.ground_truth(index)
    return transform_points(np.linalg.inv(truth.head_pose), truth.vertices)


def errors(features: Features2D, frame: RgbdFrame) -> np.ndarray:
    return np.linalg.norm(features.pixels - frame.features.pixels, axis=1)


def test_samples_lie_around_their_features_and_never_on_the_other_lip(actor):
    look = actor.appearance
    homes = surface_points(actor.neutral, actor.feature_triangles, actor.feature_weights)
    points = surface_points(actor.neutral, look.triangles, look.weights)
    away = np.linalg.norm(points - homes[look.feature], axis=1)
    assert away.max() <= PARAMETERS.refinement.radius and np.bincount(look.feature, minlength=40).min() >= 5
    np.testing.assert_allclose(look.weights.sum(axis=1), 1.0)
    assert look.colours.shape == (len(BLURS), len(look), 3) and np.isfinite(look.colours).all()
    upper, lower = (set(map(tuple, look.triangles[look.feature == np.flatnonzero(FEATURE_IDS == n)[0]])) for n in (51, 57))
    assert not upper & lower


def test_without_colour_there_is_no_appearance(sensor, actor):
    views = [(replace(sensor.read(0), colour=None), sensor.ground_truth(0).head_pose)]
    assert gather_appearance(actor, views, PARAMETERS.refinement) is None


def test_normal_equations_are_those_of_scipy():
    """One patch in a random picture: H and g against SciPy's interpolation and explicit sums."""
    rng = np.random.default_rng(3)
    picture, gu, gv = rng.uniform(0, 200, (3, 30, 40, 3)).astype(np.float32)
    pixels, weights, colours = rng.uniform(5, 24, (20, 2)), rng.uniform(0.1, 1, 20), rng.uniform(0, 200, (20, 3))
    shift, light = np.array([0.7, -1.2]), np.array([1.1, -4.0])
    h, g = _normal_equations((picture, gu, gv), pixels, weights, colours, shift, light, 16.0)
    at = (pixels + shift)[:, ::-1].T
    value, du, dv = (np.stack([map_coordinates(m[..., c], at, order=1) for c in range(3)], axis=1) for m in (picture, gu, gv))
    lit = np.array([1.0, 0.0, 0.0])
    residual = value - np.where(lit, 1.1, 1.0) * colours + 4.0 * lit
    scale = np.maximum((weights[:, None] * residual**2).sum(axis=0) / weights.sum(), 16.0)
    w = weights[:, None] / (scale + 0.25 * residual**2)
    jacobian = np.stack([du, dv, -colours * lit, -np.ones_like(colours) * lit], axis=2)
    np.testing.assert_allclose(h, np.einsum("qc,qci,qcj->ij", w, jacobian, jacobian), rtol=1e-5)
    np.testing.assert_allclose(g, -np.einsum("qc,qci,qc->i", w, jacobian, residual), rtol=1e-5, atol=1e-6)


def test_a_round_solves_shifts_and_light_of_all_patches_together():
    """Against one dense system of shifts, gains and offsets, their priors, and the detector's covariance."""
    rng = np.random.default_rng(4)
    images = tuple(rng.uniform(0, 60, (3, 30, 40, 3)).astype(np.float32))
    count, samples = 4, 30
    starts, seen = np.arange(count + 1) * samples, np.array([0, 1, 3])
    pixels, colours = rng.uniform(8, 20, (count * samples, 2)), rng.uniform(0, 60, (count * samples, 3))
    weights, n = rng.uniform(0.1, 1, count * samples), len(seen)
    start, detected = rng.normal(0, 0.5, (2, n, 2))
    precision = np.linalg.inv(0.6 * np.ones((n, n)) + 0.3 * np.eye(n)) * 3.0
    shift, variance = align_patches(images, pixels, weights, colours, starts, seen, start, detected, precision, 1, 16.0)

    whole, right = np.zeros((n, 4, n, 4)), np.zeros((n, 4))
    for i, f in enumerate(seen):
        part = slice(starts[f], starts[f + 1])
        h, right[i] = _normal_equations(
            images, pixels[part], weights[part], colours[part], start[i], np.array([1.0, 0.0]), 16.0
        )
        whole[i, :, i] = h + np.diag([0, 0, GAIN**-2, OFFSET**-2])
    for k in range(2):
        whole[:, k, :, k] += precision
        right[:, k] += precision @ (detected - start)[:, k]
    whole = whole.reshape(4 * n, 4 * n)
    step = np.linalg.solve(whole, right.ravel()).reshape(n, 4)[:, :2]
    assert np.abs(step).max() < 1.5  # no step is cut
    np.testing.assert_allclose(shift, start + step, rtol=1e-6, atol=1e-9)
    left = np.diag(np.linalg.inv(whole)).reshape(n, 4)[:, :2].mean(axis=1)
    np.testing.assert_allclose(variance, left, rtol=1e-6)


@pytest.mark.parametrize("index", [NEUTRAL + 10, NEUTRAL + 35])
def test_misread_features_move_most_of_the_way_back(sensor, actor, index):
    frame, mesh, pose = sensor.read(index), head_mesh(sensor, index), sensor.ground_truth(index).head_pose
    before, after = [], []
    for seed in range(6):
        wrong = misread(frame, seed)
        right = refined(actor, wrong, mesh, pose)
        before.append(errors(wrong.features, frame))
        after.append(errors(right, frame))
        assert (right.confidence >= wrong.features.confidence - 1e-9).all() and right.confidence.max() <= 1.0
    assert np.nanmean(after) < 0.4 * np.nanmean(before)
    for region in ("lips", "brows"):
        assert np.nanmean(np.array(after)[:, FEATURE_REGIONS == region]) < 0.5 * np.nanmean(
            np.array(before)[:, FEATURE_REGIONS == region]
        )


def test_a_darker_room_changes_little(sensor, actor):
    index = NEUTRAL + 10
    frame, mesh, pose = misread(sensor.read(index)), head_mesh(sensor, index), sensor.ground_truth(index).head_pose
    darker = replace(frame, colour=(0.7 * frame.colour).astype(np.uint8))
    moved = refined(actor, darker, mesh, pose).pixels - refined(actor, frame, mesh, pose).pixels
    assert np.nanpercentile(np.linalg.norm(moved, axis=1), 90) < 0.4


def test_what_is_covered_stays_with_the_detector(sensor, actor):
    """A grey board over mouth and chin: lips keep to the detected pixels, and gain less confidence than in the open."""
    index = NEUTRAL + 10
    frame, mesh, pose = misread(sensor.read(index)), head_mesh(sensor, index), sensor.ground_truth(index).head_pose
    lips = FEATURE_REGIONS == "lips"
    top = int(np.nanmin(frame.features.pixels[lips, 1])) - 8
    colour = frame.colour.copy()
    colour[top : top + 60] = 128
    hidden = refined(actor, replace(frame, colour=colour), mesh, pose)
    shift = np.linalg.norm(hidden.pixels - frame.features.pixels, axis=1)
    assert np.nanmax(shift[lips]) < 1.0
    gained = hidden.confidence[lips] / frame.features.confidence[lips]
    open_view = refined(actor, frame, mesh, pose).confidence[lips] / frame.features.confidence[lips]
    assert np.nanmedian(gained) < 0.5 * np.nanmedian(open_view)


@pytest.mark.parametrize("shift", [(-700.0, 0.0), (0.0, 600.0), (-250.0, -150.0)])
def test_features_outside_the_picture_do_no_harm(sensor, actor, shift):
    frame, mesh, pose = misread(sensor.read(0)), head_mesh(sensor, 0), sensor.ground_truth(0).head_pose
    outside = replace(frame.features, pixels=frame.features.pixels + shift)
    left = refined(actor, replace(frame, features=outside), mesh, pose)
    seen = outside.valid
    assert np.isfinite(left.pixels[seen]).all() and np.isfinite(left.confidence).all()
    assert np.linalg.norm((left.pixels - outside.pixels)[seen], axis=1).max() < 20


def test_only_detected_features_of_coloured_frames_are_refined(sensor, actor):
    """Exact features give an actor without appearance; a tracker leaves alone what it cannot or must not refine."""
    frame = misread(sensor.read(0))
    on = FaceTracker(actor)
    off = FaceTracker(actor, PARAMETERS.replace(refinement__on=False))
    plain = FaceTracker(replace(actor, appearance=None))
    assert on.refinement is not None and off.refinement is None and plain.refinement is None
    same = [t.track(f).v4 for t, f in ((on, replace(frame, colour=None)), (off, frame), (plain, frame))]
    np.testing.assert_array_equal(same[0], same[1])
    np.testing.assert_array_equal(same[0], same[2])
    assert np.abs(FaceTracker(actor).track(frame).v4 - same[0]).max() > 0.05


def test_a_running_tracker_can_switch_it(sensor, actor):
    tracker = FaceTracker(actor)
    tracker.track(misread(sensor.read(0)))
    without = tracker.with_parameters(PARAMETERS.replace(refinement__on=False))
    assert without.refinement is None and tracker.refinement is not None
    assert without.with_parameters(PARAMETERS).refinement is not None


@pytest.mark.slow
def test_capture_gathers_it_from_detected_features_only(sensor):
    frames = [sensor.read(index) for index in range(NEUTRAL)]
    assert capture_actor(frames).appearance is None
    assert capture_actor([misread(frame, size=0.5) for frame in frames]).appearance is not None


def test_it_is_saved_with_the_actor_and_checked(actor, tmp_path):
    path = tmp_path / "actor.npz"
    actor.save(path)
    loaded = Actor.load(path).appearance
    for name, array in records.arrays(actor.appearance).items():
        np.testing.assert_allclose(getattr(loaded, name), array, rtol=1e-6, atol=1e-6)
    with np.load(path) as data:
        arrays = dict(data)
    for name, value in {
        "appearance_triangles": arrays["appearance_triangles"] + 10**6,
        "appearance_feature": arrays["appearance_feature"][::-1],
        "appearance_colours": arrays["appearance_colours"][:1],
        "appearance_weights": None,
    }.items():
        broken = {key: array for key, array in (arrays | {name: value}).items() if array is not None}
        np.savez(path, **broken)
        with pytest.raises(FileFormatError, match="appearance"):
            Actor.load(path)
