"""The live session: newest frames, changes on the next frame, nothing lost when a thread fails, no thread left."""

from __future__ import annotations

import dataclasses
import threading
import time
from functools import lru_cache

import numpy as np
import pytest
from live_faults import STALL, ScriptedDriver, raw, small_frame
from scenes import coefficients, exact_actor, head_pose, render_frame

from adaptiveface.errors import FeatureDetectionError, RecordingError, SensorDisconnectedError, TrackingError
from adaptiveface.live import FeatureFeed, LiveSession
from adaptiveface.parameters import Parameters
from adaptiveface.sensors.live import LiveSensor
from adaptiveface.tracking.tracker import FaceTracker


@lru_cache(maxsize=1)
def frames():
    """20 frames of a head that turns a little and opens its jaw."""
    actor, out = exact_actor(), []
    for i in range(20):
        shape = actor.neutral + np.tensordot(coefficients(actor, jawOpen=0.03 * i), actor.blendshapes, 1)
        out.append(render_frame(actor, shape, head_pose((0.0, 0.01 * i, 0.0)), i, noise=0.2))
    return out


def steps(count=20):
    return [raw(frames()[i], i) for i in range(count)]


def run(given, on_result=(), **options):
    """Play ``given`` to its end; (results, session)."""
    results = []
    with LiveSensor(lambda: ScriptedDriver(given)) as sensor, FeatureFeed(sensor) as feed:
        with LiveSession(feed, exact_actor(), on_result=[*on_result, results.append], **options) as session:
            wait(lambda: not session.running)
    return results, session


def wait(condition, seconds=120.0):
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline, "waited in vain"
        time.sleep(0.002)


class Endless(ScriptedDriver):
    """Plays its steps again and again, as a live sensor, at the pace of ``permits``."""

    def __init__(self, given, permits=None):
        super().__init__(given, live=True)
        self.count, self.permits = 0, permits

    def grab(self, timeout):
        if self.permits is not None and not self.permits.acquire(timeout=timeout):
            return STALL
        if self.permits is None:
            time.sleep(0.005)
        step = self.steps[self.count % len(self.steps)]
        self.count += 1
        return raw(step, self.count)


def test_every_frame_of_a_recording_is_tracked_in_order_and_the_session_ends():
    results, session = run(steps())
    assert session.ended and [r.index for r in results] == list(range(20))
    assert [r.frame.sequence for r in results] == [r.tracked.index for r in results] == list(range(20))
    assert all(r.tracked.tracked and r.latency_ms > 0 for r in results)
    statistics = session.statistics
    assert (statistics.tracked, statistics.lost) == (20, 0)
    assert statistics.dropped_features == statistics.dropped_tracker == 0
    assert session.latest().index == 19 and session.latest(after=19) is None


def test_a_live_session_takes_the_newest_frame_and_counts_the_others():
    with LiveSensor(lambda: Endless(frames())) as sensor, FeatureFeed(sensor) as feed:
        with LiveSession(feed, exact_actor()) as session:
            wait(lambda: session.statistics.dropped_tracker >= 3)
            first = session.latest(timeout=60)
            second = session.latest(after=first.index, timeout=60)
            assert second.frame.sequence > first.frame.sequence
            session.close()
            taken = session._count
            # Every frame the sensor handed out was tracked, superseded, or is waiting.
            feed.close()
            assert sensor._handed_out - feed.dropped - taken in (0, 1, 2)


def test_closing_twice_is_quick_and_leaves_no_thread():
    before = threading.active_count()
    sensor = LiveSensor(lambda: Endless(frames()))
    feed = FeatureFeed(sensor)
    session = LiveSession(feed, exact_actor())
    session.latest(timeout=60)
    for part in (session, feed, sensor):
        part.close()
        part.close()
    assert not session.running and threading.active_count() == before


def test_parameters_act_on_the_next_frame_and_keep_head_and_correctives():
    permits = threading.Semaphore(0)
    with LiveSensor(lambda: Endless(frames(), permits), max_age=60) as sensor, FeatureFeed(sensor) as feed:
        parameters, last = Parameters().replace(adaptive_pca__valid_min=0.0), -1
        changes = ({"laplacian__w2": 3.0}, {"adaptive_pca__K": 2}, {"blendshapes__A": 12}, {"kalman__model": "off"})
        with LiveSession(feed, exact_actor(), parameters) as session:
            for change in ({}, {}, {}, {}, *changes):
                learned = session.model.count
                session.set_parameters(session.parameters.replace(**change))
                permits.release()
                result = session.latest(last, 30)
                last = result.index
                assert result.tracked.tracked and session._tracker.parameters == session.parameters
                assert session.model.count >= learned
            assert session.model.count > 4 and session.model.correctives.shape[1] == 2
            assert result.tracked.coefficients.shape == (12,)


