"""The thread that owns a sensor: newest frame, nothing stale, errors of the package, reconnecting, closing."""

from __future__ import annotations

import threading
import time

import numpy as np
import pytest
from live_faults import STALL, ScriptedDriver, small_frame

from adaptiveface.errors import (
    AdaptiveFaceError,
    EndOfRecording,
    ParameterError,
    SensorDisconnectedError,
    SensorError,
    SensorNotFoundError,
    SensorTimeoutError,
)
from adaptiveface.sensors import LiveFrame, list_sensors, open_sensor
from adaptiveface.sensors import live as live_module
from adaptiveface.sensors.live import LiveSensor, RawFrame
from adaptiveface.sensors.pairing import Pairing
from adaptiveface.sensors.playback import DEVICE_QUEUE, SyntheticDriver, forth_and_back
from adaptiveface.synthetic.sensor import SyntheticSensor


class Gate(ScriptedDriver):
    """Live: releases one step per ``go()`` and says when it has been grabbed and published."""

    def __init__(self, steps, log=None):
        super().__init__(steps, live=True, log=log)
        self._permits, self._asked = threading.Semaphore(0), threading.Semaphore(0)

    def grab(self, timeout):
        self._asked.release()
        if not self._permits.acquire(timeout=timeout):
            self._asked.acquire()
            return None
        return super().grab(timeout)

    def go(self, count=1):
        for _ in range(count):
            self._asked.acquire()
            self._permits.release()
        self._asked.acquire()  # asking again: the last step has been published
        self._asked.release()


def test_frames_of_a_file_come_whole_and_in_order_until_the_end():
    with LiveSensor(lambda: ScriptedDriver([small_frame(i, 500.0 + i) for i in range(5)])) as sensor:
        frames = list(sensor)
        with pytest.raises(EndOfRecording):
            sensor.read()
    assert [(f.index, f.sequence, f.dropped, float(f.depth[0, 0])) for f in frames] == [(i, i, 0, 500.0 + i) for i in range(5)]


def test_a_frame_owns_clean_arrays():
    given = small_frame(0)
    given.depth[0, :4] = np.nan, np.inf, -3.0, 0.0
    driver_copy = given.depth
    with LiveSensor(lambda: ScriptedDriver([given])) as sensor:
        frame = sensor.read()
    driver_copy[:] = 7.0  # the vendor reuses its memory
    assert isinstance(frame, LiveFrame) and frame.depth.dtype == np.float32
    assert (frame.depth[0, :4] == 0).all() and (frame.depth[1:] == 500.0).all()


def test_a_live_sensor_hands_out_the_newest_frame_and_counts_the_dropped():
    gate = Gate([small_frame(i) for i in (0, 1, 2, 5)])
    with LiveSensor(lambda: gate, max_age=60) as sensor:
        gate.go(3)
        first = sensor.read()
        gate.go()
        second = sensor.read()
    assert (first.sequence, first.dropped) == (2, 2)  # 0 and 1 were replaced
    assert (second.sequence, second.dropped) == (5, 4)  # the device lost 3 and 4
    assert (first.index, second.index) == (0, 1)
    assert second.host_timestamp > first.host_timestamp


def test_with_a_buffer_every_frame_waits_until_it_is_read():
    gate = Gate([small_frame(i) for i in range(6)])
    with LiveSensor(lambda: gate, max_age=0.0) as sensor:
        sensor.buffer(4)
        gate.go(6)
        frames = [sensor.read(1) for _ in range(4)]
    assert [f.sequence for f in frames] == [2, 3, 4, 5] and frames[-1].dropped == 2


def test_duplicates_and_late_frames_are_never_handed_out():
    steps = [small_frame(i) for i in (0, 1, 1, 3, 2, 4, 4, 3, 5)]
    with LiveSensor(lambda: ScriptedDriver(steps)) as sensor:
        frames = list(sensor)
        assert sensor.discarded == 4
    assert [f.sequence for f in frames] == [0, 1, 3, 4, 5]


def test_a_counter_that_starts_over_is_not_a_late_frame():
    with LiveSensor(lambda: ScriptedDriver([small_frame(i) for i in (1000, 1001, 0, 1)])) as sensor:
        assert [f.sequence for f in sensor] == [1000, 1001, 0, 1]


def test_frames_whose_size_is_not_that_of_their_camera_are_discarded():
    broken = small_frame(1)
    object.__setattr__(broken, "depth", np.zeros((5, 5)))
    with LiveSensor(lambda: ScriptedDriver([small_frame(0), broken, small_frame(2)])) as sensor:
        assert [f.sequence for f in sensor] == [0, 2]
        assert sensor.discarded == 1


