"""Azure Kinect through pyk4a: playback of ``.mkv`` recordings, and cameras.

The SDK's own transformation of images needs an OpenGL context. Instead, :mod:`adaptiveface.sensors.registration` removes the
lens distortion of the depth and aligns the picture to it, with the calibration that the SDK reads.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from ..errors import (
    DriverMissingError,
    EndOfRecording,
    FileFormatError,
    SensorDisconnectedError,
    SensorError,
    SensorNotFoundError,
)
from .capture_device import decoded_jpeg
from .driver import CameraOrFile, Driver, RawFrame
from .file_player import FilePlayer
from .registration import Lens, Registration

_FPS = (5.0, 15.0, 30.0)
_OWN_ENVIRONMENT = (
    'python3.11 -m venv azure && azure/bin/pip install "adaptiveface[azure]" && '
    "azure/bin/adaptiveface convert FILE.mkv --out DIR (what it writes is read in every environment)"
)
#: Size of the picture by colour resolution, pixels; index 0 is off.
_PICTURES = ((0, 0), (1280, 720), (1920, 1080), (2560, 1440), (2048, 1536), (3840, 2160), (4096, 3072))
#: Size of the depth by depth mode, pixels.
_DEPTHS = {1: (320, 288), 2: (640, 576), 3: (512, 512), 4: (1024, 1024)}


def pyk4a_module():
    """Return the library.

    Raises
    ------
    DriverMissingError
        The library is not installed, or NumPy is too new for it. The message states the way out.
    """
    os.environ.setdefault("K4A_ENABLE_LOG_TO_STDOUT", "0")  # failures are reported as errors
    if int(np.__version__.partition(".")[0]) >= 2:
        reason = f"pyk4a-bundle needs NumPy 1, this environment has {np.__version__}"
        raise DriverMissingError(f"Azure Kinect: {reason}; make one for it: {_OWN_ENVIRONMENT}")
    try:
        import pyk4a
    except ImportError:
        line = 'pip install "adaptiveface[azure]" (Python 3.11 or 3.12, Linux or Windows)'
        raise DriverMissingError(f"Azure Kinect needs pyk4a-bundle: {line}") from None
    return pyk4a


def connected_cameras() -> list[tuple[str, str]]:
    """Return (index, name) of every connected camera."""
    return [(str(index), "Azure Kinect") for index in range(pyk4a_module().connected_device_count())]


class AzureDriver(CameraOrFile):
    """An Azure Kinect, or a recording that plays as fast as it is read.

    Parameters
    ----------
    index : int
        Number of the camera (0-based).
    path : Path, optional
        A recording (.mkv) to play instead.
    """

    has_features, fps, depth_scale = False, 30.0, 1000.0
    description = "Azure Kinect"

    def __init__(self, index: int = 0, path: Path | None = None) -> None:
        super().__init__(f"Azure Kinect {index}", path)
        self._k4a = pyk4a_module()
        self.index = index
        self._device: Any | None = None
        self._start_time: float | None = None
        self._sequence = -1

    @classmethod
    def named(cls, argument: str) -> Callable[[], Driver]:
        """Return a function that makes the driver of the camera with a number, or the player of a recording by its path."""
        if argument.isascii() and argument.isdecimal() and len(argument) < 4 or not argument:
            return lambda: cls(int(argument or 0))
        if not (argument.lower().endswith(".mkv") and Path(argument).is_file()):
            raise SensorError(f"azure:{argument}: neither the number of a camera nor a recording (.mkv)")
        return lambda: FilePlayer(Path(argument))

    @classmethod
    def connected(cls) -> list[tuple[str, str]]:
        """See :func:`connected_cameras`."""
        return connected_cameras()

    def open(self) -> None:
        """Start streaming. Raises :class:`SensorNotFoundError`, :class:`SensorError` or :class:`FileFormatError`."""
        if self.live:
            self._open_camera()
        else:
            self._open_file()

    def _open_camera(self) -> None:
        k4a, count = self._k4a, self._k4a.connected_device_count()
        if self.index >= count:
            found = f"{count} connected, counted from 0" if count else "none is connected; check cable and power supply"
            raise SensorNotFoundError(f"{self.name}: no such camera ({found})")
        config = k4a.Config(color_format=k4a.ImageFormat.COLOR_BGRA32, synchronized_images_only=True)
        self._device = device = k4a.PyK4A(config, device_id=self.index)
        try:
            device.start()
            self._calibrate(device.calibration, config.depth_mode, config.color_resolution)
        except k4a.K4AException as error:
            hint = "close other programs that use it, use a USB 3 port, and run it where OpenGL is available"
            raise SensorError(f"{self.name}: cannot start depth and colour ({error}); {hint}") from None
        self._format = config.color_format

    def _open_file(self) -> None:
        k4a = self._k4a
        self._device = playback = k4a.PyK4APlayback(str(self.path))
        try:
            playback.open()
            configuration = playback.configuration
            if not configuration["depth_track_enabled"]:
                raise FileFormatError(f"{self.path}: holds no depth; record with a depth mode")
            resolution = configuration["color_resolution"] if configuration["color_track_enabled"] else 0
            self._calibrate(playback.calibration, configuration["depth_mode"], resolution)
        except (k4a.K4AException, ValueError) as error:
            if isinstance(error, FileFormatError):
                raise
            reason = str(error) or "no calibration"
            raise FileFormatError(f"{self.path}: not an Azure Kinect recording with depth ({reason})") from None
        self.fps, self._format = _FPS[int(configuration["camera_fps"])], configuration["color_format"]

    def _calibrate(self, calibration, depth_mode, resolution) -> None:
        kinds = self._k4a.CalibrationType
        if int(depth_mode) not in _DEPTHS:
            raise FileFormatError(f"{self.name}: depth mode {depth_mode!r} has no depth")

        def lens(kind, size: tuple[int, int]) -> Lens:
            """Return the calibration of one of the two cameras, for pictures of ``size`` (width, height) px."""
            width, height = size
            return Lens(width, height, calibration.get_camera_matrix(kind), calibration.get_distortion_coefficients(kind))

        depth = lens(kinds.DEPTH, _DEPTHS[int(depth_mode)])
        colour = lens(kinds.COLOR, _PICTURES[int(resolution)]) if int(resolution) else None
        rotation, metres = None, np.zeros(3)
        if colour is not None:
            rotation, metres = calibration.get_extrinsic_parameters(kinds.DEPTH, kinds.COLOR)
        self._registration = Registration(depth, colour, rotation, 1000.0 * np.asarray(metres))
        self.camera = self._registration.camera

    def grab(self, timeout: float) -> RawFrame | None:
        """Return the next pair of depth and colour, or None if there is no depth."""
        k4a, device = self._k4a, self._opened(self._device)
        try:
            capture = device.get_capture(max(int(timeout * 1000), 1)) if self.live else device.get_next_capture()
        except k4a.K4ATimeoutException:
            return None
        except EOFError:
            raise EndOfRecording(f"{self.path}: the end of the recording") from None
        except k4a.K4AException as error:
            if self.live:
                raise SensorDisconnectedError(f"{self.name}: stopped answering; plug it in again") from error
            raise FileFormatError(f"{self.path}: damaged after {self._sequence + 1} frames") from None
        return self._frame(capture)

    def _frame(self, capture) -> RawFrame | None:
        raw = capture.depth
        if raw is None:
            return None
        seconds = capture.depth_timestamp_usec / 1e6
        depth = self._registration.depth(raw)
        colour = None if capture.color is None else _rgb(self._k4a, capture.color, self._format)
        if colour is not None:
            colour = self._registration.colour(colour, depth)
        return RawFrame(depth, self.camera, colour, self._number(seconds), seconds)

    def _number(self, seconds: float) -> int:
        """Return the number of a frame, computed from the device's clock because frames have none. It always increases."""
        if self._start_time is None:
            self._start_time = seconds
        self._sequence = max(round((seconds - self._start_time) * self.fps), self._sequence + 1)
        return self._sequence

    def close(self) -> None:
        """Stop the cameras or close the file."""
        device, self._device = self._device, None
        if device is None:
            return
        if not self.live:
            device.close()
        elif device.is_running:
            device.stop()
        elif device.opened:
            device.close()


def _rgb(k4a, picture: np.ndarray, layout) -> np.ndarray | None:
    """Return the RGB (h, w, 3) of a picture in the SDK's ``layout``, or None if it is a broken JPEG."""
    formats = k4a.ImageFormat
    if layout == formats.COLOR_MJPG:
        return decoded_jpeg(np.frombuffer(picture, np.uint8))
    code = {
        formats.COLOR_BGRA32: cv2.COLOR_BGRA2RGB,
        formats.COLOR_NV12: cv2.COLOR_YUV2RGB_NV12,
        formats.COLOR_YUY2: cv2.COLOR_YUV2RGB_YUY2,
    }.get(layout)
    if code is None:
        raise FileFormatError(f"colour format {layout!r} is not supported; record MJPG or BGRA32")
    return cv2.cvtColor(picture, code)
