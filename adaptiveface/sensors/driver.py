"""Define what differs between sensors: a :class:`Driver`, and the frames that it delivers."""

from __future__ import annotations

import math
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import numpy as np

from ..errors import SensorDisconnectedError, SensorError
from ..geometry.camera import Camera
from ..geometry.frame import Features2D, RgbdFrame

Handle = TypeVar("Handle")


@dataclass(frozen=True)
class LiveFrame(RgbdFrame):
    """A frame of a live sensor, which owns its arrays.

    Attributes
    ----------
    index : int
        Number among the frames that were handed out.
    timestamp : float
        By the device's clock, s.
    host_timestamp : float
        Arrival on ``time.perf_counter``, s.
    sequence : int
        The device's frame number.
    dropped : int
        How many frames of this sensor were never handed out so far, because the device lost them, a newer one replaced
        them, or they were too old.
    """

    host_timestamp: float = 0.0
    sequence: int = 0
    dropped: int = 0

    @property
    def device_timestamp(self) -> float:
        """Seconds on the device's clock."""
        return self.timestamp

    @property
    def age(self) -> float:
        """Seconds since the frame arrived."""
        return time.perf_counter() - self.host_timestamp


@dataclass(frozen=True)
class RawFrame:
    """What a driver delivers.

    The arrays may be views of the vendor's memory that are valid until the driver is called again. They are copied at once.

    Attributes
    ----------
    depth : (H, W)
        Depth in mm, of any dtype. A pixel of 0 has no measurement.
    camera : Camera
        The calibration of the depth.
    colour : (H, W, 3) uint8 or None
        RGB picture that is aligned to the depth.
    sequence : int
        The device's frame number. A gap counts as lost frames.
    timestamp : float
        By the device's clock, s.
    features : Features2D or None
        2D features, if the device provides them.
    """

    depth: np.ndarray
    camera: Camera
    colour: np.ndarray | None
    sequence: int
    timestamp: float
    features: Features2D | None = None


class Driver(ABC):
    """A vendor's library behind a small interface. A single thread calls :meth:`open`, :meth:`grab` and :meth:`close`.

    A subclass overrides the defaults of these attributes on the class, or sets them before :meth:`open` returns.
    """

    name: str = "sensor"  #: for titles
    live: bool = True  #: newer frames replace unread ones; a file waits until it is read
    reopens: bool = True  #: the sensor can be opened again after it was unplugged
    has_features: bool = False  #: frames bring 2D features
    colour_only: bool = False  #: there is no depth camera: every depth is 0
    depth_scale: float = 1000.0  #: units per metre in which depth is measured
    fps: float = 30.0
    broken: Sequence[str] = ()  #: of a recording: why each of its broken frames cannot be used

    description: str = ""  #: for the list of sensors
    unconnected: str = "not connected"  #: the state in that list where ``connected`` returns nothing
    open_timeout: float = 30.0  #: longest that ``open`` may take, s

    @classmethod
    def named(cls, argument: str) -> Callable[[], Driver]:
        """Return a function that makes the driver of ``KIND:argument``.

        Parameters
        ----------
        argument : str
            The text after the colon, or "".

        Returns
        -------
        callable
            Makes a new driver. It is called once more for every reconnection.

        Raises
        ------
        ParameterError, SensorError
            The argument names no device.
        """
        return lambda: cls(argument)  # type: ignore[call-arg]  # each subclass takes its own

    @classmethod
    def connected(cls) -> Sequence[tuple[str, ...]]:
        """Return (identifier, name) or (identifier, name, state) of every connected device.

        It may raise any exception.
        """
        return []

    @abstractmethod
    def open(self) -> None:
        """Start streaming. Raises :class:`SensorError` if the sensor cannot be started."""

    @abstractmethod
    def grab(self, timeout: float) -> RawFrame | None:
        """Return the next frame.

        Parameters
        ----------
        timeout : float
            Longest time to wait, s.

        Returns
        -------
        RawFrame or None
            The frame, or None if there is none within the time.

        Raises
        ------
        SensorDisconnectedError
            The device is gone.
        EndOfRecording
            The recording is over.
        """

    @abstractmethod
    def close(self) -> None:
        """Stop and release everything. It is also called after :meth:`open` has failed."""

    def _opened(self, handle: Handle | None) -> Handle:
        """Return a handle that :meth:`open` sets, for use while the driver is open.

        Parameters
        ----------
        handle : object or None
            The handle, or None if the driver is not open.

        Returns
        -------
        object
            The handle.

        Raises
        ------
        SensorError
            The driver is not open.
        """
        if handle is None:
            raise self._not_open()
        return handle

    def _unplugged(self) -> SensorDisconnectedError:
        return SensorDisconnectedError(f"{self.name}: unplugged; it is opened again when it is back")

    def _not_open(self) -> SensorError:
        return SensorError(f"{self.name}: is not open; call open() before grab()")


class CameraOrFile(Driver):
    """A driver of cameras that also plays their recordings.

    Parameters
    ----------
    name : str
        The name of the camera.
    path : Path or None
        A recording to play instead of a camera, as fast as it is read.

    Attributes
    ----------
    camera : Camera
        The calibration, once the driver is open.
    """

    camera: Camera

    def __init__(self, name: str, path: Path | None) -> None:
        self.path, self.live = path, path is None
        self.name = name.strip() if path is None else path.stem


def usable(raw: RawFrame) -> bool:
    """Return whether the images have the size that the camera's calibration states."""
    size = (raw.camera.height, raw.camera.width)
    return raw.depth.shape == size and (raw.colour is None or raw.colour.shape == (*size, 3))


def live_frame(raw: RawFrame) -> LiveFrame:
    """Return the frame that has just arrived, with copied arrays.

    Depth that is NaN, infinite or negative becomes 0 (no measurement).
    """
    depth = np.array(raw.depth, np.float32)
    depth[~((depth > 0) & (depth < np.inf))] = 0
    colour = None if raw.colour is None else np.array(raw.colour, np.uint8)
    timestamp = float(raw.timestamp) if math.isfinite(raw.timestamp) else time.perf_counter()
    return LiveFrame(
        depth,
        raw.camera,
        colour,
        0,
        timestamp,
        raw.features,
        host_timestamp=time.perf_counter(),
        sequence=int(raw.sequence),
    )
