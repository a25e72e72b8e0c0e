"""Thin adapters (Orbbec, OAK-D, Kinect v2): names against the vendors' real libraries, and every way not to get a sensor."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from numpy_1 import requirements

from adaptiveface.errors import DriverMissingError, ParameterError, SensorError
from adaptiveface.sensors import kinect2, list_sensors, open_sensor

CHECK = Path(__file__).with_name("vendor_check.py")


@pytest.mark.parametrize(("kind", "library"), [("orbbec", "pyorbbecsdk"), ("oak", "depthai")])
def test_without_the_driver_the_pip_line_is_given(monkeypatch, kind, library):
    monkeypatch.setitem(sys.modules, library, None)
    for name in (kind, f"{kind}:123"):
        with pytest.raises(DriverMissingError, match=rf'pip install "adaptiveface\[{kind}\]"'):
            open_sensor(name)
    assert f"adaptiveface[{kind}]" in {info.name: info.state for info in list_sensors()}[kind]


def test_an_old_library_is_told_from_the_new_one(monkeypatch):
    monkeypatch.setitem(sys.modules, "depthai", SimpleNamespace(node=SimpleNamespace()))
    monkeypatch.setitem(sys.modules, "pyorbbecsdk", SimpleNamespace(Pipeline=object))
    for kind in ("oak", "orbbec"):
        with pytest.raises(DriverMissingError, match="pip install"):
            open_sensor(kind)


def test_kinect_v2_without_windows_or_driver(monkeypatch):
    monkeypatch.setitem(sys.modules, "kinect_next", None)
    monkeypatch.setattr(sys, "platform", "linux")
    with pytest.raises(DriverMissingError, match="needs Windows.*adaptiveface record kinect2"):
        open_sensor("kinect2")
    assert "needs Windows" in {info.name: info.state for info in list_sensors()}["kinect2"]
    monkeypatch.setattr(sys, "platform", "win32")
    with pytest.raises(DriverMissingError, match=r'pip install "adaptiveface\[kinect2\]"'):
        open_sensor("kinect2")
    with pytest.raises(ParameterError, match="kinect2:7.*one sensor"):
        open_sensor("kinect2:7")


#: A depth camera as the SDK describes one: fx, fy, cx, cy and its radial distortion.
INTRINSICS, RADIAL = (365.5, 365.5, 257.2, 206.9), (0.092, -0.27, 0.093)


class Mapper:
    """The SDK's coordinate mapper for a lens with ``RADIAL`` distortion; ``shear`` makes it no radial lens."""

    def __init__(self, shear: float = 0.0) -> None:
        self.shear = shear

    def get_depth_camera_intrinsics(self):
        return INTRINSICS

    def map_depth_frame_to_camera_space(self, depth):
        fx, fy, cx, cy = INTRINSICS
        u, v = np.meshgrid(np.arange(kinect2.WIDTH, dtype=float), np.arange(kinect2.HEIGHT, dtype=float))
        bent = np.stack([(u - cx) / fx + self.shear * (v - cy) / fy, (v - cy) / fy])
        straight = bent.copy()
        for _ in range(50):  # inverts the distortion
            r2 = (straight**2).sum(axis=0)
            straight = bent / (1 + RADIAL[0] * r2 + RADIAL[1] * r2**2 + RADIAL[2] * r2**3)
        z = depth / 1000.0
        return np.stack([straight[0] * z, -straight[1] * z, z], axis=-1)  # x with the columns, y up


def test_kinect_v2_rays_become_a_pinhole_camera_the_right_way_round():
    """A slanted plane in the SDK's camera space (x to the sensor's left) lies where it should in the package's."""
    registration = kinect2.registration(Mapper())
    x, y, _ = np.moveaxis(Mapper().map_depth_frame_to_camera_space(np.full((424, 512), 1000.0)), -1, 0)
    seen = 700.0 / (1 - 0.4 * x + 0.2 * y)  # z = 700 + 0.4 x - 0.2 y
    depth = registration.depth(seen[:, ::-1].copy())
    inner = np.s_[40:-40, 40:-40]
    points = (registration.camera.rays() * depth[..., None])[inner].reshape(-1, 3)
    expected = 700 - 0.4 * points[:, 0] + 0.2 * points[:, 1]  # x to the right, y down
    assert np.abs(points[:, 2] - expected).max() < 0.1


def test_kinect_v2_with_another_lens_is_refused():
    with pytest.raises(SensorError, match="do not fit a radial lens"):
        kinect2.registration(Mapper(shear=0.1))


KINDS = "azure", "orbbec", "oak", "kinect2"


@pytest.fixture(scope="module")
def checked(numpy_1, tmp_path_factory):
    """What ``vendor_check.py`` finds for each kind, run where the real libraries are installed, in an empty folder."""
    packages = [line.partition(";")[0].strip() for line in requirements(*KINDS)[3:]]
    numpy_1.install("--no-deps", *packages, "typing_extensions")
    folder = tmp_path_factory.mktemp("empty")
    results = json.loads(numpy_1(CHECK, *KINDS, folder=folder).strip().splitlines()[-1])
    return results, list(folder.iterdir())


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_the_real_library_has_what_is_called_and_finds_no_device(checked, kind):
    result, left_behind = checked[0][kind], checked[1]
    print(f"\n{kind}: {result}")
    assert result["missing"] == [] and result["names"] > 12 and not left_behind
    assert ("needs Windows" if kind == "kinect2" else "not connected") in result["listed"]
    assert result["error"].startswith("SensorNotFoundError")