def test_a_stale_frame_is_an_error_not_a_frame():
    gate = Gate([small_frame(0), small_frame(1)])
    with LiveSensor(lambda: gate, max_age=0.0) as sensor:
        gate.go()
        with pytest.raises(SensorTimeoutError, match="no new frame"):
            sensor.read(0.05)
        assert sensor.dropped == 1


def test_a_stalled_sensor_times_out_and_then_goes_on():
    gate = Gate([STALL, small_frame(0)])
    with LiveSensor(lambda: gate, max_age=60) as sensor:
        gate.go()
        with pytest.raises(SensorTimeoutError, match="scripted"):
            sensor.read(0.01)
        gate.go()
        assert sensor.read().sequence == 0


def test_unplugging_tears_down_says_so_once_and_resumes():
    log, steps = [], [small_frame(7), SensorDisconnectedError("scripted: unplugged"), small_frame(0), small_frame(1)]
    with LiveSensor(lambda: ScriptedDriver(steps, log=log)) as sensor:
        assert sensor.read().sequence == 7
        with pytest.raises(SensorDisconnectedError, match="unplugged"):
            sensor.read()
        assert [sensor.read(10).sequence for _ in range(2)] == [0, 1]
    assert log[:3] == ["open", "close", "open"]


def test_a_bare_exception_of_the_vendor_becomes_the_packages_own():
    with LiveSensor(lambda: ScriptedDriver([RuntimeError("usb 0x13")]), reconnect=False) as sensor:
        with pytest.raises(SensorDisconnectedError, match="scripted: the driver failed .usb 0x13."):
            sensor.read()


def test_an_unplugged_sensor_that_stays_away_is_reported_as_disconnected():
    class Away(ScriptedDriver):
        def open(self):
            if len(self.log) > 0:
                raise SensorNotFoundError("scripted: not connected")
            super().open()

    log = []
    with LiveSensor(lambda: Away([SensorDisconnectedError("gone")], log=log)) as sensor:
        with pytest.raises(SensorDisconnectedError, match="gone"):
            sensor.read(5)
        with pytest.raises(SensorDisconnectedError, match="waiting for it to come back"):
            sensor.read(0.05)


def test_a_sensor_that_cannot_be_opened_raises_at_once_and_leaves_no_thread():
    class Missing(ScriptedDriver):
        def open(self):
            raise SensorNotFoundError("scripted: no device is connected; plug it in")

    before = threading.active_count()
    with pytest.raises(SensorNotFoundError, match="plug it in"):
        LiveSensor(lambda: Missing([]))
    assert threading.active_count() == before


def test_closing_twice_wakes_the_reader_and_stops_the_thread():
    log = []
    sensor = LiveSensor(lambda: ScriptedDriver([STALL] * 10_000_000, log=log))
    raised = []

    def wait():
        try:
            sensor.read(60)
        except AdaptiveFaceError as error:
            raised.append(error)

    reader = threading.Thread(target=wait)
    reader.start()
    sensor.close()
    sensor.close()
    reader.join(60)
    assert isinstance(raised[0], SensorError) and "closed" in str(raised[0])
    assert log == ["open", "close"] and not sensor._worker.alive


def test_closing_does_not_wait_for_a_library_that_hangs():
    release = threading.Event()

    class Hanging(ScriptedDriver):
        def grab(self, timeout):
            release.wait(30)

    sensor = LiveSensor(lambda: Hanging([]))
    sensor.close()
    assert not release.is_set() and sensor._worker.alive  # close returned although the library still hangs
    release.set()
    sensor._worker.join(60)
    assert not sensor._worker.alive


@pytest.fixture(scope="module")
def short_performance():
    return SyntheticSensor(3, neutral_frames=3, frames=2, repeats=1, width=160, height=120, colour=False)


def test_the_synthetic_sensor_is_paced_by_the_clock_and_skips_what_nobody_took(short_performance):
    now, frames = [100.0], {}
    driver = SyntheticDriver(short_performance, frames, clock=lambda: now[0])
    driver.open()
    assert len(frames) == 5 and driver.grab(0).sequence == 0
    assert driver.grab(0.0) is None  # the next one is due after 1/30 s
    now[0] += 2.01
    late = driver.grab(0)
    assert late.sequence == 60 - DEVICE_QUEUE
    assert np.array_equal(late.depth, frames[forth_and_back(60 - DEVICE_QUEUE, 5)].depth)
    assert [forth_and_back(i, 5) for i in range(10)] == [0, 1, 2, 3, 4, 3, 2, 1, 0, 1]


