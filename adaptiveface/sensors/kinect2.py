"""Kinect v2 through kinect-next and Microsoft's Kinect for Windows SDK 2.0, on Windows. Not tested with a camera.

The SDK tells the viewing ray of each depth pixel, and what the picture shows there. Its images are mirrored, because x points
to the sensor's left in the SDK's camera space. They are flipped before frames are handed over.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from typing import Any

import cv2
import numpy as np

from ..errors import DriverMissingError, ParameterError, SensorDisconnectedError, SensorError, SensorNotFoundError
from .driver import Driver, RawFrame
from .registration import Lens, Registration

WIDTH, HEIGHT = 512, 424
#: Longest time that the runtime may take to find the sensor, and that a running sensor may deliver nothing, s.
PATIENCE = 3.0


def kinect_module():
    """Return the library. Raises :class:`DriverMissingError`."""
    if sys.platform != "win32":
        way_out = "record there with 'adaptiveface record kinect2 --out DIR', track anywhere"
        raise DriverMissingError(f"Kinect v2 needs Windows and Microsoft's Kinect for Windows SDK 2.0; {way_out}")
    return _imported()


def _imported():
    try:
        import kinect_next
    except ImportError:
        line = 'pip install "adaptiveface[kinect2]"'
        raise DriverMissingError(f"Kinect v2 needs kinect-next and the Kinect for Windows SDK 2.0: {line}") from None
    return kinect_next


def connected_sensors() -> list[tuple[str, str]]:
    """Return an empty list, because the SDK finds a sensor only by opening it. Raises :class:`DriverMissingError`."""
    kinect_module()
    return []


class Kinect2Driver(Driver):
    """The one sensor that the SDK supports."""

    live, has_features, fps, depth_scale, name = True, False, 30.0, 1000.0, "Kinect v2"
    description = "Kinect v2"
    unconnected = "known when it is opened"

    def __init__(self, library=None) -> None:
        self._library = library or kinect_module()
        self._sensor: Any | None = None
        self._registration: Registration | None = None
        self._sequence = 0

    @classmethod
    def named(cls, argument: str) -> Callable[[], Driver]:
        """Return a function that makes the driver. Raises :class:`ParameterError` if ``argument`` names a sensor."""
        if argument:
            raise ParameterError(f"kinect2:{argument}: the SDK supports one sensor, which has no number; use 'kinect2'")
        return cls

    @classmethod
    def connected(cls) -> list[tuple[str, str]]:
        """See :func:`connected_sensors`."""
        return connected_sensors()

    def open(self) -> None:
        """Start depth and colour. Raises :class:`SensorNotFoundError` or :class:`SensorError`."""
        library = self._library
        streams = library.StreamType.COLOR | library.StreamType.DEPTH
        self._sensor = sensor = library.KinectSensor(streams, auto_open=False)
        try:
            sensor.open()
        except library.KinectNotAvailableError as error:
            raise SensorNotFoundError(f"{self.name}: {error}") from None
        except (library.KinectError, OSError) as error:
            raise SensorError(f"{self.name}: cannot start depth and colour ({error}); use a USB 3 port") from None
        deadline = time.perf_counter() + PATIENCE
        while not sensor.is_available:
            if time.perf_counter() > deadline:
                raise SensorNotFoundError(f"{self.name}: not connected; check its power supply and the USB 3 port")
            time.sleep(0.05)
        self._last = time.perf_counter()

    def grab(self, timeout: float) -> RawFrame | None:
        """Return the next pair of depth and colour, or None if there is no depth."""
        library, sensor = self._library, self._opened(self._sensor)
        try:
            frames = sensor.wait_for_frames(max(int(timeout * 1000), 1))
        except library.KinectTimeoutError:
            if time.perf_counter() - self._last > PATIENCE and not sensor.is_available:
                raise self._unplugged() from None
            return None
        except library.KinectError as error:
            raise SensorDisconnectedError(f"{self.name}: stopped ({error}); it is opened again") from error
        self._last = time.perf_counter()
        if frames.depth is None:
            return None
        if self._registration is None:  # the calibration comes with the first frames
            self._registration = registration(sensor.mapper)
        lens = self._registration
        depth = lens.depth(frames.depth.data[:, ::-1].copy())
        picture = None if frames.color is None else lens.image(_aligned(sensor.mapper, frames))
        self._sequence += 1
        seconds = frames.depth.relative_time_ns / 1e9
        return RawFrame(depth, lens.camera, picture, self._sequence, seconds)

    def close(self) -> None:
        """Release the sensor."""
        sensor, self._sensor = self._sensor, None
        if sensor is not None:
            sensor.close()


def _aligned(mapper, frames) -> np.ndarray:
    """Return the RGB (424, 512, 3) of the picture at each pixel of the depth, not mirrored. It is black without depth."""
    where = np.array(mapper.map_depth_frame_to_color_space(frames.depth), np.float32)
    where[~np.isfinite(where)] = -1e4
    rgb = np.ascontiguousarray(frames.color.as_rgb())
    return cv2.remap(rgb, where[..., 0], where[..., 1], cv2.INTER_LINEAR)[:, ::-1].copy()


def registration(mapper) -> Registration:
    """Find the calibration of the depth camera, not mirrored, from the viewing rays of its pixels.

    The distortion is radial: (u - cx) / fx = x (1 + k1 r^2 + k2 r^4 + k3 r^6) is solved for k.

    Parameters
    ----------
    mapper : object
        The SDK's mapper, which gives the rays.

    Returns
    -------
    Registration
        The calibration.

    Raises
    ------
    SensorError
        The runtime has no calibration yet, or the lens is of another kind.
    """
    fx, fy, cx, cy = mapper.get_depth_camera_intrinsics()
    points = np.asarray(mapper.map_depth_frame_to_camera_space(np.full((HEIGHT, WIDTH), 1000, np.uint16)), float)
    if fx <= 0 or not np.isfinite(points).all():
        raise SensorError("Kinect v2: the SDK has no calibration yet; try again")
    x, y = points[..., 0] / points[..., 2], -points[..., 1] / points[..., 2]
    u, v = np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT))
    powers = np.stack([(x**2 + y**2) ** n for n in (1, 2, 3)], axis=-1)
    rows = np.concatenate([(powers * (fx * x)[..., None]).reshape(-1, 3), (powers * (fy * y)[..., None]).reshape(-1, 3)])
    rest = np.concatenate([(u - cx - fx * x).ravel(), (v - cy - fy * y).ravel()])
    k1, k2, k3 = np.linalg.lstsq(rows, rest, rcond=None)[0]
    off = float(np.abs(rows @ [k1, k2, k3] - rest).max())
    if off > 1.0:
        raise SensorError(f"Kinect v2: the SDK's rays do not fit a radial lens (off by {off:.1f} pixels)")
    matrix = np.array([[fx, 0, WIDTH - 1 - cx], [0, fy, cy], [0, 0, 1]])
    return Registration(Lens(WIDTH, HEIGHT, matrix, np.array([k1, k2, 0, 0, k3, 0, 0, 0])))
