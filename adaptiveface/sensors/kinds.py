"""List the kinds of sensors: those of this package, and those that other distributions add by an entry point.

An entry point in the group ``adaptiveface.sensors`` has the name of the kind and refers to a
:class:`~adaptiveface.sensors.driver.Driver` class. ``open_sensor("NAME:ARGUMENT")`` then opens it.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import EntryPoint, entry_points

from ..errors import AdaptiveFaceError, SensorError
from .driver import Driver
from .live import LiveSensor

GROUP = "adaptiveface.sensors"


@dataclass(frozen=True)
class SensorKind:
    """A kind of sensor.

    Attributes
    ----------
    usage : str
        How users write the name.
    load : callable
        Imports and returns the driver class. The vendor's library is not imported yet.
    """

    usage: str
    load: Callable[[], type[Driver]]

    def open(self, argument: str) -> LiveSensor:
        """Open the sensor that is named ``KIND:argument``."""
        return LiveSensor(self.load().named(argument))


def _own(usage: str, module: str, name: str) -> SensorKind:
    return SensorKind(usage, lambda: vars(importlib.import_module(f".{module}", __package__))[name])


#: In the order in which sensors are listed.
KINDS = {
    "synthetic": _own("'synthetic[:SEED[:NOISE]]'", "playback", "SyntheticDriver"),
    "realsense": _own("'realsense[:SERIAL]'", "realsense", "RealSenseDriver"),
    "record3d": _own("'record3d[:UDID]'", "record3d_stream", "Record3DDriver"),
    "openni2": _own("'openni2[:URI or INDEX]'", "openni2", "OpenNI2Driver"),
    "kinect1": _own("'kinect1[:INDEX]'", "kinect1", "Kinect1Driver"),
    "azure": _own("'azure[:INDEX]'", "azure", "AzureDriver"),
    "orbbec": _own("'orbbec[:SERIAL]'", "orbbec", "OrbbecDriver"),
    "oak": _own("'oak[:ID]'", "oak", "OakDriver"),
    "kinect2": _own("'kinect2'", "kinect2", "Kinect2Driver"),
    "webcam": _own("'webcam[:INDEX|http://...][,fov=DEGREES]' (colour only)", "webcam", "WebcamDriver"),
}


def sensor_kinds() -> dict[str, SensorKind]:
    """Every kind by its name. An entry point cannot replace a name of this package."""
    return KINDS | {entry.name: _added(entry) for entry in entry_points(group=GROUP) if entry.name not in KINDS}


def _added(entry: EntryPoint) -> SensorKind:
    def load() -> type[Driver]:
        where = f"{entry.name}: the sensor of {entry.dist.name if entry.dist else entry.value}"
        try:
            driver = entry.load()
        except AdaptiveFaceError:
            raise
        except Exception as error:  # another distribution's module may raise anything
            raise SensorError(f"{where} cannot be loaded ({error}); update or remove that package") from error
        if not (isinstance(driver, type) and issubclass(driver, Driver)):
            raise SensorError(f"{where} is not a Driver class ({entry.value}); update or remove that package")
        return driver

    return SensorKind(f"'{entry.name}'", load)
