"""RealSense through the vendor's real SDK, fed by its software device: no camera needed."""

from __future__ import annotations

import sys
import threading
import time

import numpy as np
import pytest
from equivalence import performance, units_of

from adaptiveface.cli import main
from adaptiveface.errors import DriverMissingError, FileFormatError, SensorNotFoundError, SensorTimeoutError
from adaptiveface.sensors import Recording, list_sensors, open_sensor, open_source
from adaptiveface.sensors.live import LiveSensor
from adaptiveface.sensors.realsense import RealSenseDriver

rs = pytest.importorskip("pyrealsense2", reason="pyrealsense2 is not installed (the extra 'realsense')")
W, H, FPS = 640, 480, 30


class FakeCamera:
    """The SDK's software device with a depth and a colour stream; ``baseline`` mm from depth to colour."""

    def __init__(self, units: float = 0.001, baseline: float = 0.0) -> None:
        self.device = rs.software_device()
        self.units = units
        self.depth_sensor = self.device.add_sensor("Stereo Module")
        self.colour_sensor = self.device.add_sensor("RGB Camera")
        depth, colour = self._stream(rs.stream.depth, 0, rs.format.z16, 2), self._stream(rs.stream.color, 1, rs.format.rgb8, 3)
        self.depth = self.depth_sensor.add_video_stream(depth).as_video_stream_profile()
        self.colour = self.colour_sensor.add_video_stream(colour).as_video_stream_profile()
        self.depth_sensor.add_read_only_option(rs.option.depth_units, units)
        self.depth_sensor.add_read_only_option(rs.option.stereo_baseline, 50.0)
        pose = rs.extrinsics()
        pose.rotation, pose.translation = [1, 0, 0, 0, 1, 0, 0, 0, 1], [baseline / 1000, 0, 0]
        self.depth.register_extrinsics_to(self.colour, pose)
        self.device.create_matcher(rs.matchers.default)

    def _stream(self, kind, uid, layout, bytes_per_pixel):
        i = rs.intrinsics()
        i.width, i.height, i.fx, i.fy, i.ppx, i.ppy = W, H, 525.0, 525.0, 319.5, 239.5
        i.model, i.coeffs = rs.distortion.none, [0.0] * 5
        stream = rs.video_stream()
        stream.type, stream.uid, stream.index, stream.intrinsics = kind, uid, 0, i
        stream.width, stream.height, stream.fps, stream.bpp, stream.fmt = W, H, FPS, bytes_per_pixel, layout
        return stream

    def push(self, number: int, depth: np.ndarray, colour: np.ndarray | None) -> None:
        """``depth`` (H, W) uint16 units; without ``colour`` the colour stream stalls."""
        self._push(self.depth_sensor, self.depth, number, depth, 2)
        if colour is not None:
            self._push(self.colour_sensor, self.colour, number, colour, 3)

    def _push(self, sensor, profile, number, pixels, bytes_per_pixel):
        frame = rs.software_video_frame()
        frame.pixels, frame.bpp, frame.stride = np.ascontiguousarray(pixels), bytes_per_pixel, W * bytes_per_pixel
        frame.timestamp, frame.frame_number, frame.profile = number * 1000 / FPS, number, profile
        frame.domain, frame.depth_units = rs.timestamp_domain.hardware_clock, self.units
        sensor.on_video_frame(frame)

    def sensor(self) -> LiveSensor:
        return LiveSensor(lambda: RealSenseDriver(device=self.device), max_age=60)


BLACK = np.zeros((H, W, 3), np.uint8)


def flat(value: int) -> np.ndarray:
    return np.full((H, W), value, np.uint16)


@pytest.mark.parametrize("units", [0.001, 0.0001])
def test_depth_in_millimetres_with_calibration_and_clock(units):
    camera = FakeCamera(units)
    depth = np.random.default_rng(0).integers(300, 6000, (H, W)).astype(np.uint16)
    depth[0, 0] = 0
    with camera.sensor() as sensor:
        camera.push(5, depth, BLACK + 90)
        frame = sensor.read(10)
        assert sensor.depth_scale == round(1 / units)  # a recording keeps these steps
    np.testing.assert_array_equal(frame.depth, depth * np.float32(units * 1000))
    assert (frame.camera.fx, frame.camera.cx, frame.camera.cy) == (525, 319.5, 239.5)
    assert frame.sequence == 5 and frame.device_timestamp == pytest.approx(5 / FPS)
    assert (frame.colour[1:, 1:] == 90).all()


def test_colour_is_aligned_to_depth():
    """A bright edge of the colour picture appears where depth sees it: shifted by f * baseline / z pixels."""
    camera, colour = FakeCamera(baseline=40.0), BLACK.copy()
    colour[:, 400:] = 255
    with camera.sensor() as sensor:
        camera.push(0, flat(700), colour)
        frame = sensor.read(10)
    edge = int(np.argmax(frame.colour[240, :, 0] > 127))
    assert abs(edge - (400 - 525 * 40 / 700)) <= 1  # 30 pixels


