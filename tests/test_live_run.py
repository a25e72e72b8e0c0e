"""The driver of the live chain without a view: its states and what it tells, however the scan ends."""

from __future__ import annotations

import dataclasses
import threading
import time
from contextlib import nullcontext

import numpy as np
import pytest
from live_faults import STALL, ScriptedDriver, empty_room, raw
from live_head import QUICK, ColourDriver, HeadDriver, head_frames, threads_of_ours, wait_for
from scenes import exact_actor

from adaptiveface.errors import AdaptiveFaceError, SensorDisconnectedError, SensorError, TrackingError
from adaptiveface.live import scan as scan_module
from adaptiveface.live.run import BUILDING, CLOSED, FAILED, SCANNING, STARTING, TRACKING, LiveRun
from adaptiveface.sensors.live import LiveSensor
from adaptiveface.sensors.recording import RecordingWriter
from adaptiveface.tracking.colour_tracker import make_tracker


@pytest.fixture
def sensor():
    with LiveSensor(lambda: HeadDriver(head_frames())) as sensor:
        yield sensor


def steps(count: int = 8, change=lambda frame: frame) -> list:
    """The head's frames, as a driver delivers them."""
    frames = head_frames()
    return [raw(change(frames[k % len(frames)]), k) for k in range(count)]


def left_over() -> list[str]:
    return [name for name in threads_of_ours() if not name.startswith("sensor")]


def test_it_scans_builds_tracks_and_relearns_and_tells_each_change(sensor):
    seen, told = [], []

    def watch(run) -> None:
        assert threading.current_thread().name.startswith("live run")
        told.append((run.state, run.guidance and run.guidance.step, run.progress[0]))
        if run.state == STARTING:
            assert run.session is None and run.actor is not None

    with LiveRun(sensor, parameters=QUICK, seconds=1.0, watch=watch) as run:
        run.on_result(seen.append)
        assert run.wait()
        assert run.guidance.done and run.guide.vertex_coverage.max() == 1.0 and run.frame is not None
        states = [state for state, *_ in told]
        assert states == sorted(states, key=[SCANNING, BUILDING, STARTING, TRACKING].index)
        assert {"straight", "done"} <= {step for _, step, _ in told}
        assert {"fuse", "fit", "shrink_wrap", "blendshapes"} <= {step for _, _, step in told}
        first = run.actor
        wait_for(lambda: len(seen) > 3)
        assert seen[-1].tracked.tracked and seen[-1].frame.features is not None
        run.relearn()
        assert run.guidance is None or not run.guidance.done
        assert run.wait()
        count = len(seen)
        wait_for(lambda: len(seen) > count + 2)
        assert run.actor is not first
    assert run.session is None and run.state == CLOSED and left_over() == []


@pytest.mark.parametrize("colour_only", [False, True])
def test_the_tracker_is_compiled_before_live_frames_wait(monkeypatch, sensor, colour_only):
    """The scan's last frames are tracked while the head is built, by a tracker that the session does not use."""
    tracked = []

    def make(*arguments):
        tracker = make_tracker(*arguments)
        track = tracker.track
        tracker.track = lambda frame: tracked.append(track(frame)) or tracked[-1]
        return tracker

    monkeypatch.setattr(scan_module, "make_tracker", make)
    with LiveSensor(lambda: ColourDriver(head_frames())) if colour_only else nullcontext(sensor) as source:
        with LiveRun(source, parameters=QUICK, seconds=1.0) as run:
            assert run.wait()
            assert [frame.tracked for frame in tracked] == [True] * scan_module.REHEARSED
            assert run.session.expressions is None and len(tracked) == scan_module.REHEARSED


def test_a_callback_given_while_starting_sees_every_result():
    seen = []
    with LiveSensor(lambda: ScriptedDriver(steps())) as sensor:
        watch = lambda run: run.on_result(seen.append) if run.state == STARTING else None  # noqa: E731
        with LiveRun(sensor, exact_actor(), watch=watch) as run:
            assert run.wait()
            wait_for(lambda: not run.session.running)
            with pytest.raises(TrackingError, match="the recording is over"):
                run.relearn()
            assert run.state == TRACKING
    assert [result.index for result in seen] == list(range(8))


def test_a_recording_ends_the_scan_with_what_it_has(tmp_path):
    with RecordingWriter(tmp_path / "take", head_frames()[0].camera) as writer:
        for frame in head_frames():
            writer.write(frame)
    with LiveRun(str(tmp_path / "take"), parameters=QUICK) as run:
        assert run.wait()
        assert run.error is None and run.guidance.done
    assert threads_of_ours() == []


def test_a_recording_without_a_face_fails_by_name():
    for colour_only, words in ((False, "none of the 8 frames"), (True, "no frame of the recording shows a face")):
        with LiveSensor(lambda: ScriptedDriver(steps(change=without_features))) as sensor:
            sensor.colour_only = colour_only
            with LiveRun(sensor) as run, pytest.raises(TrackingError, match=words):
                run.wait()
            assert run.state == CLOSED and left_over() == []


def without_features(frame):
    return dataclasses.replace(empty_room(frame), features=None)