def test_the_synthetic_sensor_opens_before_all_is_rendered(short_performance):
    """Whoever starts it waits for the first frames only; the others are rendered when they are due, each once."""
    now, frames = [100.0], {}
    driver = SyntheticDriver(short_performance, frames, clock=lambda: now[0], ahead=2)
    driver.open()
    assert list(frames) == [0, 1]
    now[0] += (3 + DEVICE_QUEUE) / 30 + 0.01
    late = driver.grab(0)
    assert late.sequence == 3 and list(frames) == [0, 1, 3]
    assert np.array_equal(late.depth, short_performance.read(3).depth)
    kept = frames[3]
    again = SyntheticDriver(short_performance, frames, clock=lambda: now[0], ahead=2)
    again.open()
    now[0] += (3 + DEVICE_QUEUE) / 30 + 0.01
    assert again.grab(0).sequence == 3 and frames[3] is kept


def test_the_live_synthetic_sensor_streams_through_its_thread(short_performance):
    frames = {}
    with LiveSensor(lambda: SyntheticDriver(short_performance, frames), max_age=60) as sensor:
        got = [sensor.read(30) for _ in range(4)]
    assert (np.diff([f.sequence for f in got]) > 0).all() and (np.diff([f.device_timestamp for f in got]) > 0).all()
    assert got[-1].sequence + 1 == len(got) + got[-1].dropped
    assert got[0].features is not None and sensor.has_features


def test_opening_by_name():
    assert "synthetic" in [info.name for info in list_sensors() if info.ready]
    with pytest.raises(SensorError, match="kinect9.*possible sensors"):
        open_sensor("kinect9")
    with pytest.raises(ParameterError, match="seed 'x'"):
        open_sensor("synthetic:x")
    with pytest.raises(ParameterError, match="unknown noise"):
        open_sensor("synthetic:1:loud")


def test_a_recording_plays_as_a_sensor(mannequin):
    with open_sensor(str(mannequin)) as sensor:
        assert not sensor.live
        started = time.perf_counter()
        first, second = sensor.read(30), sensor.read(30)
    assert (first.index, second.index) == (0, 1) and second.timestamp > first.timestamp
    assert first.host_timestamp >= started - 30 and first.colour.shape[:2] == first.depth.shape


def test_a_recording_is_waited_for_longer_than_a_sensor(monkeypatch):
    """On a busy machine reading a frame may take seconds; none is lost for it."""
    monkeypatch.setattr(live_module, "LIVE_SECONDS", 0.05)

    class Slow(ScriptedDriver):
        def grab(self, timeout: float) -> RawFrame | None:
            time.sleep(0.1)
            return super().grab(timeout)

    with LiveSensor(lambda: Slow([small_frame(0), STALL, STALL, small_frame(1)])) as sensor:
        assert [frame.sequence for frame in sensor] == [0, 1]
    with LiveSensor(lambda: Slow([STALL] * 50, live=True)) as sensor:
        with pytest.raises(SensorTimeoutError, match="no new frame within 0.05 s"):
            sensor.read()


def test_interrupted_while_it_opens_it_is_closed(monkeypatch):
    """Ctrl-C, or a cell of a notebook that is interrupted."""
    log: list = []

    class Booting(ScriptedDriver):
        def open(self) -> None:
            super().open()
            time.sleep(0.2)

    def interrupt(self, condition, timeout=None):
        if threading.current_thread() is threading.main_thread():
            raise KeyboardInterrupt
        return wait_for(self, condition, timeout)

    wait_for = threading.Condition.wait_for
    monkeypatch.setattr(threading.Condition, "wait_for", interrupt)
    with pytest.raises(KeyboardInterrupt):
        LiveSensor(lambda: Booting([], live=True, log=log))
    assert log == ["open", "close"]


@pytest.mark.parametrize("late", [0, 1, 3, -2])
def test_colour_that_is_delivered_apart_from_its_depth_finds_it(late):
    """Under load the streams of a camera start apart, and stay apart by a frame or more."""
    pairing, pairs = Pairing(0.6 / 30), []
    for step in range(-2, 16):
        for stream, number in ((pairing.depth, step), (pairing.colour, step - late)):
            if 0 <= number < 12:
                stream.append((number, number / 30))
                pairs += [] if (found := pairing.take()) is None else [found]
    assert [(depth[0], colour[0]) for depth, colour in pairs] == [(number, number) for number in range(12)]


def test_what_has_no_partner_is_forgotten():
    pairing = Pairing(0.6 / 30)
    pairing.depth.extend((number, number / 30) for number in (0, 1, 2))
    pairing.colour.append((2, 2 / 30 + 0.015))
    assert pairing.take() == ((2, 2 / 30), (2, 2 / 30 + 0.015)) and not pairing.depth and pairing.take() is None
