"""List the live sensors, and open the one that a text names."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from ..errors import DriverMissingError, SensorError
from .file_player import FilePlayer, plays
from .kinds import SensorKind, sensor_kinds
from .live import LiveSensor
from .orientation import split_mirrored
from .playback import PlaybackDriver
from .sources import open_source


@dataclass(frozen=True)
class SensorInfo:
    """An entry of the list of sensors.

    Attributes
    ----------
    name : str
        What :func:`open_sensor` takes.
    description : str
        For people.
    state : str
        "ready", or why the sensor cannot be opened now.
    """

    name: str
    description: str
    state: str = "ready"

    @property
    def ready(self) -> bool:
        """Whether it can be opened now."""
        return self.state == "ready"


def _possible(kinds: Mapping[str, SensorKind]) -> str:
    return (
        f"possible sensors: {', '.join(kind.usage for kind in kinds.values())}, or the path of a recording (folder, .r3d, "
        ".db3, .bag, .oni, Azure's .mkv; colour only: .mp4, .mov, .avi, .webm, .mkv); with ',mirrored' at the end pictures are "
        "flipped"
    )


def list_sensors() -> list[SensorInfo]:
    """List every kind of sensor.

    Returns
    -------
    list of SensorInfo
        One entry for each connected device, whose name holds its serial number or its index. A kind without a device has a
        single entry, which states the reason. A missing driver is such a reason, and not an error.
    """
    return [info for name, kind in sensor_kinds().items() for info in _connected(name, kind)]


def _connected(name: str, kind: SensorKind) -> list[SensorInfo]:
    """Return an entry for each connected device, or a single entry that states why there is none."""
    description = name
    try:
        driver = kind.load()
        description = driver.description or name
        devices = driver.connected()
    except DriverMissingError as error:
        return [SensorInfo(name, description, str(error))]
    except Exception as error:  # noqa: BLE001 - whatever a vendor's library raises, e.g. without access to USB
        return [SensorInfo(name, description, f"the driver failed ({error})")]
    if not devices:
        return [SensorInfo(name, description, driver.unconnected)]
    return [SensorInfo(f"{name}:{identifier}", *about) for identifier, *about in devices]


def is_live(text: str) -> bool:
    """Return whether ``text`` names a real sensor. Recordings and ``synthetic`` have numbered frames and are none."""
    text, _ = split_mirrored(text)
    kind = text.partition(":")[0]
    return kind != "synthetic" and not Path(text).exists() and kind in sensor_kinds()


def open_sensor(text: str) -> LiveSensor:
    """Open a sensor or a recording by name.

    Parameters
    ----------
    text : str
        A name from :func:`list_sensors`, or the path of a recording. If it ends in ``,mirrored``, the frames are flipped.

    Returns
    -------
    LiveSensor
        The sensor. A recording plays every frame, as fast as it is read.

    Raises
    ------
    SensorError
        There is no such sensor, its driver is not installed, or it cannot be started.
    ParameterError
        The text after the colon has no meaning for this kind of sensor.
    FileFormatError
        The recording cannot be read.
    """
    text, flipped = split_mirrored(text)
    name, _, argument = text.partition(":")
    kinds = sensor_kinds()
    if name not in kinds and not Path(text).exists():
        raise SensorError(f"{text}: no such sensor or recording; {_possible(kinds)}")
    sensor = kinds[name].open(argument) if name in kinds else _open_path(Path(text))
    if flipped:
        sensor.mirror()
    return sensor


def _open_path(path: Path) -> LiveSensor:
    if plays(path):
        return LiveSensor(lambda: FilePlayer(path))
    source = open_source(str(path))
    return LiveSensor(lambda: PlaybackDriver(source))
