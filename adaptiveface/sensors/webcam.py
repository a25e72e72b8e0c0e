"""A colour camera through OpenCV: ``webcam[:INDEX]``, or ``webcam:http://...`` for the stream of a network camera.

Such a camera measures no depth. Depth is 0 everywhere, and tracking is the degraded mode of ``tracking/colour_tracker.py``. The
camera does not report its field of view, so that is assumed. It does not report the time of a picture either, so the time of
arrival is used.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import urlsplit

import cv2
import numpy as np

from ..errors import ParameterError, SensorDisconnectedError, SensorError, SensorNotFoundError
from .capture_device import FIELD_OF_VIEW, FIELD_OF_VIEW_RANGE, as_rgb, camera_of_view, quiet
from .driver import Driver, RawFrame
from .mjpeg import MjpegStream, open_mjpeg
from .video_probe import MAX_BYTES, MAX_PIXELS, too_large

#: Folders in which Linux lists its cameras, and describes them.
DEVICES, ABOUT = Path("/dev"), Path("/sys/class/video4linux")
#: So many failed reads in a row mean that the camera is gone. A single one may be a damaged picture.
MOST_FAILURES, RETRY_SECONDS = 5, 0.02
#: Largest number of cameras that are tried by index on systems without a list of them.
MOST_INDICES = 4
#: Longest time that a network camera may take to answer at all, and to send a picture, ms.
OPEN_MS, READ_MS = 5000, 2000
#: What the list of sensors states about every camera.
NOTE = "colour only: no depth, degraded"


@dataclass(frozen=True)
class WebcamOptions:
    """The settings of a webcam.

    Attributes
    ----------
    device : int or str
        The number of a camera, or the address of a stream.
    field_of_view : float
        Angle across the longer side, degrees.
    mirrored : bool
        Whether pictures are flipped left to right.
    """

    device: int | str = 0
    field_of_view: float = FIELD_OF_VIEW
    mirrored: bool = False

    @classmethod
    def parse(cls, text: str) -> WebcamOptions:
        """Read the settings from ``[INDEX|http://...][,fov=DEGREES][,mirrored]``. Raises :class:`ParameterError`."""
        device, *settings = text.split(",") if text else [""]
        field_of_view, mirrored = FIELD_OF_VIEW, False
        for setting in settings:
            name, _, value = setting.partition("=")
            if name == "fov":
                field_of_view = _degrees(text, value)
            elif setting == "mirrored":
                mirrored = True
            else:
                raise ParameterError(f"webcam:{text}: {setting!r} is not a setting; possible: fov=DEGREES, mirrored")
        if device.startswith(("http://", "https://", "rtsp://")):
            return cls(device, field_of_view, mirrored)
        if device and not (device.isascii() and device.isdecimal() and len(device) <= 3):
            raise ParameterError(f"webcam:{text}: {device!r} is neither the number of a camera nor an http address")
        return cls(int(device or 0), field_of_view, mirrored)


def _label(device: int | str) -> str:
    """Return the number, or only the host of an address, which may hold a password."""
    return str(device) if isinstance(device, int) else urlsplit(device).hostname or "stream"


def _degrees(text: str, value: str) -> float:
    low, high = FIELD_OF_VIEW_RANGE
    try:
        degrees = float(value)
    except ValueError:
        degrees = float("nan")
    if not low <= degrees <= high:
        raise ParameterError(f"webcam:{text}: the field of view {value!r} is not between {low:g} and {high:g} degrees")
    return degrees


class WebcamDriver(Driver):
    """A colour camera.

    Parameters
    ----------
    options : WebcamOptions
        The camera and its settings.
    size : (int, int)
        Width and height of the pictures that are asked for, px. The camera may send another size.
    """

    live, has_features, colour_only, depth_scale = True, False, True, 10_000.0
    description = f"colour camera ({NOTE})"

    def __init__(self, options: WebcamOptions = WebcamOptions(), size: tuple[int, int] = (640, 480)) -> None:
        self.options, self.size, self.fps = options, size, 30.0
        self.name = f"webcam {_label(options.device)}, colour only"
        self._capture: cv2.VideoCapture | MjpegStream | None = None

    @classmethod
    def named(cls, argument: str) -> Callable[[], Driver]:
        """Return a function that makes the driver of ``[INDEX|http://...][,fov=DEGREES][,mirrored]``."""
        options = WebcamOptions.parse(argument)
        return lambda: cls(options)

    @classmethod
    def connected(cls) -> list[tuple[str, str, str]]:
        """Return (index, name, state) of every colour camera."""
        return [(index, f"{name} ({NOTE})", state) for index, name, state in connected_webcams()]

    def open(self) -> None:
        """Start the camera.

        Raises
        ------
        SensorNotFoundError
            There is no such camera.
        SensorError
            The camera is busy, or its use is not allowed.
        """
        device = self.options.device
        if isinstance(device, int) and sys.platform == "linux":
            _check_linux(self.name, device)
        self._count, self._failures = 0, 0
        if isinstance(device, str) and self._open_mjpeg(device):
            return
        with quiet():
            self._capture = capture = _open(device)
            if not capture.isOpened():
                raise _refused(self.name, device)
            if isinstance(device, int):
                capture.set(cv2.CAP_PROP_FRAME_WIDTH, self.size[0])
                capture.set(cv2.CAP_PROP_FRAME_HEIGHT, self.size[1])
                capture.set(cv2.CAP_PROP_BUFFERSIZE, 1)  # the newest picture, where the system allows it
            rate = float(capture.get(cv2.CAP_PROP_FPS))
        self.fps = rate if 1.0 <= rate <= 240.0 else 30.0

    def _open_mjpeg(self, address: str) -> bool:
        """Open an MJPEG stream, as most cameras send it. Returns whether it is one. OpenCV tries anything else."""
        if not address.startswith(("http://", "https://")):
            return False
        try:
            self._capture = open_mjpeg(address, self.name, OPEN_MS / 1000)
        except OSError as error:
            raise _refused(self.name, address) from error
        if self._capture is None and too_large(address):
            raise SensorError(f"{self.name}: its pictures need more than {MAX_PIXELS} pixels or {MAX_BYTES >> 20} MiB")
        return self._capture is not None

    def grab(self, timeout: float) -> RawFrame | None:
        """Return the next picture, or None if reading failed.

        OpenCV's wait cannot be shortened. It lasts until the camera delivers a picture.
        """
        if self._capture is None:
            raise self._not_open()
        with quiet():
            found, picture = self._capture.read()
        if not found or picture is None:
            self._failures += 1
            if self._failures >= MOST_FAILURES:
                raise SensorDisconnectedError(f"{self.name}: sends no more pictures; is it still plugged in?")
            time.sleep(min(RETRY_SECONDS, timeout))
            return None
        self._failures = 0
        self._count += 1
        height, width = picture.shape[:2]
        camera = camera_of_view(width, height, self.options.field_of_view)
        depth = np.zeros((height, width), np.float32)
        return RawFrame(depth, camera, as_rgb(picture, self.options.mirrored), self._count, time.perf_counter())

    def close(self) -> None:
        """Stop the camera. Its light goes out."""
        capture, self._capture = self._capture, None
        if isinstance(capture, MjpegStream):
            capture.close()
        elif capture is not None:
            with quiet():
                capture.release()


def connected_webcams() -> list[tuple[str, str, str]]:
    """List the colour cameras.

    Linux lists them without starting any. On other systems, each camera is opened for a moment, up to the first index that
    fails.

    Returns
    -------
    list of tuple of str
        Index, name and state of every camera. The state is "ready", or why the camera cannot be opened.
    """
    if sys.platform == "linux":
        return [(str(i), _linux_name(i), _linux_state(i)) for i in linux_cameras()]
    found = []
    for index in range(MOST_INDICES):
        with quiet():
            capture = _open(index)
            opened = capture.isOpened()
            capture.release()
        if not opened:
            break
        found.append((str(index), f"camera {index}", "ready"))
    return found


def linux_cameras(devices: Path | None = None, about: Path | None = None) -> list[int]:
    """Return the numbers of the /dev/video* nodes that are the first of a camera. Other nodes deliver its metadata."""
    devices, about = devices or DEVICES, about or ABOUT
    numbers = sorted(int(node.name[5:]) for node in devices.glob("video*") if node.name[5:].isdecimal())
    return [number for number in numbers if _text(about / f"video{number}" / "index") in ("", "0")]


def _linux_name(index: int) -> str:
    return _text(ABOUT / f"video{index}" / "name") or f"camera {index}"


def _linux_state(index: int) -> str:
    node = DEVICES / f"video{index}"
    return "ready" if os.access(node, os.R_OK | os.W_OK) else _not_allowed(node)


def _not_allowed(node: Path) -> str:
    return f"no permission to open {node}: sudo usermod -aG video $USER, then log in again"


def _check_linux(name: str, index: int) -> None:
    node = DEVICES / f"video{index}"
    if not node.exists():
        cameras = ", ".join(f"webcam:{i}" for i in linux_cameras()) or "none"
        raise SensorNotFoundError(f"{name}: there is no {node} (found: {cameras}); plug the camera in")
    if not os.access(node, os.R_OK | os.W_OK):
        raise SensorError(f"{name}: {_not_allowed(node)}")


def _refused(name: str, device: int | str) -> SensorError:
    if isinstance(device, str):
        return SensorNotFoundError(f"{name}: no video stream there; open the address in a browser to see whether it runs")
    if sys.platform == "linux":
        return SensorError(f"{name}: busy or not a camera; close other programs that use it")
    allowed = {
        "darwin": "allow the terminal in System Settings, Privacy & Security, Camera",
        "win32": "allow desktop apps in Settings, Privacy, Camera",
    }.get(sys.platform, "check its permissions")
    return SensorNotFoundError(f"{name}: not connected, busy in another program, or not allowed ({allowed})")


def _open(device: int | str) -> cv2.VideoCapture:
    if isinstance(device, str):
        limits = [cv2.CAP_PROP_OPEN_TIMEOUT_MSEC, OPEN_MS, cv2.CAP_PROP_READ_TIMEOUT_MSEC, READ_MS]
        return cv2.VideoCapture(device, cv2.CAP_FFMPEG, limits)
    # The backend is fixed, because OpenCV would also ask its backend of depth cameras for the index.
    backend = {"linux": cv2.CAP_V4L2, "win32": cv2.CAP_MSMF, "darwin": cv2.CAP_AVFOUNDATION}
    return cv2.VideoCapture(device, backend.get(sys.platform, cv2.CAP_ANY))


def _text(path: Path) -> str:
    try:
        return path.read_text().strip()
    except OSError:
        return ""
