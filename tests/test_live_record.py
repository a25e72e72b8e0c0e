"""Recording and converting: complete, in order, readable after SIGKILL and on a full disk."""

from __future__ import annotations

import errno
import signal
import subprocess
import sys
import textwrap
import threading
import time

import numpy as np
import pytest
from live_faults import CAMERA, ScriptedDriver, small_frame

from adaptiveface.cli import main
from adaptiveface.errors import AdaptiveFaceError, FileFormatError, RecordingError, SensorDisconnectedError
from adaptiveface.sensors import Recording, RecordingWriter
from adaptiveface.sensors import recording as recording_module
from adaptiveface.sensors.live import LiveSensor, RawFrame
from adaptiveface.sensors.record import FrameRecorder, record_sensor


def coloured(sequence: int) -> RawFrame:
    rng = np.random.default_rng(sequence)
    depth = np.round(rng.uniform(400.0, 700.0, (24, 32)), 1)
    colour = np.full((24, 32, 3), 10 * (sequence % 20), np.uint8)
    return RawFrame(depth, CAMERA, colour, sequence, 100.0 + sequence / 30.0)


def sensor_of(steps: list) -> LiveSensor:
    return LiveSensor(lambda: ScriptedDriver(steps), reconnect=False)


def test_a_recording_holds_every_frame_exactly(tmp_path):
    with sensor_of([coloured(i) for i in range(40)]) as sensor:
        summary = record_sensor(sensor, tmp_path / "out")
    recording = Recording(tmp_path / "out")
    assert summary.frames == len(recording) == 40 and summary.dropped == summary.refused == 0
    for i, frame in enumerate(recording):
        np.testing.assert_allclose(frame.depth, coloured(i).depth, atol=1e-3)
        assert frame.timestamp == pytest.approx(100.0 + i / 30.0, abs=2e-6)
        assert abs(int(frame.colour[0, 0, 0]) - 10 * (i % 20)) <= 2  # JPEG


def test_it_stops_after_the_given_number_of_frames(tmp_path):
    with sensor_of([small_frame(i) for i in range(40)]) as sensor:
        assert record_sensor(sensor, tmp_path, frames=7).frames == 7
    assert len(Recording(tmp_path)) == 7


def test_what_came_before_an_error_of_the_sensor_is_kept(tmp_path):
    steps = [coloured(i) for i in range(5)] + [SensorDisconnectedError("scripted: unplugged")]
    with sensor_of(steps) as sensor, pytest.raises(SensorDisconnectedError):
        record_sensor(sensor, tmp_path)
    assert len(list(Recording(tmp_path))) == 5


def test_a_new_image_size_ends_the_recording_with_a_clear_error(tmp_path):
    other = RawFrame(np.full((12, 16), 500.0), type(CAMERA)(16, 12, 15.0, 15.0, 7.5, 5.5), None, 3, 0.1)
    with sensor_of([small_frame(i) for i in range(3)] + [other]) as sensor, pytest.raises(FileFormatError, match="16"):
        record_sensor(sensor, tmp_path)
    assert len(list(Recording(tmp_path))) == 3


def test_a_full_disk_is_a_clear_error_and_what_was_written_stays(tmp_path, monkeypatch):
    real, room = recording_module.write_image, threading.Semaphore(12)

    def disk_with_room_for_twelve_images(path, pixels):
        if not room.acquire(blocking=False):
            raise OSError(errno.ENOSPC, "No space left on device", str(path))
        real(path, pixels)

    monkeypatch.setattr(recording_module, "write_image", disk_with_room_for_twelve_images)
    with sensor_of([coloured(i) for i in range(400)]) as sensor:
        with pytest.raises(RecordingError, match="no space left on the disk after [56] frames, which are kept"):
            record_sensor(sensor, tmp_path)
    assert len(list(Recording(tmp_path))) in (5, 6)  # the twelfth image may belong to a seventh frame


