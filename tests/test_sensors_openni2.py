"""OpenNI2 through the vendor's real library: recordings written in pure Python, and the library's own dummy camera."""

from __future__ import annotations

import ctypes
import math
import os
import subprocess
import sys
import time

import numpy as np
import pytest
from equivalence import performance, units_of
from oni_writer import DEPTH_1_MM, DEPTH_100_UM, YUV422, OniWriter

from adaptiveface.cli import main
from adaptiveface.errors import (
    DriverMissingError,
    EndOfRecording,
    FileFormatError,
    ParameterError,
    SensorError,
    SensorNotFoundError,
)
from adaptiveface.sensors import LiveSensor, Recording, list_sensors, open_sensor, open_source, openni2
from adaptiveface.sensors.file_player import FilePlayer
from adaptiveface.sensors.openni2 import best_modes, connected_cameras
from adaptiveface.sensors.openni2_library import OpenNI2Error, VideoMode

try:
    CONNECTED = connected_cameras()
except DriverMissingError as missing:
    pytest.skip(str(missing), allow_module_level=True)

W, H, FRAMES, PERIOD = 160, 120, 8, 33_333
FOV = 2 * math.atan(80 / 131.25), 2 * math.atan(60 / 131.25)
RNG = np.random.default_rng(0)
DEPTH = RNG.integers(300, 6000, (FRAMES, H, W)).astype(np.uint16)
COLOUR = RNG.integers(0, 255, (FRAMES, H, W, 3)).astype(np.uint8)


def write(path, depth=range(FRAMES), colour=range(FRAMES), size=(W, H), **options):
    """A recording of some of the frames; pictures come 5 ms after their depth."""
    streams = {"depth": size, **({"colour": (W, H)} if colour else {})}
    with OniWriter(path, streams, FOV, **options) as writer:
        for n in range(FRAMES):
            if n in depth:
                writer.write("depth", DEPTH[n] if size == (W, H) else np.zeros(size[::-1], np.uint16), n * PERIOD)
            if n in colour:
                writer.write("colour", COLOUR[n], n * PERIOD + 5000)
    return str(path)


def play(path) -> list:
    with open_sensor(str(path)) as sensor:
        return list(sensor)


@pytest.mark.parametrize("pixel_format,scale", [(DEPTH_1_MM, 1000), (DEPTH_100_UM, 10_000)])
def test_every_frame_arrives_exactly_however_late_it_is_read(tmp_path, pixel_format, scale):
    path, got = write(tmp_path / "take.oni", formats={"depth": pixel_format}), []
    with open_sensor(path) as sensor:
        for frame in sensor:
            got.append(frame)
            time.sleep(0.05 if frame.sequence == 3 else 0)
        assert (sensor.fps, sensor.depth_scale, sensor.dropped, sensor.live) == (30, scale, 0, False)
        with pytest.raises(EndOfRecording, match="take.oni: the end of the recording"):
            sensor.read(1)
    assert [frame.sequence for frame in got] == list(range(1, FRAMES + 1))
    for n, frame in enumerate(got):
        np.testing.assert_array_equal(frame.depth, DEPTH[n] * np.float32(1000 / scale))
        np.testing.assert_array_equal(frame.colour, COLOUR[n])
        assert frame.device_timestamp == pytest.approx(n * PERIOD * 1e-6)


def test_calibration_from_the_field_of_view(tmp_path):
    camera = play(write(tmp_path / "take.oni"))[0].camera
    assert (camera.fx, camera.fy) == pytest.approx((131.25, 131.25), rel=1e-6)
    assert (camera.cx, camera.cy) == (79.5, 59.5)


def test_a_mirrored_recording_is_turned_round(tmp_path):
    for n, frame in enumerate(play(write(tmp_path / "take.oni", mirror=1))):
        np.testing.assert_array_equal(frame.depth, DEPTH[n][:, ::-1])
        np.testing.assert_array_equal(frame.colour, COLOUR[n][:, ::-1])


def test_depth_without_colour(tmp_path):
    got = play(write(tmp_path / "take.oni", colour=()))
    assert len(got) == FRAMES and got[0].colour is None