def test_frozen_nothing_is_learned_and_reset_forgets_the_correctives():
    given = steps()
    parameters = Parameters().replace(adaptive_pca__valid_min=0.0)
    results = []
    with LiveSensor(lambda: ScriptedDriver(given)) as sensor, FeatureFeed(sensor) as feed:

        def freeze_then_reset(result):
            if result.index == 9:
                session.freeze(True)
            if result.index == 14:
                session.reset_correctives()
            results.append(session.model.correctives.shape[1])

        hold = threading.Event()
        with LiveSession(feed, exact_actor(), parameters, [lambda _: hold.wait(), freeze_then_reset]) as session:
            hold.set()
            wait(lambda: not session.running)
            assert session.frozen and session.parameters.adaptive_pca.learn
    assert results[9] > 0 and results[10:15] == results[9:10] * 5 and results[15:] == [0] * 5


def test_a_callback_that_fails_is_said_once_and_tracking_goes_on():
    def full_disk(result):
        raise RecordingError("out: no space left on device")

    results = []
    with LiveSensor(lambda: Endless(frames())) as sensor, FeatureFeed(sensor) as feed:
        with LiveSession(feed, exact_actor(), on_result=[full_disk, results.append]) as session:
            with pytest.raises(RecordingError, match="no space left"):
                session.latest(after=10**9, timeout=60)
            wait(lambda: len(results) > 3)
            assert session.running


def test_a_bare_exception_of_a_callback_nobody_asked_for_is_raised_on_closing():
    with pytest.raises(TrackingError, match="a callback failed .division by zero"):
        run(steps(3), on_result=[lambda result: 1 / 0])


def test_a_frame_that_breaks_the_tracker_is_lost_alone_and_a_tracker_that_stays_broken_ends_the_session(monkeypatch):
    calls = []

    def track(self, frame, real=FaceTracker.track):
        calls.append(frame.index)
        if frame.index == 5:
            raise np.linalg.LinAlgError("singular matrix")
        return real(self, frame)

    monkeypatch.setattr("adaptiveface.tracking.tracker.FaceTracker.track", track)
    results, session = run(steps())
    assert len(results) == 20 and [r.index for r in results if not r.tracked.tracked] == [5]
    assert "frame 5 cannot be tracked (singular matrix)" in results[5].tracked.reason
    monkeypatch.setattr("adaptiveface.live.session.MOST_FAILURES", 1)
    with pytest.raises(TrackingError, match="frame 5 cannot be tracked"):
        run(steps())


def test_an_unplugged_sensor_is_a_message_and_the_session_goes_on_when_it_is_back():
    given = [*steps(8), SensorDisconnectedError("scripted: unplugged"), *steps(6)]
    results, session = run(given)
    assert session.ended and len(results) == 14 and all(r.tracked.tracked for r in results)


def test_without_reconnection_the_session_ends_with_the_sensors_error():
    given = [*steps(3), SensorDisconnectedError("scripted: unplugged")]
    with LiveSensor(lambda: ScriptedDriver(given), reconnect=False) as sensor, FeatureFeed(sensor) as feed:
        with LiveSession(feed, exact_actor()) as session:
            wait(lambda: not session.running)
            for _ in range(2):  # whoever asks is told
                with pytest.raises(SensorDisconnectedError, match="unplugged"):
                    session.latest(after=2)
            assert "unplugged" in session.statistics.message and session.latest().index == 2


class Detector:
    """Stands where MediaPipe does: its answer is the number of the frame."""

    def __init__(self, fail_at=None):
        self.fail_at, self.seen = fail_at, []

    def detect(self, frame):
        self.seen.append(frame.sequence)
        if frame.sequence == self.fail_at:
            raise RuntimeError("graph error")
        return ("features of", frame.sequence)


def with_colour(count):
    colour = np.zeros((24, 32, 3), np.uint8)
    return [dataclasses.replace(small_frame(i), colour=colour) for i in range(count)]


def test_a_frame_carries_the_features_that_were_found_in_it():
    detector = Detector()
    with LiveSensor(lambda: ScriptedDriver(with_colour(6))) as sensor, FeatureFeed(sensor, detector) as feed:
        got = [feed.read(5) for _ in range(6)]
        assert feed.dropped == 0 and feed.detect_ms > 0
    assert [(f.sequence, f.features) for f in got] == [(i, ("features of", i)) for i in range(6)]


def test_a_detector_that_fails_ends_the_feed_with_an_error_of_the_package():
    with LiveSensor(lambda: ScriptedDriver(with_colour(6))) as sensor, FeatureFeed(sensor, Detector(fail_at=2)) as feed:
        assert [feed.read(5).sequence for _ in range(2)] == [0, 1]
        for _ in range(2):
            with pytest.raises(FeatureDetectionError, match="scripted: the feature detector failed .graph error"):
                feed.read(5)
        assert not feed.running