def test_an_image_that_does_not_fit_leaves_no_half_file(tmp_path, monkeypatch):
    def full(self, content):
        with open(self, "wb") as stream:
            stream.write(content[: len(content) // 2])
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("pathlib.Path.write_bytes", full)
    with pytest.raises(AdaptiveFaceError, match="no space"):
        recording_module.write_image(tmp_path / "00000.png", np.ones((24, 32), np.uint16))
    assert list(tmp_path.iterdir()) == []


def test_frames_are_refused_rather_than_piled_up_without_bound(tmp_path, monkeypatch):
    monkeypatch.setattr("adaptiveface.sensors.record.BACKLOG", 3)
    recorder = FrameRecorder(RecordingWriter(tmp_path, CAMERA))
    monkeypatch.setattr(recorder._pool, "submit", lambda *a: _Never())
    with sensor_of([small_frame(i) for i in range(5)]) as sensor:
        kept = [recorder.write(frame) for frame in sensor]
    assert kept == [True] * 3 + [False] * 2 and recorder.refused == 2


class _Never:
    def done(self):
        return False


_ENDLESS = """
    import sys
    sys.path.insert(0, {tests!r})
    from pathlib import Path
    from live_faults import ScriptedDriver
    from test_live_record import coloured
    from adaptiveface.sensors.live import LiveSensor
    from adaptiveface.sensors.record import record_sensor

    class Endless(ScriptedDriver):
        count = 0
        def grab(self, timeout):
            self.count += 1
            return coloured(self.count - 1)

    with LiveSensor(lambda: Endless([])) as sensor:
        record_sensor(sensor, Path({out!r}))
"""


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="no SIGKILL on this system")
@pytest.mark.parametrize("frames", [3, 40, 150])
def test_killed_at_any_moment_the_recording_reads_up_to_its_last_full_frame(tmp_path, frames, request):
    out, tests = tmp_path / "out", str(request.path.parent)
    script = textwrap.dedent(_ENDLESS).format(tests=tests, out=str(out))
    process = subprocess.Popen([sys.executable, "-c", script])
    try:
        deadline = time.monotonic() + 60
        while len(list((out / "depth").glob("*.png"))) < frames and time.monotonic() < deadline:
            assert process.poll() is None
            time.sleep(0.002)
    finally:
        process.kill()
        process.wait()
    recording = Recording(out)
    first = min(int(path.stem) for path in out.glob("*/*.[pj][pn]g"))  # the number of index 0
    readable = [first + frame.index for frame in recording]
    full = sorted({p.stem for p in (out / "depth").glob("*.png")} & {p.stem for p in (out / "color").glob("*.jpg")})
    assert readable == [int(stem) for stem in full] and len(readable) >= frames - 2
    assert len(readable) >= readable[-1] - 1  # at most the frames in the hands of the two writers are missing
    for frame in recording:
        np.testing.assert_allclose(frame.depth, coloured(first + frame.index).depth, atol=1e-3)


def test_the_commands_record_and_convert(tmp_path, capsys):
    with sensor_of([coloured(i) for i in range(6)]) as sensor:
        record_sensor(sensor, tmp_path / "first")
    assert main(["convert", str(tmp_path / "first"), "--out", str(tmp_path / "second")]) == 0
    assert main(["record", str(tmp_path / "first"), "--seconds", "60", "--out", str(tmp_path / "third")]) == 0
    assert "6 frames" in capsys.readouterr().out
    for name in ("second", "third"):
        for a, b in zip(Recording(tmp_path / "first"), Recording(tmp_path / name), strict=True):
            assert np.array_equal(a.depth, b.depth) and a.timestamp == pytest.approx(b.timestamp, abs=2e-6)
    assert main(["convert", str(tmp_path / "first"), "--out", str(tmp_path / "second")]) == 2
    assert "holds files already" in capsys.readouterr().err
    assert main(["convert", str(tmp_path / "nothing"), "--out", str(tmp_path / "fourth")]) == 2
    assert main(["record", "kinect9", "--out", str(tmp_path / "fourth")]) == 2
    assert "possible sensors" in capsys.readouterr().err and not (tmp_path / "fourth").exists()


@pytest.mark.parametrize("live", [True, False])
def test_ctrl_c_ends_the_recording_of_a_sensor_and_breaks_off_that_of_a_file(tmp_path, live):
    class Endless(ScriptedDriver):
        count = -1

        def grab(self, timeout: float) -> RawFrame:
            time.sleep(0.01)
            self.count += 1
            return small_frame(self.count)

    def interrupt(frame) -> None:
        if frame.index == 4:
            signal.raise_signal(signal.SIGINT)

    with LiveSensor(lambda: Endless([], live=live)) as sensor:
        if live:
            assert record_sensor(sensor, tmp_path / "out", on_frame=interrupt).frames == 5
        else:
            with pytest.raises(KeyboardInterrupt):
                record_sensor(sensor, tmp_path / "out", on_frame=interrupt)
    assert len(Recording(tmp_path / "out")) == 5