def test_frames_without_their_counterpart_are_left_out(tmp_path):
    """A picture of another moment is never served with a depth."""
    path = write(tmp_path / "take.oni", depth=[0, 1, 2, 4, 5, 6, 7], colour=[0, 2, 3, 4, 5, 6])
    got = play(path)
    assert [round(frame.timestamp * 30) for frame in got] == [0, 2, 4, 5, 6]
    for frame in got:
        np.testing.assert_array_equal(frame.colour, COLOUR[round(frame.timestamp * 30)])


def test_convert_keeps_every_depth_value(tmp_path, capsys):
    path = write(tmp_path / "take.oni")
    assert main(["convert", path, "--out", str(tmp_path / "out")]) == 0
    assert f"{FRAMES} frames" in capsys.readouterr().out
    for n, frame in enumerate(Recording(tmp_path / "out")):
        np.testing.assert_array_equal(frame.depth, DEPTH[n])
        assert np.abs(frame.colour.mean() - COLOUR[n].mean()) < 5 and frame.camera.fx == pytest.approx(131.25)
    with pytest.raises(FileFormatError, match="adaptiveface convert .*take.oni --out .*take; then use .*take$"):
        open_source(path)


def test_files_that_are_not_recordings(tmp_path):
    (tmp_path / "bad.oni").write_bytes(b"nothing of the kind" * 100)
    with pytest.raises(FileFormatError, match="bad.oni: not a complete OpenNI2 recording"):
        open_sensor(str(tmp_path / "bad.oni"))
    (tmp_path / "empty.oni").touch()
    with pytest.raises(FileFormatError, match="empty.oni"):
        open_sensor(str(tmp_path / "empty.oni"))


@pytest.mark.parametrize(
    "options,reason",
    [
        ({"formats": {"colour": YUV422}}, "colour in the pixel format 201 is not supported"),
        ({"size": (2 * W, 2 * H)}, "depth and colour of 320 x 240 and 160 x 120 pixels"),
    ],
)
def test_recordings_that_cannot_be_used(tmp_path, options, reason):
    with pytest.raises(FileFormatError, match=f"take.oni.*{reason}"):
        open_sensor(write(tmp_path / "take.oni", **options))


def test_a_recording_cut_off_in_the_middle_is_refused(tmp_path):
    """The library needs the tables at the end of the file."""
    path = tmp_path / "take.oni"
    write(path)
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    with pytest.raises(FileFormatError, match="take.oni: not a complete OpenNI2 recording"):
        open_sensor(str(path))


def test_a_recording_whose_frames_the_library_does_not_deliver(tmp_path, monkeypatch):
    """It needs the property xnCropping of each stream, and says nothing where it is missing."""
    monkeypatch.setattr(openni2, "PLAYBACK_PATIENCE", 1.0)
    path = tmp_path / "take.oni"
    write(path)
    path.write_bytes(path.read_bytes().replace(b"xnCropping", b"noCropping"))
    with LiveSensor(lambda: openni2.OpenNI2Driver(path=path), reconnect=False) as sensor:
        with pytest.raises(FileFormatError, match="take.oni: plays no depth"):
            sensor.read()


def test_a_recording_that_plays_its_colour_only(tmp_path):
    """Again and again: without an end of its own."""
    path = tmp_path / "take.oni"
    write(path)
    path.write_bytes(path.read_bytes().replace(b"xnCropping", b"noCropping", 1))
    with open_sensor(str(path)) as sensor, pytest.raises(FileFormatError, match="take.oni: plays no depth"):
        sensor.read()


def test_a_damaged_recording_that_crashes_the_library_is_an_error_that_names_it(tmp_path, capsys):
    """A property whose name does not end, for one."""
    path = tmp_path / "damaged.oni"
    write(path)
    path.write_bytes(path.read_bytes().replace(b"xnDeviceMaxDepth\0", b"xnDeviceMaxDepth\xf1"))
    assert main(["convert", str(path), "--out", str(tmp_path / "out")]) == 2
    error = capsys.readouterr().err
    assert f"{path}: " in error and error.count("\n") == 1 and not (tmp_path / "out").exists()
    if sys.platform == "linux":
        assert "the OpenNI2 library crashed or hung while reading it, when it was opened; it is damaged" in error


