"""Which live sensors there are, and the one that a text names."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from ..errors import DriverMissingError, ParameterError, SensorError
from .file_player import FilePlayer, plays
from .live import LiveSensor
from .orientation import split_mirrored
from .playback import EXPRESSION_FRAMES, NEUTRAL_FRAMES, PlaybackDriver, SyntheticDriver


@dataclass(frozen=True)
class SensorInfo:
    """``name`` for :func:`open_sensor`; ``description``; ``state``: "ready", or why it cannot be opened now."""

    name: str
    description: str
    state: str = "ready"

    @property
    def ready(self) -> bool:
        """Whether it can be opened now."""
        return self.state == "ready"


def _synthetic(argument: str) -> LiveSensor:
    from ..synthetic.sensor import SyntheticSensor
    from . import NOISES

    seed, _, noise = argument.partition(":")
    if seed and not (seed.isascii() and seed.isdecimal() and len(seed) <= 9):
        raise ParameterError(f"synthetic:{argument}: the seed {seed!r} is not a whole number of at most 9 digits")
    if noise and noise not in NOISES:
        raise ParameterError(f"synthetic:{argument}: unknown noise {noise!r}; possible: {', '.join(NOISES)}")
    source = SyntheticSensor(int(seed or 0), noise or NOISES[0], NEUTRAL_FRAMES, EXPRESSION_FRAMES, repeats=1)
    frames: list = []
    return LiveSensor(lambda: SyntheticDriver(source, frames), open_timeout=180.0)


def _realsense(serial: str) -> LiveSensor:
    from .realsense import RealSenseDriver

    if len(serial) > 32:
        raise ParameterError(f"realsense:{serial[:32]}...: a serial number is shorter")
    return LiveSensor(lambda: RealSenseDriver(serial))


def _record3d(identifier: str) -> LiveSensor:
    from .record3d_stream import Record3DDriver

    return LiveSensor(lambda: Record3DDriver(identifier))


def _openni2(which: str) -> LiveSensor:
    from .openni2 import OpenNI2Driver

    return LiveSensor(lambda: OpenNI2Driver(which))


def _kinect1(index: str) -> LiveSensor:
    from .kinect1 import Kinect1Driver

    return LiveSensor(lambda: Kinect1Driver(index))


def _webcam(options: str) -> LiveSensor:
    from .webcam import WebcamDriver, WebcamOptions

    parsed = WebcamOptions.parse(options)
    return LiveSensor(lambda: WebcamDriver(parsed))


def _azure(argument: str) -> LiveSensor:
    if argument.isascii() and argument.isdecimal() and len(argument) < 4 or not argument:
        from .azure import AzureDriver

        return LiveSensor(lambda: AzureDriver(int(argument or 0)))
    if not (argument.lower().endswith(".mkv") and Path(argument).is_file()):
        raise SensorError(f"azure:{argument}: neither the number of a camera nor a recording (.mkv)")
    return _play_apart(Path(argument))


def _orbbec(serial: str) -> LiveSensor:
    from .orbbec import OrbbecDriver

    return LiveSensor(lambda: OrbbecDriver(serial))


def _oak(identifier: str) -> LiveSensor:
    from .oak import OakDriver

    return LiveSensor(lambda: OakDriver(identifier), open_timeout=60.0)  # the device boots


def _kinect2(argument: str) -> LiveSensor:
    from .kinect2 import Kinect2Driver

    if argument:
        raise ParameterError(f"kinect2:{argument}: the SDK supports one sensor, which has no number; use 'kinect2'")
    return LiveSensor(Kinect2Driver)


_KINDS = {
    "synthetic": _synthetic,
    "realsense": _realsense,
    "record3d": _record3d,
    "openni2": _openni2,
    "kinect1": _kinect1,
    "azure": _azure,
    "orbbec": _orbbec,
    "oak": _oak,
    "kinect2": _kinect2,
    "webcam": _webcam,
}
POSSIBLE = (
    "possible sensors: 'synthetic[:SEED[:NOISE]]', 'realsense[:SERIAL]', 'record3d[:UDID]', "
    "'openni2[:URI or INDEX]', 'kinect1[:INDEX]', 'azure[:INDEX]', 'orbbec[:SERIAL]', 'oak[:ID]', "
    "'kinect2', "
    "'webcam[:INDEX|http://...][,fov=DEGREES]' (colour only), "
    "or the path of a recording (folder, .r3d, .db3, .bag, .oni, Azure's .mkv; colour only: .mp4, .mov, .avi, .webm, .mkv); "
    "with ',mirrored' at the end pictures are flipped"
)


def list_sensors() -> list[SensorInfo]:
    """Every sensor that can be named, connected ones with their serial number; never fails on a missing driver."""
    synthetic = SensorInfo("synthetic", "a synthetic performer at 30 frames a second, no hardware")
    depth = [*_realsense_cameras(), *_phones(), *_openni2_cameras(), *_kinects(), *_azure_cameras(), *_others()]
    return [synthetic, *depth, *_webcams()]


def _webcams() -> list[SensorInfo]:
    from .webcam import connected_webcams

    note = "colour only: no depth, degraded"
    found = [SensorInfo(f"webcam:{index}", f"{name} ({note})", state) for index, name, state in connected_webcams()]
    return found or [SensorInfo("webcam", f"colour camera ({note})", "not connected")]


def _realsense_cameras() -> list[SensorInfo]:
    from .realsense import connected_cameras

    return _connected("realsense", "Intel RealSense", connected_cameras)


def _phones() -> list[SensorInfo]:
    from .record3d_stream import connected_phones

    description = "iPhone with the app Record3D, by USB"
    return _connected("record3d", description, lambda: [(phone, description) for phone in connected_phones()])


def _openni2_cameras() -> list[SensorInfo]:
    from .openni2 import connected_cameras

    return _connected("openni2", "PrimeSense Carmine, Asus Xtion and other OpenNI2 cameras", connected_cameras)


def _kinects() -> list[SensorInfo]:
    from .kinect1 import connected_kinects

    return _connected("kinect1", "Kinect v1 (Xbox 360)", connected_kinects)


def _azure_cameras() -> list[SensorInfo]:
    from .azure import connected_cameras

    return _connected("azure", "Azure Kinect", connected_cameras)


def _others() -> list[SensorInfo]:
    from . import kinect2, oak, orbbec

    return [
        *_connected("orbbec", "Orbbec", orbbec.connected_cameras),
        *_connected("oak", "Luxonis OAK-D", oak.connected_cameras),
        *_connected("kinect2", "Kinect v2", kinect2.connected_sensors, empty="known when it is opened"),
    ]


def _connected(
    kind: str, description: str, find: Callable[[], list[tuple[str, str]]], empty: str = "not connected"
) -> list[SensorInfo]:
    """One entry per device that ``find`` returns as (serial number, name), or one that says why there is none."""
    try:
        devices = find()
    except DriverMissingError as error:
        return [SensorInfo(kind, description, str(error))]
    except Exception as error:  # noqa: BLE001 - whatever a vendor's library raises, e.g. without access to USB
        return [SensorInfo(kind, description, f"the driver failed ({error})")]
    if not devices:
        return [SensorInfo(kind, description, empty)]
    return [SensorInfo(f"{kind}:{serial}", name) for serial, name in devices]


def is_live(text: str) -> bool:
    """Whether ``text`` names a sensor that has no numbered frames: a real one, not a recording or ``synthetic``."""
    text, _ = split_mirrored(text)
    kind = text.partition(":")[0]
    return kind in _KINDS and kind != "synthetic" and not Path(text).exists()


def open_sensor(text: str) -> LiveSensor:
    """Open the sensor or recording named by ``text``; a recording plays every frame, as fast as it is read.

    ``,mirrored`` at the end of any of them flips its frames. Raises :class:`SensorError` (not found, driver not
    installed, ...), :class:`ParameterError` or :class:`FileFormatError`.
    """
    text, flipped = split_mirrored(text)
    kind, _, argument = text.partition(":")
    if kind not in _KINDS and not Path(text).exists():
        raise SensorError(f"{text}: no such sensor or recording; {POSSIBLE}")
    sensor = _KINDS[kind](argument) if kind in _KINDS else _open_path(Path(text))
    if flipped:
        sensor.mirror()
    return sensor


def _open_path(path: Path) -> LiveSensor:
    if plays(path):
        return _play_apart(path)
    from . import open_source

    source = open_source(str(path))
    return LiveSensor(lambda: PlaybackDriver(source), reconnect=False)


def _play_apart(path: Path) -> LiveSensor:
    return LiveSensor(lambda: FilePlayer(path), reconnect=False)