def test_a_picture_of_another_moment_is_not_served_as_new():
    camera = FakeCamera()
    with camera.sensor() as sensor:
        camera.push(0, flat(500), BLACK)
        assert sensor.read(10).sequence == 0
        for number in range(10, 14):  # the colour stream stalls
            camera.push(number, flat(500), None)
        with pytest.raises(SensorTimeoutError):
            sensor.read(0.5)
        camera.push(20, flat(500), BLACK)
        assert sensor.read(10).sequence == 20


def test_closing_and_opening_again():
    camera, threads = FakeCamera(), threading.active_count()
    for number in range(2):
        with camera.sensor() as sensor:
            camera.push(number, flat(500), BLACK)
            assert sensor.read(10).sequence == number
        sensor._worker.join(60)
    assert threading.active_count() == threads


def test_no_camera_connected():
    if len(rs.context().query_devices()):
        pytest.skip("a RealSense camera is connected")
    with pytest.raises(SensorNotFoundError, match="no RealSense camera is connected"):
        open_sensor("realsense")
    with pytest.raises(SensorNotFoundError):
        open_sensor("realsense:123456")
    assert {info.name: info.state for info in list_sensors()}["realsense"] == "not connected"


def test_without_the_driver_the_pip_line_is_given(monkeypatch):
    monkeypatch.setitem(sys.modules, "pyrealsense2", None)
    with pytest.raises(DriverMissingError, match=r'pip install "adaptiveface\[realsense\]"'):
        open_sensor("realsense")
    assert "adaptiveface[realsense]" in {info.name: info.state for info in list_sensors()}["realsense"]


@pytest.mark.parametrize("suffix", [".db3", ".bag"])
def test_files_that_are_not_recordings(tmp_path, suffix):
    (tmp_path / f"bad{suffix}").write_bytes(b"nothing of the kind" * 100)
    with pytest.raises(FileFormatError, match="bad.*not a RealSense recording"):
        open_sensor(str(tmp_path / f"bad{suffix}"))
    with pytest.raises(FileFormatError, match="adaptiveface convert"):
        open_source(str(tmp_path / f"bad{suffix}"))


# ---- the same performance, as a recording and through the SDK --------------------------------------------------------
@pytest.mark.parametrize("per_metre", [1000, 10_000])
def test_the_live_sdk_tracks_to_the_same_result(per_metre):
    p, camera, got = performance(), FakeCamera(1 / per_metre), []
    with camera.sensor() as sensor:
        for number, frame in enumerate(p.frames):
            camera.push(number, units_of(frame, per_metre), BLACK)
            got.append(sensor.read(10))
    result = p.compare(got, per_metre)
    print(f"\nRealSense, software device, {per_metre} units per metre: {result}")
    assert result.worst < 0.2 and result.frames == len(p)


@pytest.fixture(scope="module")
def db3(tmp_path_factory):
    """The performance recorded by the SDK itself, depth in whole millimetres."""
    path, camera = tmp_path_factory.mktemp("db3") / "take.db3", FakeCamera()
    pipeline, config = rs.pipeline(), rs.config()
    pipeline.set_device(camera.device)
    config.enable_stream(rs.stream.depth, W, H, rs.format.z16, FPS)
    config.enable_stream(rs.stream.color, W, H, rs.format.rgb8, FPS)
    try:
        config.enable_record_to_file(str(path))
        pipeline.start(config)
    except RuntimeError as error:
        pytest.skip(f"this pyrealsense2 does not write .db3 ({error})")
    for number, frame in enumerate(performance().frames):
        camera.push(number, units_of(frame, 1000), BLACK)
        pipeline.wait_for_frames(5000)
    pipeline.stop()
    del pipeline, config, camera
    return path


def test_playback_of_a_recording_tracks_to_the_same_result(db3):
    p = performance()
    with open_sensor(str(db3)) as sensor:
        got = list(sensor)
    assert [f.sequence for f in got] == list(range(len(p)))
    result = p.compare(got, 1000)
    print(f"\nRealSense, .db3 playback: {result}")
    assert result.worst < 0.2


def test_playback_waits_until_every_stream_has_started(db3, monkeypatch):
    """The SDK starts one stream after the other; a file that is read meanwhile loses its first frames."""
    start, before = rs.pipeline.start, []

    def slow_start(pipeline, config):
        profile = start(pipeline, config)
        time.sleep(0.2)
        before.append((profile.get_device().as_playback().current_status(), pipeline.poll_for_frames().size()))
        return profile

    monkeypatch.setattr(rs.pipeline, "start", slow_start)
    with LiveSensor(lambda: RealSenseDriver(path=db3), reconnect=False) as sensor:
        assert sensor.read().sequence == 0
    assert before == [(rs.playback_status.paused, 0)]


def test_convert_keeps_every_depth_value(db3, tmp_path, capsys):
    p = performance()
    assert main(["convert", str(db3), "--out", str(tmp_path / "out")]) == 0
    assert f"{len(p)} frames" in capsys.readouterr().out
    for given, converted in zip(p.quantised(1000), Recording(tmp_path / "out"), strict=True):
        np.testing.assert_array_equal(given.depth, converted.depth)
