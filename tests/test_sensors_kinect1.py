"""Kinect v1 through the real libfreenect: without a device as it is, with dumps through its fakenect."""

from __future__ import annotations

import ctypes
import sys
from dataclasses import replace

import fakenect_dump
import numpy as np
import pytest
from equivalence import compared, performance

from adaptiveface.errors import DriverMissingError, ParameterError, SensorError
from adaptiveface.sensors import Recording, RecordingWriter, list_sensors, open_sensor
from adaptiveface.sensors.kinect1 import Kinect1Driver, connected_kinects, millimetres

needs_fakenect = pytest.mark.skipif(
    fakenect_dump.library() is None, reason="fakenect is not installed (Debian: libfreenect0.5)"
)
RNG = np.random.default_rng(0)
TABLE = millimetres(np.arange(2048, dtype=np.uint16))


def disparity_of(depth: np.ndarray) -> np.ndarray:
    """The disparity whose depth is nearest; 2047 where there is none."""
    used = np.flatnonzero(TABLE)
    after = np.clip(np.searchsorted(TABLE[used], depth), 1, len(used) - 1)
    lower = depth - TABLE[used[after - 1]] < TABLE[used[after]] - depth
    return np.where(depth > 0, used[after - lower], 2047).astype(np.uint16)


def frame(number: int):
    return RNG.integers(300, 1000, (480, 640)).astype(np.uint16), RNG.integers(0, 255, (480, 640, 3)).astype(np.uint8)


def test_disparity_to_millimetres():
    """OpenKinect's formula: zero depth for 'no measurement'; steps of 1.4 mm at 700 mm and 2.9 mm at 1 m."""
    assert TABLE[2047] == 0 and TABLE[1085] == 0 and TABLE.max() < 10_000
    assert TABLE[800] == pytest.approx(123.6 * np.tan(800 / 2842.5 + 1.1863), rel=1e-6)
    near, far = np.argmax(TABLE > 700), np.argmax(TABLE > 1000)
    assert TABLE[near + 1] - TABLE[near] == pytest.approx(1.44, abs=0.02)
    assert TABLE[far + 1] - TABLE[far] == pytest.approx(2.91, abs=0.05)
    assert (millimetres(np.array([[3000, 2047]], np.uint16)) == 0).all()


@needs_fakenect
def test_frames_are_exact_and_the_end_is_a_disconnection(tmp_path):
    frames = [frame(n) for n in range(6)]
    frames[0][0][:20] = 2047
    fakenect_dump.write(tmp_path / "dump", [(n, *images) for n, images in enumerate(frames)])
    got = fakenect_dump.play(tmp_path / "dump")
    assert got["said"]["listed"] == ["kinect1:0"] and "unplugged" in got["said"]["end"]
    assert got["sequence"].tolist() == list(range(6))
    np.testing.assert_array_equal(got["depth"], [millimetres(disparity) for disparity, _ in frames])
    np.testing.assert_array_equal(got["colour"], [picture for _, picture in frames])
    np.testing.assert_allclose(np.diff(got["timestamp"]), 1 / 30, atol=1e-6)
    assert (got["depth"][0, :20] == 0).all() and got["focal"] == 580


@needs_fakenect
def test_lost_frames_are_counted_over_the_overflow_of_the_clock(tmp_path):
    """Pictures without a depth of their moment are forgotten, and the other way round; the 32-bit clock overflows."""
    images = {n: frame(n) for n in range(8)}
    dump = [(n, images[n][0] if n != 2 else None, images[n][1] if n != 4 else None) for n in range(8)]
    fakenect_dump.write(tmp_path / "dump", dump, first_ticks=2**32 - 5_000_000)
    got = fakenect_dump.play(tmp_path / "dump")
    assert got["sequence"].tolist() == [0, 1, 3, 5, 6, 7]
    np.testing.assert_array_equal(got["colour"], [images[n][1] for n in got["sequence"]])
    np.testing.assert_allclose(got["timestamp"] - got["timestamp"][0], got["sequence"] / 30, atol=1e-6)


@needs_fakenect
def test_live_sensor_without_the_pictures_that_are_not_aligned_to_the_depth(tmp_path):
    frames = [frame(n) for n in range(10)]
    fakenect_dump.write(tmp_path / "dump", [(n, *images) for n, images in enumerate(frames)])
    got = fakenect_dump.play(tmp_path / "dump", aligned=False, live=True)
    assert len(got["depth"]) and "colour" not in got and "unplugged" in got["said"]["end"]
    assert (np.diff(got["sequence"]) > 0).all()
    for n, depth in zip(got["sequence"], got["depth"], strict=True):
        np.testing.assert_array_equal(depth, millimetres(frames[n][0]))


@needs_fakenect
@pytest.mark.slow
def test_the_same_performance_tracks_to_the_same_result(tmp_path, capsys):
    """Against a recording of the same 11-bit depth; against the unquantised recording the format's own error shows."""
    p = performance()
    disparities = [disparity_of(f.depth) for f in p.frames]
    picture = np.zeros((480, 640, 3), np.uint8)
    fakenect_dump.write(tmp_path / "dump", [(n, disparity, picture) for n, disparity in enumerate(disparities)])
    played = fakenect_dump.play(tmp_path / "dump", focal=p.camera.fx)
    numbers = played["sequence"].tolist()
    got = [_frame(p, n, depth) for n, depth in zip(numbers, played["depth"], strict=True)]
    with RecordingWriter(tmp_path / "same", p.camera, depth_scale=10_000) as writer:
        for n in numbers:
            writer.write(_frame(p, n, millimetres(disparities[n])))
    tracked = p.track(got, numbers)
    same = compared(tracked, p.track(Recording(tmp_path / "same"), numbers))
    unquantised = p.compare(got, 10_000, numbers)
    with capsys.disabled():
        print(f"\nKinect v1, recording of the same 11-bit depth: {same}\nKinect v1, unquantised recording: {unquantised}")
    assert numbers == list(range(len(p))) and same.worst < 0.2


def _frame(p, number: int, depth: np.ndarray):
    return replace(p.frames[number], depth=depth)


# ---- the library as it is, without a device --------------------------------------------------------------------------
def test_no_kinect_connected():
    try:
        connected = connected_kinects()
    except DriverMissingError as missing:
        pytest.skip(str(missing))
    except RuntimeError:
        connected = []
    if connected:
        pytest.skip("a Kinect is connected")
    with pytest.raises(SensorError, match="no such Kinect is connected|no access to the USB bus"):
        open_sensor("kinect1")
    (state,) = [info.state for info in list_sensors() if info.name == "kinect1"]
    assert state == "not connected" or "USB" in state


def test_the_index_is_a_number():
    with pytest.raises(ParameterError, match="kinect1:first: the number of a Kinect is expected"):
        Kinect1Driver("first")


def test_without_the_library_the_install_line_is_given(monkeypatch):
    def refuse(name, *_, **__):
        raise OSError(f"{name}: cannot open shared object file")

    monkeypatch.setattr(ctypes, "CDLL", refuse)
    line = "apt install libfreenect0.5" if sys.platform == "linux" else "libfreenect"
    with pytest.raises(DriverMissingError, match=line):
        open_sensor("kinect1")
    assert "needs libfreenect" in {info.name: info.state for info in list_sensors()}["kinect1"]
    monkeypatch.setenv("FREENECT_LIBRARY", "/nowhere/libfreenect.so")
    with pytest.raises(DriverMissingError, match="/nowhere/libfreenect.so .FREENECT_LIBRARY. cannot be loaded"):
        open_sensor("kinect1")
