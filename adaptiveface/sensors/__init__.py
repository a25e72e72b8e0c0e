"""Provide frames: recordings on disk, the synthetic sensor, live sensors.

:func:`open_sensor` opens a live sensor, whose ``read`` waits for the newest frame. :func:`open_source` opens a source,
which has numbered frames and the small interface :class:`FrameSource`. Both take the text that a user typed. A source's
``read`` raises :class:`adaptiveface.errors.FrameError` for a frame that cannot be used.
"""

from __future__ import annotations

from ..geometry.source import FrameSource
from .catalogue import SensorInfo, list_sensors, open_sensor
from .driver import Driver, LiveFrame
from .live import LiveSensor
from .playback import NOISES
from .recording import Recording, RecordingWriter
from .sources import open_source

__all__ = [
    "NOISES",
    "Driver",
    "FrameSource",
    "LiveFrame",
    "LiveSensor",
    "Recording",
    "RecordingWriter",
    "SensorInfo",
    "list_sensors",
    "open_sensor",
    "open_source",
]
