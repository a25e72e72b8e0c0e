"""The iPhone stream through the vendor's real library, fed by a fake phone on the local socket."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("record3d", reason="record3d is not installed (the extra 'record3d')")
pytest.importorskip("lzfse")

from equivalence import performance  # noqa: E402
from fake_phone import K, depth_of  # noqa: E402

from adaptiveface.errors import (  # noqa: E402
    DriverMissingError,
    SensorDisconnectedError,
    SensorError,
    SensorNotFoundError,
)
from adaptiveface.sensors import list_sensors, open_sensor  # noqa: E402
from adaptiveface.sensors.record3d_stream import Record3DDriver  # noqa: E402

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="the address of usbmuxd can be set on Linux only")
FRAMES = 12


@pytest.fixture
def plug_in(monkeypatch):
    """Starts a phone that streams what ``argument`` names."""
    processes = []

    def start(argument) -> None:
        command = [sys.executable, str(Path(__file__).with_name("fake_phone.py")), str(argument)]
        processes.append(subprocess.Popen(command, stdout=subprocess.PIPE, text=True))
        monkeypatch.setenv("USBMUXD_SOCKET_ADDRESS", "127.0.0.1:" + processes[-1].stdout.readline().strip())

    yield start
    for process in processes:
        process.kill()
        process.wait()
        process.stdout.close()


@pytest.fixture
def phone(plug_in):
    plug_in(FRAMES)


def number_of(frame) -> int:
    return round((float(frame.depth[0, 1]) - 1000) / 10)


def check(frame) -> None:
    expected = np.nan_to_num(depth_of(number_of(frame)), nan=0) * np.float32(1000)
    np.testing.assert_array_equal(frame.depth, expected)
    assert frame.colour.shape == (64, 48, 3)
    assert np.abs(frame.colour[32, 24].astype(int) - [200, number_of(frame), 50]).max() <= 6
    camera = frame.camera
    assert (camera.fx, camera.fy) == K[:2] and camera.cx == pytest.approx((2 * K[2] + 0.5) / 2 - 0.5)


def test_a_stream_opens_no_port_and_talks_to_this_machine_only(phone):
    psutil = pytest.importorskip("psutil")
    known = {c.laddr for c in psutil.Process().net_connections(kind="inet") if c.status == psutil.CONN_LISTEN}
    with open_sensor("record3d:FAKE-1") as sensor:
        sensor.read(20)
        found = psutil.Process().net_connections(kind="inet")
    assert {c.laddr for c in found if c.status == psutil.CONN_LISTEN} <= known
    assert all(c.raddr.ip == "127.0.0.1" for c in found if c.raddr)


def test_frames_are_exact_and_the_stream_resumes_after_it_broke_off(phone):
    assert "record3d:FAKE-1" in [info.name for info in list_sensors() if info.ready]
    with open_sensor("record3d:FAKE-1") as sensor:
        before = [sensor.read(20) for _ in range(3)]
        with pytest.raises(SensorDisconnectedError, match="the stream stopped"):
            while True:
                before.append(sensor.read(20))
        after = [sensor.read(20) for _ in range(3)]
    for frame in before + after:
        check(frame)
    numbers = [number_of(frame) for frame in before]
    assert numbers == sorted(set(numbers)) and number_of(after[0]) < FRAMES - 1


def test_the_stream_tracks_to_the_same_result(plug_in, tmp_path):
    """Depth travels as float32 metres, compared with a recording in tenths of a millimetre."""
    p = performance()
    c = p.camera
    depth = np.stack([f.depth for f in p.frames]) / np.float32(1000)
    np.savez(tmp_path / "take.npz", depth=depth, k=(c.fx, c.fy, c.cx, c.cy))
    plug_in(tmp_path / "take.npz")
    got = []
    with open_sensor("record3d") as sensor:
        sensor.buffer(len(p))
        with pytest.raises(SensorDisconnectedError):
            while len(got) <= len(p):
                got.append(sensor.read(20))
    numbers = p.numbers_of(got)
    assert numbers == sorted(set(numbers)) and len(numbers) > len(p) // 2  # a busy host drops some of a live stream
    for number, frame in zip(numbers, got, strict=True):
        np.testing.assert_allclose(frame.depth, p.frames[number].depth, rtol=2e-7)  # two roundings of a float32
    result = p.compare(got, 10_000, numbers)
    print(f"\nRecord3D by USB: {result}")
    assert result.worst < 0.2


def test_a_frame_that_cannot_be_used_is_an_error_and_not_the_end_of_the_process():
    """The library calls from a thread of its own, where nothing may be raised."""

    class Stream:
        def get_intrinsic_mat(self):
            return SimpleNamespace(fx=0.0, fy=0.0, tx=0.0, ty=0.0)

        def get_depth_frame(self):
            return np.ones((4, 3), np.float32)

        def get_rgb_frame(self):
            return np.zeros((4, 3, 3), np.uint8)

    driver = Record3DDriver()
    driver._stream = Stream()
    driver._on_frame()
    with pytest.raises(SensorError, match="Record3D: sends frames that cannot be used .*fx, fy"):
        driver.grab(0.0)


def test_another_phone_is_not_found(phone):
    with pytest.raises(SensorNotFoundError, match="found: FAKE-1"):
        open_sensor("record3d:OTHER")


def test_no_phone_connected(monkeypatch):
    monkeypatch.setenv("USBMUXD_SOCKET_ADDRESS", "127.0.0.1:9")
    with pytest.raises(SensorNotFoundError, match="found: none"):
        open_sensor("record3d")


def test_without_the_driver_the_pip_line_is_given(monkeypatch):
    monkeypatch.setitem(sys.modules, "record3d", None)
    with pytest.raises(DriverMissingError, match=r'pip install "adaptiveface\[record3d\]"'):
        open_sensor("record3d")
    assert "adaptiveface[record3d]" in {info.name: info.state for info in list_sensors()}["record3d"]
