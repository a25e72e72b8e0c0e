"""The iPhone stream through the vendor's real library, fed by a fake phone on the local socket."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("record3d", reason="record3d is not installed (the extra 'record3d')")
pytest.importorskip("lzfse")

from fake_phone import K, depth_of  # noqa: E402

from adaptiveface.errors import DriverMissingError, SensorDisconnectedError, SensorNotFoundError  # noqa: E402
from adaptiveface.sensors import list_sensors, open_sensor  # noqa: E402

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="the address of usbmuxd can be set on Linux only")
FRAMES = 12


@pytest.fixture
def phone(monkeypatch):
    script = Path(__file__).with_name("fake_phone.py")
    process = subprocess.Popen([sys.executable, str(script), str(FRAMES)], stdout=subprocess.PIPE, text=True)
    monkeypatch.setenv("USBMUXD_SOCKET_ADDRESS", "127.0.0.1:" + process.stdout.readline().strip())
    yield process
    process.kill()
    process.wait()
    process.stdout.close()


def number_of(frame) -> int:
    return round((float(frame.depth[0, 1]) - 1000) / 10)


def check(frame) -> None:
    expected = np.nan_to_num(depth_of(number_of(frame)), nan=0) * np.float32(1000)
    np.testing.assert_array_equal(frame.depth, expected)
    assert frame.colour.shape == (64, 48, 3)
    assert np.abs(frame.colour[32, 24].astype(int) - [200, number_of(frame), 50]).max() <= 6
    camera = frame.camera
    assert (camera.fx, camera.fy) == K[:2] and camera.cx == pytest.approx((2 * K[2] + 0.5) / 2 - 0.5)


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
