"""Colour that fails: a hand, a light that goes out, a stream that stops or lags. Depth goes on, and nothing wrong is learned.

What was learned while the colour failed shows afterwards, on frames with depth and features alone, against a tracker that
went through the same frames without the colour term.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from coloured import actor_and_views, coloured_performer

from adaptiveface.geometry.frame import RgbdFrame
from adaptiveface.geometry.mesh import vertex_normals
from adaptiveface.model.actor import Actor
from adaptiveface.neutral.appearance import gather_appearance
from adaptiveface.neutral.skin import gather_skin
from adaptiveface.parameters import Parameters
from adaptiveface.synthetic.sensor import SyntheticSensor
from adaptiveface.tracking.tracker import FaceTracker
from adaptiveface.tracking.types import SampleState, TrackedFrame

ON, OFF = Parameters().replace(skin__on=True), Parameters().replace(skin__on=False)
NEUTRAL, FIRST, FAILS, LAST = 12, 18, 22, 46
LAG = 3

Failure = Callable[[list[RgbdFrame]], list[RgbdFrame]]


@pytest.fixture(scope="module")
def sensor() -> SyntheticSensor:
    return coloured_performer(NEUTRAL)


@pytest.fixture(scope="module")
def frames(sensor) -> list[RgbdFrame]:
    return [sensor.read(index) for index in range(FIRST, LAST)]


@pytest.fixture(scope="module")
def actor(sensor) -> Actor:
    plain, views = actor_and_views(sensor)
    return replace(plain, skin=gather_skin(plain, views, ON.skin))


def dark(frames: list[RgbdFrame]) -> list[RgbdFrame]:
    """The light goes out: grain, and no face for the detector."""
    rng = np.random.default_rng(0)
    return [replace(f, colour=rng.integers(0, 3, f.colour.shape).astype(np.uint8), features=None) for f in frames]


def stopped(frames: list[RgbdFrame]) -> list[RgbdFrame]:
    """No more pictures."""
    return [replace(frame, colour=None, features=None) for frame in frames]


def frozen(frames: list[RgbdFrame]) -> list[RgbdFrame]:
    """The last picture, and what was found in it, for ever."""
    return [replace(frame, colour=frames[0].colour, features=frames[0].features) for frame in frames]


def late(frames: list[RgbdFrame]) -> list[RgbdFrame]:
    """Pictures, and what is found in them, come three frames late."""
    before = [frames[max(k - LAG, 0)] for k in range(len(frames))]
    return [replace(frame, colour=old.colour, features=old.features) for frame, old in zip(frames, before, strict=True)]


def hand(frames: list[RgbdFrame]) -> list[RgbdFrame]:
    """A hand in the colour of the skin, 40 mm before the lower half of the face; what it hides is not detected."""
    out = []
    for frame in frames:
        u, v = np.nanmean(frame.features.pixels[20:], axis=0)  # the lips
        columns, rows = np.meshgrid(np.arange(frame.camera.width), np.arange(frame.camera.height))
        palm = (np.abs(columns - u) < 45) & (np.abs(rows - v) < 40)
        nearest = frame.depth[palm & (frame.depth > 0)].min()
        shaded = np.array([205, 160, 135]) + 8 * np.sin(columns / 5.0)[..., None]
        pixels = np.nan_to_num(frame.features.pixels, nan=-1e3)
        hidden = (np.abs(pixels - [u, v]) < [45, 40]).all(axis=1)
        features = replace(frame.features, confidence=np.where(hidden, 0.0, frame.features.confidence))
        colour = np.where(palm[..., None], shaded, frame.colour).astype(np.uint8)
        out.append(replace(frame, colour=colour, depth=np.where(palm, nearest - 40, frame.depth), features=features))
    return out


def run(
    actor: Actor, frames: list[RgbdFrame], fails: Failure, parameters: Parameters
) -> tuple[list[TrackedFrame], FaceTracker]:
    """The frames tracked, those from ``FAILS`` on as they fail; and the tracker after that."""
    tracker = FaceTracker(actor, parameters)
    cut = FAILS - FIRST
    for frame in frames[:cut]:
        tracker.track(frame)
    return [tracker.track(frame) for frame in fails(frames[cut:])], tracker


def afterwards(sensor: SyntheticSensor, actor: Actor, tracker: FaceTracker, frames: list[RgbdFrame]) -> tuple[float, float]:
    """Error of v3, which only what was learned can bend, in good frames without the colour term: along the normals, within."""
    tracker = tracker.with_parameters(OFF.replace(adaptive_pca__learn=False))
    along, within = [], []
    for frame in frames[:-13:-1]:  # back from where the failure ended
        tracked, truth = tracker.track(frame), sensor.ground_truth(frame.index).vertices
        error, normals = tracked.in_camera(tracked.v3) - truth, vertex_normals(truth, actor.triangles)
        height = (error * normals).sum(axis=1, keepdims=True)
        chosen = actor.frontal & actor.depth_valid
        along.append(np.abs(height[chosen]).mean())
        within.append(np.linalg.norm((error - height * normals)[chosen], axis=1).mean())
    return float(np.mean(along)), float(np.mean(within))


@pytest.mark.parametrize("fails", [dark, stopped], ids=lambda f: f.__name__)
def test_without_pictures_it_tracks_and_learns_as_without_the_term(sensor, actor, frames, fails):
    """From the same state on, the same bits: no row of colour is made."""
    cut, before = FAILS - FIRST, FaceTracker(actor, ON)
    for frame in frames[:cut]:
        before.track(frame)
    with_term, without = before.with_parameters(ON), before.with_parameters(OFF)
    for frame in fails(frames[cut:]):
        ours, plain = with_term.track(frame), without.track(frame)
        assert ours.tracked and ours.sample_state == plain.sample_state
        np.testing.assert_array_equal(ours.v2, plain.v2)
        np.testing.assert_array_equal(ours.v4, plain.v4)
    assert with_term.model.updates == without.model.updates


@pytest.mark.parametrize("fails", [frozen, late], ids=lambda f: f.__name__)
def test_pictures_of_another_moment_teach_nothing(sensor, actor, frames, fails):
    """Head and face move on; what was learned meanwhile is no worse than what depth and the same late features teach."""
    (ours, with_term), (_, without) = (run(actor, frames, fails, parameters) for parameters in (ON, OFF))
    assert all(tracked.tracked for tracked in ours)
    for mine, plain in zip(*(afterwards(sensor, actor, t, frames) for t in (with_term, without)), strict=True):
        assert mine < 1.03 * plain


def test_pictures_in_time_are_learned_from(actor, frames):
    assert SampleState.HIDDEN not in {tracked.sample_state for tracked in run(actor, frames, lambda good: good, ON)[0]}


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "length", "shown"), [(2003, 200, 45), (22, 200, 60)])
def test_a_mouth_that_opens_while_the_head_nods_is_in_time(seed, length, shown):
    """At 30 frames a second."""
    assert not any(called_late(seed, length, shown, lambda good: good))


@pytest.mark.slow
def test_pictures_three_frames_late_are_told_by_a_moving_face():
    assert np.mean(called_late(21, 200, 70, late)[30:]) > 0.5


def called_late(seed: int, length: int, shown: int, fails: Failure) -> list[bool]:
    """Whether each of the first frames of a performance was called late, with noisy features and the exact neutral."""
    sensor = SyntheticSensor(seed, "truedepth", 20, length, repeats=1, feature_noise=1.0)
    plain, views = actor_and_views(sensor)
    appearance, skin = gather_appearance(plain, views, ON.refinement), gather_skin(plain, views, ON.skin)
    tracker, out = FaceTracker(replace(plain, appearance=appearance, skin=skin), ON), []
    for frame in fails([sensor.read(index) for index in range(20, 20 + shown)]):
        tracker.track(frame)
        out.append(tracker.state.clock.late)
    return out


def test_a_repeated_picture_is_late_at_once(actor, frames):
    """The same picture with other depth; with the same depth it is the same frame, and in time."""
    tracker = FaceTracker(actor, ON)
    for frame in (*frames[:3], frames[2]):
        tracker.track(frame)
    assert not tracker.state.clock.late
    tracked = tracker.track(replace(frames[3], colour=frames[2].colour))
    assert tracked.sample_state == SampleState.HIDDEN and tracker.state.clock.late
    assert tracker.track(frames[4]).sample_state != SampleState.HIDDEN


def test_behind_a_hand_nothing_is_learned(sensor, actor, frames):
    """Half of the face is hidden: the rest is tracked by its depth, and no sample counts."""
    tracked, tracker = run(actor, frames, hand, ON)
    assert all(each.tracked for each in tracked)
    assert {each.sample_state for each in tracked} == {SampleState.HIDDEN}
    assert {each.corrective_updates for each in tracked} == {tracker.model.updates}
    last, truth = tracked[-1], sensor.ground_truth(LAST - 1).vertices
    upper = actor.frontal & actor.depth_valid & (actor.neutral[:, 1] > actor.neutral[actor.feature_vertices[8:20], 1].min())
    normals = vertex_normals(truth, actor.triangles)
    assert np.abs(((last.in_camera(last.v4) - truth) * normals).sum(axis=1))[upper].mean() < 0.5
