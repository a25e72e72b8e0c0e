"""What differs between sensors: a :class:`Driver` and the frames that it delivers."""

from __future__ import annotations

import math
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ..geometry.camera import Camera
from ..geometry.frame import Features2D, RgbdFrame


@dataclass(frozen=True)
class LiveFrame(RgbdFrame):
    """A frame of a live sensor; it owns its arrays.

    ``index`` counts the frames handed out; ``timestamp`` is the device's clock, s; ``host_timestamp`` the arrival on
    ``time.perf_counter``, s; ``sequence`` the device's frame number; ``dropped`` how many frames of this sensor were
    never handed out until now: lost by the device, replaced by a newer one, or too old.
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
    """What a driver delivers: ``depth`` (H, W) mm of any dtype, ``colour`` (H, W, 3) uint8 RGB aligned to it or None.

    Arrays may be views of the vendor's memory, valid until the driver is called again; they are copied at once.
    """

    depth: np.ndarray
    camera: Camera
    colour: np.ndarray | None
    sequence: int
    timestamp: float
    features: Features2D | None = None


class Driver(ABC):
    """One vendor's library behind one small interface; one thread calls :meth:`open`, :meth:`grab` and :meth:`close`.

    A subclass sets the fields that differ from these defaults, on the class or before :meth:`open` returns.
    """

    name: str = "sensor"  #: for titles
    live: bool = True  #: newer frames replace those that nobody reads; a file waits instead
    reopens: bool = True  #: the sensor can be opened again after it was unplugged
    has_features: bool = False  #: frames bring 2D features
    colour_only: bool = False  #: there is no depth camera: every depth is 0
    depth_scale: float = 1000.0  #: units per metre in which depth is measured
    fps: float = 30.0
    broken: Sequence[str] = ()  #: a recording's: the reason of each frame that cannot be used

    description: str = ""  #: for the list of sensors
    unconnected: str = "not connected"  #: the state in that list where ``connected`` returns nothing
    open_timeout: float = 30.0  #: longest that ``open`` may take, s

    @classmethod
    def named(cls, argument: str) -> Callable[[], Driver]:
        """A function that makes the driver of ``KIND:argument``. It is called again for each reconnection.

        Raises :class:`ParameterError` or :class:`SensorError` where the argument names no device.
        """
        return lambda: cls(argument)  # type: ignore[call-arg]  # each subclass takes its own

    @classmethod
    def connected(cls) -> Sequence[tuple[str, ...]]:
        """(identifier, name) of every connected device, or (identifier, name, state); may raise anything."""
        return []

    @abstractmethod
    def open(self) -> None:
        """Start streaming. Raises :class:`SensorError`."""

    @abstractmethod
    def grab(self, timeout: float) -> RawFrame | None:
        """The next frame, or None when there is none within ``timeout`` seconds.

        Raises :class:`SensorDisconnectedError` or :class:`EndOfRecording`.
        """

    @abstractmethod
    def close(self) -> None:
        """Stop and release everything; also after a failed :meth:`open`."""


def usable(raw: RawFrame) -> bool:
    """Whether the images have the size that the camera says."""
    size = (raw.camera.height, raw.camera.width)
    return raw.depth.shape == size and (raw.colour is None or raw.colour.shape == (*size, 3))


def live_frame(raw: RawFrame) -> LiveFrame:
    """The frame that just arrived, in arrays of its own. NaN, infinite and negative depth become 0 (no measurement)."""
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
