"""Read an iPhone's TrueDepth camera live: the app Record3D streams over USB, and the package ``record3d`` receives.

The stream has neither a clock nor frame numbers, so frames are counted and timed as they arrive. The picture is scaled to the
depth's size, and keeps the orientation in which the app sends it.
"""

from __future__ import annotations

import sys
import threading
import time
from typing import Any

import numpy as np
from PIL import Image

from ..errors import DriverMissingError, SensorDisconnectedError, SensorError, SensorNotFoundError
from ..geometry.camera import Camera
from .driver import Driver, RawFrame
from .record3d import scaled_camera

#: Closed streams, which are kept: the library's thread may still run, and freeing its stream would end the process.
_RETIRED: list = []


def record3d_stream_class():
    """Return the library's class of streams. Raises :class:`DriverMissingError`."""
    try:
        from record3d import Record3DStream
    except ImportError:
        line = 'pip install "adaptiveface[record3d]"'
        if sys.platform == "darwin":  # no wheel for macOS
            line += " and, with CMake, pip install record3d"
        raise DriverMissingError(f"the Record3D stream needs record3d: {line}") from None
    return Record3DStream


def connected_phones() -> list[str]:
    """Return the identifiers (UDID) of the connected iPhones."""
    return [device.udid for device in record3d_stream_class().get_connected_devices()]


class Record3DDriver(Driver):
    """The iPhone with an identifier, or the first one."""

    live, has_features, fps, depth_scale = True, False, 30.0, 10_000.0
    description = "iPhone with the app Record3D, by USB"

    def __init__(self, identifier: str = "") -> None:
        self._stream_class = record3d_stream_class()
        self.identifier, self.name = identifier, f"Record3D {identifier}".strip()
        self._arrived = threading.Condition()
        self._newest: RawFrame | None = None
        self._failure: Exception | None = None
        self._stopped, self._count = False, 0
        self._stream: Any | None = None

    @classmethod
    def connected(cls) -> list[tuple[str, str]]:
        """Return (identifier, description) of every connected iPhone."""
        return [(phone, cls.description) for phone in connected_phones()]

    def open(self) -> None:
        """Connect to the app. Raises :class:`SensorNotFoundError` or :class:`SensorError`."""
        devices = list(self._stream_class.get_connected_devices())
        device = next((d for d in devices if self.identifier in ("", d.udid)), None)
        if device is None:
            found = ", ".join(d.udid for d in devices) or "none"
            raise SensorNotFoundError(f"{self.name}: no such iPhone by USB (found: {found}); plug it in and unlock it")
        self._stream = stream = self._stream_class()
        stream.on_new_frame = self._on_frame
        stream.on_stream_stopped = self._on_stopped
        if not stream.connect(device):
            raise SensorError(f"{self.name}: no answer; open Record3D, choose USB streaming and press record")

    def grab(self, timeout: float) -> RawFrame | None:
        """Return the newest frame that has arrived, or None if there is none within ``timeout`` s."""
        with self._arrived:
            self._arrived.wait_for(lambda: self._newest is not None or self._stopped, timeout)
            frame, self._newest = self._newest, None
            if self._failure is not None:
                raise SensorError(f"{self.name}: sends frames that cannot be used ({self._failure})")
            if frame is None and self._stopped:
                raise SensorDisconnectedError(f"{self.name}: the stream stopped; press record in the app again")
            return frame

    def close(self) -> None:
        """Disconnect."""
        stream, self._stream = self._stream, None
        if stream is not None:
            _RETIRED.append(stream)
            if not self._stopped:
                stream.disconnect()

    # ---- called by the library's thread ----------------------------------------------------------------------------
    def _on_frame(self) -> None:
        stream = self._stream
        if stream is None:
            return
        frame = failure = None
        try:
            k = stream.get_intrinsic_mat()
            depth = np.array(stream.get_depth_frame(), np.float32) * np.float32(1000.0)
            picture = np.array(stream.get_rgb_frame(), np.uint8)
            frame = aligned_frame(depth, picture, (k.fx, k.fy, k.tx, k.ty), self._count)
        except Exception as error:  # the caller is the library's own thread, where an exception would end the process
            failure = error
        with self._arrived:
            self._newest, self._failure, self._count = frame, failure, self._count + 1
            self._arrived.notify_all()

    def _on_stopped(self) -> None:
        with self._arrived:
            self._stopped = True
            self._arrived.notify_all()


def aligned_frame(depth: np.ndarray, picture: np.ndarray, intrinsics, number: int) -> RawFrame:
    """Make a frame of depth and picture of the same view.

    Parameters
    ----------
    depth : (h, w) array
        Depth in mm.
    picture : (H, W, 3) uint8
        RGB picture, which is scaled to the size of the depth.
    intrinsics : tuple of 4 float
        fx, fy, cx and cy of the picture, px.
    number : int
        Number of the frame.

    Returns
    -------
    RawFrame
        The frame. Its time is the present moment.
    """
    (height, width), (rows, columns) = depth.shape, picture.shape[:2]
    camera = scaled_camera(Camera(columns, rows, *intrinsics), (width, height))
    if (rows, columns) != (height, width):
        picture = np.array(Image.fromarray(picture).resize((width, height), Image.Resampling.BILINEAR))
    return RawFrame(depth, camera, picture, number, time.perf_counter())
