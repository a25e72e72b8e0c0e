"""Seeded faults of a sensor, through its thread into the tracker: no crash, no hang, found again, nothing bad learned."""

from __future__ import annotations

import numpy as np
import pytest
from live_faults import (
    STALL,
    ScriptedDriver,
    empty_room,
    half_size,
    hand_over_mouth,
    raw,
    second_face,
    without_depth,
)

from adaptiveface.errors import EndOfRecording, SensorDisconnectedError, SensorTimeoutError
from adaptiveface.pipeline import capture_from, one_blas_thread
from adaptiveface.sensors.live import LiveSensor
from adaptiveface.sensors.playback import forth_and_back
from adaptiveface.synthetic.sensor import SyntheticSensor
from adaptiveface.tracking.tracker import FaceTracker
from adaptiveface.tracking.types import SampleState

RELOCK = 15  # frames
START = 12  # of the performance: the neutral is over
BAD_FRAMES = 8
SEEDS = range(3)

CHANGED = {
    "zero depth": lambda frame: without_depth(frame, 0.0),
    "NaN depth": lambda frame: without_depth(frame, np.nan),
    "left the room": empty_room,
    "hand over the mouth": hand_over_mouth,
}
HARMLESS = {"other resolution": half_size, "second face": second_face}


@pytest.fixture(scope="module")
def performance():
    sensor = SyntheticSensor(5, neutral_frames=12, frames=36, repeats=1, colour=False)
    return [sensor.read(i) for i in range(len(sensor))], capture_from(sensor, neutral_frames=12)


@pytest.fixture(scope="module")
def tracker(performance):
    with one_blas_thread():
        yield FaceTracker(performance[1])


def scene(performance, index):
    return performance[0][forth_and_back(START + index, len(performance[0]))]


def track(tracker, steps):
    """Track until the end of the recording; (frame, result, learned state) of every frame."""
    tracker.reset()
    out = []
    with LiveSensor(lambda: ScriptedDriver(steps)) as sensor:
        while True:
            try:
                frame = sensor.read(30)
            except SensorDisconnectedError:
                continue
            except EndOfRecording:
                return out
            out.append((frame, tracker.track(frame), learned(tracker)))


def learned(tracker):
    return tracker.model.correctives.copy(), tracker.model.count, tracker.model.updates


def same_learned(a, b):
    return a[1:] == b[1:] and np.array_equal(a[0], b[0])


def relocked_after(results):
    """Frames until the first tracked one."""
    return next(i for i, (_, result, _) in enumerate(results) if result.tracked)


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("fault", CHANGED)
def test_bad_frames_teach_nothing_and_the_face_is_found_again(performance, tracker, fault, seed):
    bad = int(np.random.default_rng(seed).integers(14, 22))
    clean = [scene(performance, i) for i in range(bad + BAD_FRAMES + RELOCK)]
    steps = [raw(CHANGED[fault](f) if bad <= i < bad + BAD_FRAMES else f, i) for i, f in enumerate(clean)]
    results = track(tracker, steps)
    assert len(results) == len(clean)
    before, after = results[bad - 1], results[bad + BAD_FRAMES - 1]
    assert before[1].tracked and before[2][1] > 0  # something had been learned that could be spoilt
    assert same_learned(before[2], after[2])
    states = {result.sample_state for _, result, _ in results[bad : bad + BAD_FRAMES]}
    assert states <= {SampleState.UNTRACKED, SampleState.OUTLIER, SampleState.IN_ANCHOR_SPACE}
    assert relocked_after(results[bad + BAD_FRAMES :]) < RELOCK


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("fault", HARMLESS)
def test_frames_that_still_show_the_face_are_tracked(performance, tracker, fault, seed):
    bad = int(np.random.default_rng(seed).integers(6, 12))
    clean = [scene(performance, i) for i in range(bad + BAD_FRAMES + 3)]
    steps = [raw(HARMLESS[fault](f) if bad <= i < bad + BAD_FRAMES else f, i) for i, f in enumerate(clean)]
    results, expected = track(tracker, steps), track(tracker, [raw(f, i) for i, f in enumerate(clean)])
    assert all(result.tracked for _, result, _ in results)
    for (_, a, _), (_, b, _) in zip(results[bad:], expected[bad:], strict=True):
        assert np.linalg.norm(a.rigid[:3, 3] - b.rigid[:3, 3]) < 5.0  # mm: the same head, not the other one


@pytest.mark.parametrize("seed", SEEDS)
def test_duplicated_and_late_frames_change_nothing(performance, tracker, seed):
    rng = np.random.default_rng(seed)
    clean = [raw(scene(performance, i), i) for i in range(24)]
    disturbed = []
    for i, step in enumerate(clean):
        disturbed.append(step)
        if i and rng.random() < 0.4:
            disturbed.append(clean[i - int(rng.integers(0, min(i, 5)))])  # once more, or one from before
    assert len(disturbed) > len(clean)
    for (_, a, la), (_, b, lb) in zip(track(tracker, disturbed), track(tracker, clean), strict=True):
        assert np.array_equal(a.v4, b.v4) and same_learned(la, lb)


@pytest.mark.parametrize("seed", SEEDS)
def test_thirty_percent_of_the_frames_lost(performance, tracker, seed):
    kept = np.random.default_rng(seed).random(40) >= 0.3
    kept[0] = True
    results = track(tracker, [raw(scene(performance, i), i) for i in np.flatnonzero(kept)])
    assert all(result.tracked for _, result, _ in results)
    frame = results[-1][0]
    assert frame.sequence + 1 == frame.index + 1 + frame.dropped  # every lost frame is counted


@pytest.mark.parametrize("seed", SEEDS)
def test_unplugged_and_plugged_in_again(performance, tracker, seed):
    rng = np.random.default_rng(seed)
    first, away = int(rng.integers(14, 20)), int(rng.integers(20, 60))
    steps = [raw(scene(performance, i), i) for i in range(first)] + [SensorDisconnectedError("scripted: unplugged")]
    steps += [raw(scene(performance, first + away + i), i) for i in range(RELOCK)]  # a device counts from 0 again
    results = track(tracker, steps)
    assert len(results) == first + RELOCK
    assert relocked_after(results[first:]) < RELOCK


@pytest.mark.parametrize("seed", SEEDS)
def test_a_stall_of_two_seconds(performance, tracker, seed):
    """A live sensor: no frame during the stall, a timeout instead of an old one, then the face is found again."""
    first = int(np.random.default_rng(seed).integers(4, 8))
    steps = [raw(scene(performance, i), i) for i in range(first)]
    later = [raw(scene(performance, first + 60 + i), first + 60 + i) for i in range(RELOCK)]
    tracker.reset()
    pending: list = []

    class Stalling(ScriptedDriver):
        def grab(self, timeout):
            return pending.pop(0) if pending else STALL

    with LiveSensor(lambda: Stalling([], live=True), max_age=60) as sensor:
        for step in steps:
            pending.append(step)
            assert tracker.track(sensor.read(30)).tracked
        with pytest.raises(SensorTimeoutError):
            sensor.read(0.05)
        tracked = []
        for step in later:
            pending.append(step)
            frame = sensor.read(30)
            tracked.append(tracker.track(frame).tracked)
        assert frame.dropped == 60 and any(tracked)
