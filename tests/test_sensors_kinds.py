"""The table of sensor kinds, and what an entry point of another distribution adds to it."""

from __future__ import annotations

import inspect

import pytest

from adaptiveface.errors import SensorError
from adaptiveface.sensors import Driver, list_sensors, open_sensor
from adaptiveface.sensors.catalogue import is_live
from adaptiveface.sensors.kinds import KINDS, sensor_kinds

MODULE = """
import numpy as np
from adaptiveface.geometry.camera import Camera
from adaptiveface.sensors.driver import Driver, RawFrame

class Lantern(Driver):
    live, fps, description = False, 12.0, "a lantern with eyes"

    def __init__(self, argument):
        self.name, self._depth = f"lantern {argument}", float(argument)

    @classmethod
    def connected(cls):
        return [("600", "the lantern in the hall")]

    def open(self):
        self._count = 0

    def grab(self, timeout):
        self._count += 1
        camera = Camera(8, 6, 9.0, 9.0, 3.5, 2.5)
        return RawFrame(np.full((6, 8), self._depth), camera, None, self._count, self._count / self.fps)

    def close(self):
        pass
"""


@pytest.fixture
def installed(tmp_path, monkeypatch):
    """A distribution with the given entry points, installed as a dist-info folder on the path."""

    def install(entry_points: str) -> None:
        (tmp_path / "lantern_camera.py").write_text(MODULE)
        info = tmp_path / "lantern-1.0.dist-info"
        info.mkdir()
        (info / "METADATA").write_text("Metadata-Version: 2.1\nName: lantern\nVersion: 1.0\n")
        (info / "entry_points.txt").write_text(f"[adaptiveface.sensors]\n{entry_points}\n")
        monkeypatch.syspath_prepend(tmp_path)

    return install


def test_a_sensor_of_another_distribution_opens_by_name_and_is_listed(installed):
    assert not is_live("lantern:600")
    installed("lantern = lantern_camera:Lantern")
    with open_sensor("lantern:600") as sensor:
        assert sensor.name == "lantern 600" and sensor.fps == 12.0 and not sensor.colour_only
        assert (sensor.read().depth == 600).all()
    assert is_live("lantern:600")
    entry = list_sensors()[-1]
    assert (entry.name, entry.description, entry.ready) == ("lantern:600", "the lantern in the hall", True)
    with pytest.raises(SensorError, match=r"'webcam.*\(colour only\), 'lantern', or the path of a recording"):
        open_sensor("nothing of that name")


@pytest.mark.parametrize(
    ("target", "reason"),
    [
        ("lantern_camera:Missing", "cannot be loaded .*Missing.*update or remove"),
        ("no_such_module_here:Lantern", "cannot be loaded .*no_such_module_here.*update or remove"),
        ("lantern_camera:MODULE_NAME_ONLY.x", "cannot be loaded"),
        ("lantern_camera:np", "is not a Driver class .lantern_camera:np.; update or remove"),
    ],
)
def test_an_entry_point_that_does_not_work_is_one_line_and_hides_no_other_sensor(installed, target, reason):
    installed(f"lantern = {target}")
    with pytest.raises(SensorError, match=f"^lantern: the sensor of lantern {reason}"):
        open_sensor("lantern:1")
    listed = list_sensors()
    assert "the sensor of lantern" in listed[-1].state
    assert "synthetic" in {info.name for info in listed}


def test_an_entry_point_replaces_no_sensor_of_the_package(installed):
    installed("synthetic = lantern_camera:Lantern")
    assert sensor_kinds()["synthetic"] is KINDS["synthetic"]


@pytest.mark.parametrize("name", KINDS)
def test_every_kind_loads_its_driver_without_the_vendors_library(name):
    driver = KINDS[name].load()
    assert issubclass(driver, Driver) and not inspect.isabstract(driver) and driver.description
    assert KINDS[name].usage.startswith(f"'{name}")