def test_enough_ends_the_scan_early(sensor):
    with LiveRun(sensor, parameters=QUICK, seconds=600.0) as run:
        wait_for(lambda: run.guidance is not None)
        run.finish_scan()
        assert run.wait() and len(run.guide.frames) < 60


def test_without_depth_the_proportions_are_taken():
    with LiveSensor(lambda: ColourDriver(head_frames())) as sensor, LiveRun(sensor) as run:
        assert run.wait() and run.colour_only and run.guide is None
        assert run.guidance.progress == 1.0 and not len(run.actor.scan_points)


def test_a_short_recording_without_depth_uses_the_frames_there_are():
    with LiveSensor(lambda: ScriptedDriver(steps(6))) as sensor:
        sensor.colour_only = True
        with LiveRun(sensor) as run:
            assert run.wait() and run.guidance.done


def test_an_unplugged_sensor_is_a_message_and_the_scan_goes_on_when_it_is_back():
    told, given = [], steps(400)
    given[4:4] = [SensorDisconnectedError("scripted: unplugged"), *[STALL] * 5]

    def watch(run) -> None:
        told.append((run.message, run.guide.frames_seen))

    with LiveSensor(lambda: ScriptedDriver(given)) as sensor, LiveRun(sensor, watch=watch) as run:
        wait_for(lambda: told and told[-1][1] > 8)
        run.close()
    assert ("scripted: unplugged", 4) in told and ("", 5) in told


def test_a_silent_sensor_is_a_message(monkeypatch):
    monkeypatch.setattr(scan_module, "SILENCE_SECONDS", 0.1)

    class Silent(ScriptedDriver):
        def grab(self, timeout: float):
            time.sleep(0.01)

    with LiveSensor(lambda: Silent([], live=True)) as sensor, LiveRun(sensor) as run:
        wait_for(lambda: "scripted: no new frame for" in run.message)
        assert run.state == SCANNING


def test_a_sensor_that_cannot_be_opened_is_an_error_of_the_package():
    with LiveRun("no such sensor") as run:
        with pytest.raises(SensorError, match="no such sensor"):
            run.wait()
        assert run.state == FAILED


@pytest.mark.parametrize(
    "error,words", [(TrackingError("disk full"), "^disk full"), (ValueError("5"), r"^test head: the run failed \(5\)")]
)
def test_what_a_watcher_raises_fails_the_run(sensor, error, words):
    def watch(run) -> None:
        raise error

    with LiveRun(sensor, watch=watch) as run:
        with pytest.raises(AdaptiveFaceError, match=words):
            run.wait()
    assert left_over() == []


@pytest.mark.parametrize("state", [SCANNING, BUILDING])
def test_closing_in_the_midst_of_it_ends_every_thread(sensor, state):
    reached = threading.Event()

    def watch(run) -> None:
        if run.state == state and (run.progress[0] or state == SCANNING):
            reached.set()

    run = LiveRun(sensor, parameters=QUICK, seconds=0.5, watch=watch)
    assert reached.wait(60)
    run.close()
    run.close()
    assert run.state == CLOSED and run.session is None
    wait_for(lambda: left_over() == [])
    assert run.error is None and run.state == CLOSED


def test_a_sensor_that_opens_after_closing_is_closed(monkeypatch):
    """Its library took its time; nobody waits for it any more."""
    opened, go = [], threading.Event()

    def slowly(name):
        go.wait(60)
        opened.append(LiveSensor(lambda: HeadDriver(head_frames())))
        return opened[0]

    monkeypatch.setattr("adaptiveface.live.run.open_sensor", slowly)
    monkeypatch.setattr("adaptiveface.live.run.CLOSE_SECONDS", 0.1)
    run = LiveRun("slow", exact_actor())
    run.close()
    go.set()
    wait_for(lambda: opened and threads_of_ours() == [])
    assert run.state == CLOSED and run.feed is None
    with pytest.raises(SensorError, match="closed"):
        opened[0].read()


def test_changed_parameters_are_those_of_the_session(sensor):
    with LiveRun(sensor, exact_actor()) as run:
        assert run.wait()
        run.set_parameters(run.parameters.replace(laplacian__w2=9.0))
        assert run.session.parameters.laplacian.w2 == run.parameters.laplacian.w2 == 9.0
        np.testing.assert_array_equal(run.actor.neutral, exact_actor().neutral)


def test_asked_to_detect_it_searches_every_picture_and_closes_the_detector(monkeypatch):
    """Though the frames bring features."""
    searched, closed = [], []

    class Detector:
        def __init__(self, *, video: bool) -> None:
            assert video

        def detect(self, frame):
            searched.append(frame.sequence)
            return frame.features

        def close(self) -> None:
            closed.append(len(searched))

    monkeypatch.setattr("adaptiveface.live.feed.FeatureDetector", Detector)
    for detect, count in ((False, 0), (True, 8)):
        with LiveSensor(lambda: ScriptedDriver(steps())) as sensor:
            with LiveRun(sensor, exact_actor(), detect=detect) as run:
                assert run.wait()
                wait_for(lambda run=run: not run.session.running)
        assert len(searched) == count
    assert closed == [8]