def test_a_library_that_dies_in_the_midst_is_an_error_and_leaves_no_process(tmp_path):
    player = FilePlayer(write(tmp_path / "take.oni"))
    player.open()
    child, frame = player._child, None
    while frame is None:
        frame = player.grab(1.0)
    np.testing.assert_array_equal(frame.depth, DEPTH[0])
    child.kill()
    with pytest.raises(SensorError, match="take.oni: the OpenNI2 library crashed or hung while reading it, after . frames"):
        while True:
            player.grab(1.0)
    player.close()
    player.close()
    assert child.poll() is not None


def test_the_player_ends_with_the_process_that_started_it(tmp_path):
    player = FilePlayer(write(tmp_path / "take.oni"))
    player.open()
    player._child.stdin.close()  # as the system does when that process is gone
    assert player._child.wait(120) == 1
    player.close()


@pytest.mark.skipif(os.name != "posix", reason="the C library's sleep")
def test_a_library_that_hangs_is_an_error(tmp_path):
    """Even one that never gives Python's interpreter back, as the RealSense library on some damaged files."""
    code = f"""
import ctypes, sys, types
from pathlib import Path
from adaptiveface.sensors import file_player

class Hangs:
    def __init__(self, path): pass
    def open(self): ctypes.PyDLL(None).sleep(600)

module = sys.modules["adaptiveface.sensors.hangs"] = types.ModuleType("hangs")
module.Hangs = Hangs
file_player.PLAYERS[".oni"] = ("hangs", "Hangs", "hanging")
file_player.PATIENCE_SECONDS = 0.5
file_player.main(Path({str(tmp_path / "take.oni")!r}))
"""
    player = FilePlayer(tmp_path / "take.oni")
    player._command = [sys.executable, "-c", code]
    with pytest.raises(SensorError, match="crashed or hung while reading it, when it was opened"):
        player.open()
    assert player._child.wait(120) == 1
    player.close()


def test_what_is_no_message_is_a_crash(tmp_path):
    """Whatever a child that has lost its mind may write."""
    player = FilePlayer(write(tmp_path / "take.oni"))
    for line in (b"", b"[]", b"7", b"{}", b'{"kind": "frame"}', b"x" * 10_000, b'{"kind": "error", "error": "os"}'):
        with subprocess.Popen(
            [sys.executable, "-c", f"import sys; sys.stdout.buffer.write({line!r})"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
        ) as child:
            player._child = child
            with pytest.raises(SensorError, match="crashed"):
                player._message()


def test_closing_is_quick_and_may_be_repeated(tmp_path):
    path = write(tmp_path / "take.oni")
    for _ in range(3):
        sensor = open_sensor(path)
        assert sensor.read(5).sequence == 1
        sensor.close()
        sensor.close()
        sensor._worker.join(60)
        assert not sensor._worker.alive


def test_no_camera_connected():
    if CONNECTED:
        pytest.skip("an OpenNI2 camera is connected")
    for text in ("openni2", "openni2:1", "openni2:1d27/0609@1/2"):
        with pytest.raises(SensorNotFoundError, match="no such OpenNI2 camera is connected .found: none"):
            open_sensor(text)
    assert {info.name: info.state for info in list_sensors()}["openni2"] == "not connected"


def test_a_recording_is_not_a_camera(tmp_path):
    with pytest.raises(ParameterError, match="is a recording; give its path alone"):
        open_sensor("openni2:" + write(tmp_path / "take.oni"))


def test_without_the_library_the_install_line_is_given(monkeypatch, tmp_path):
    def refuse(name, *_, **__):
        raise OSError(f"{name}: cannot open shared object file")

    monkeypatch.setattr(ctypes, "CDLL", refuse)
    with pytest.raises(DriverMissingError, match="OPENNI2_REDIST"):
        open_sensor("openni2")
    if sys.platform == "linux":
        with pytest.raises(DriverMissingError, match="apt install libopenni2-0"):
            open_sensor("openni2")
    assert "OpenNI2 needs its library" in {info.name: info.state for info in list_sensors()}["openni2"]
    monkeypatch.setenv("OPENNI2_REDIST", str(tmp_path))
    with pytest.raises(DriverMissingError, match=f"{tmp_path}.* holds no"):
        open_sensor("openni2")


def test_the_video_mode_nearest_to_640_by_480_with_a_picture():
    depths = [
        VideoMode(100, 320, 240, 30),
        VideoMode(100, 640, 480, 30),
        VideoMode(101, 640, 480, 30),
        VideoMode(102, 640, 480, 30),
        VideoMode(101, 640, 480, 60),
    ]
    colours = [VideoMode(200, 1280, 1024, 30), VideoMode(201, 640, 480, 30), VideoMode(200, 320, 240, 30)]
    assert best_modes(depths, colours) == [depths[0], colours[2]]
    assert best_modes(depths, [*colours, VideoMode(200, 640, 480, 30)])[0] == depths[2]
    assert best_modes(depths, []) == [depths[2]]
    with pytest.raises(OpenNI2Error, match="no video mode"):
        best_modes(depths, colours[:2])


_LIVE = """
import os, sys
from adaptiveface.geometry.camera import Camera
from adaptiveface.errors import SensorError
from adaptiveface.sensors import open_sensor
from adaptiveface.sensors.openni2 import OpenNI2Driver
try:
    open_sensor("openni2:Dummy")
except SensorError as error:
    print(error)
OpenNI2Driver._register = lambda self, device: None
OpenNI2Driver._calibration = lambda self, mode: Camera(mode.width, mode.height, 262.5, 262.5, 159.5, 119.5)
sensor = open_sensor("openni2:Dummy")
frames = [sensor.read(5) for _ in range(5)]
print(*(f.sequence - frames[0].sequence for f in frames))
print(sensor.live, sensor.dropped >= frames[-1].sequence - frames[0].sequence - 4)
print(frames[0].depth.shape, frames[0].colour.shape, frames[0].depth.max(), frames[0].colour[0, 0].tolist())
sys.stdout.flush()
os._exit(0)
"""


def test_the_library_s_dummy_camera_streams_live():
    """A camera that can neither register nor tell its field of view, so that both are given here; everything else is
    the live path. In a process of its own, as the dummy crashes when it is closed while streaming."""
    run = subprocess.run([sys.executable, "-c", _LIVE], capture_output=True, text=True, timeout=300)
    if "no such OpenNI2 camera" in run.stdout + run.stderr:
        pytest.skip("this OpenNI2 has no dummy device")
    refusal, numbers, counted, images = run.stdout.strip().splitlines()[-4:]
    assert "cannot register its depth to its colour" in refusal
    assert [int(n) for n in numbers.split()] == sorted({int(n) for n in numbers.split()}) and counted == "True True"
    assert images == "(240, 320) (240, 320, 3) 2000.0 [0, 0, 255]"


@pytest.mark.slow
@pytest.mark.parametrize("pixel_format,scale", [(DEPTH_1_MM, 1000), (DEPTH_100_UM, 10_000)])
def test_the_same_performance_tracks_to_the_same_result(tmp_path, capsys, pixel_format, scale):
    p = performance()
    size = p.camera.width, p.camera.height
    fov = [2 * math.atan(n / 2 / focal) for n, focal in zip(size, (p.camera.fx, p.camera.fy), strict=True)]
    picture = np.zeros((*size[::-1], 3), np.uint8)
    with OniWriter(tmp_path / "p.oni", {"depth": size, "colour": size}, fov, formats={"depth": pixel_format}) as writer:
        for n, frame in enumerate(p.frames):
            writer.write("depth", units_of(frame, scale), n * PERIOD)
            writer.write("colour", picture, n * PERIOD + 5000)
    got = play(tmp_path / "p.oni")
    compared = p.compare(got, scale, [frame.sequence - 1 for frame in got])
    with capsys.disabled():
        print(f"\nOpenNI2, {1000 / scale:g} mm: {compared}")
    assert compared.frames == len(p) and compared.worst < 0.2
