"""Call the parts of the OpenNI2 library that a depth camera needs, through ctypes.

The Python package ``openni`` is not used: its enumerations fail to import on Python 3.13, it does not find Debian's
library, and it closes handles from whatever thread collects the garbage.
"""

from __future__ import annotations

import ctypes
import os
import sys
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from ctypes import POINTER, byref, c_char, c_char_p, c_int, c_uint16, c_uint64, c_void_p
from functools import wraps
from pathlib import Path

import numpy as np

from ..errors import DriverMissingError

#: Environment variables that name the folder of the library, as the vendor's installer sets them.
FOLDER_VARIABLES = ("OPENNI2_REDIST64", "OPENNI2_REDIST")
_FILES = {"win32": ("OpenNI2.dll",), "darwin": ("libOpenNI2.dylib",)}
_INSTALL = {
    "linux": "on Debian or Ubuntu: apt install libopenni2-0",
    "darwin": "install OpenNI2 (https://structure.io/openni)",
    "win32": "install OpenNI2 (https://structure.io/openni)",
}
_API_VERSION = 2002
_OK, _NO_DEVICE, _TIME_OUT = 0, 6, 102

#: Shortest time between opening and closing a player, s. If it is closed before its thread runs, closing never ends.
_SETTLING_SECONDS = 0.05
#: The only thread that calls the library. The library remembers every thread that ever waited for a frame, and crashes when
#: it looks up one that has ended. All sensors therefore share a thread that lives as long as the process.
_OWNER = ThreadPoolExecutor(1, thread_name_prefix="OpenNI2")
_started = False

DEPTH, COLOUR = 3, 2
DEPTH_1_MM, DEPTH_100_UM, RGB888 = 100, 101, 200
FOV_HORIZONTAL, FOV_VERTICAL, VIDEO_MODE, MIRRORING, NUMBER_OF_FRAMES = 1, 2, 3, 7, 8
IMAGE_REGISTRATION, PLAYBACK_SPEED, PLAYBACK_REPEAT = 5, 100, 101
DEPTH_TO_COLOUR = 1


def by_the_owner(function: Callable) -> Callable:
    """Decorate a function to run in the thread that owns the library. Its caller waits. Such calls must not be nested."""

    @wraps(function)
    def run(*arguments):
        return _OWNER.submit(function, *arguments).result()

    return run


class OpenNI2Error(RuntimeError):
    """A call of the library has failed. ``status`` is its status code."""

    def __init__(self, status: int, message: str) -> None:
        super().__init__(message)
        self.status = status


class VideoMode(ctypes.Structure):
    """Pixel format, size in pixels, and frames per second of a stream."""

    _fields_ = [("format", c_int), ("width", c_int), ("height", c_int), ("fps", c_int)]

    def __eq__(self, other) -> bool:
        return isinstance(other, VideoMode) and bytes(self) == bytes(other)


class DeviceInfo(ctypes.Structure):
    """The library's description of a device."""

    _fields_ = [("uri", c_char * 256), ("vendor", c_char * 256), ("name", c_char * 256), ("usb", c_uint16 * 2)]


class _SensorInfo(ctypes.Structure):
    _fields_ = [("kind", c_int), ("count", c_int), ("modes", POINTER(VideoMode))]


class Frame(ctypes.Structure):
    """A frame in the library's memory, which is valid until it is released."""

    _fields_ = [
        ("size", c_int),
        ("data", c_void_p),
        ("kind", c_int),
        ("timestamp", c_uint64),
        ("index", c_int),
        ("width", c_int),
        ("height", c_int),
        ("mode", VideoMode),
        ("cropped", c_int),
        ("x", c_int),
        ("y", c_int),
        ("stride", c_int),
    ]

    def image(self) -> np.ndarray:
        """Copy the image.

        Returns
        -------
        (H, W) uint16 or (H, W, 3) uint8
            Depth or colour in the full size of the mode. Borders that were cropped are 0.

        Raises
        ------
        OpenNI2Error
            The frame contradicts itself.
        """
        channels, dtype = (3, np.uint8) if self.mode.format == RGB888 else (1, np.uint16)
        item = channels * np.dtype(dtype).itemsize
        inside = 0 <= self.x <= self.mode.width - self.width and 0 <= self.y <= self.mode.height - self.height
        if not (self.data and inside and self.stride >= self.width * item and self.size >= self.stride * self.height):
            raise OpenNI2Error(1, f"a frame of {self.size} bytes is not {self.width} x {self.height} pixels")
        rows = np.ctypeslib.as_array((ctypes.c_uint8 * (self.stride * self.height)).from_address(self.data))
        pixels = np.ascontiguousarray(rows.reshape(self.height, self.stride)[:, : self.width * item]).view(dtype)
        pixels = pixels.reshape(self.height, self.width, channels)
        full = np.zeros((self.mode.height, self.mode.width, channels), dtype)
        full[self.y : self.y + self.height, self.x : self.x + self.width] = pixels
        return full if channels == 3 else full[..., 0]


_SIGNATURES = {  # name: argument types; all return a status, except those of _OTHER_RESULTS
    "oniInitialize": [c_int],
    "oniGetExtendedError": [],
    "oniGetDeviceList": [POINTER(POINTER(DeviceInfo)), POINTER(c_int)],
    "oniReleaseDeviceList": [POINTER(DeviceInfo)],
    "oniDeviceOpen": [c_char_p, POINTER(c_void_p)],
    "oniDeviceClose": [c_void_p],
    "oniDeviceGetInfo": [c_void_p, POINTER(DeviceInfo)],
    "oniDeviceGetSensorInfo": [c_void_p, c_int],
    "oniDeviceSetProperty": [c_void_p, c_int, c_void_p, c_int],
    "oniDeviceIsPropertySupported": [c_void_p, c_int],
    "oniDeviceIsImageRegistrationModeSupported": [c_void_p, c_int],
    "oniDeviceEnableDepthColorSync": [c_void_p],
    "oniDeviceCreateStream": [c_void_p, c_int, POINTER(c_void_p)],
    "oniStreamDestroy": [c_void_p],
    "oniStreamStart": [c_void_p],
    "oniStreamStop": [c_void_p],
    "oniStreamIsPropertySupported": [c_void_p, c_int],
    "oniStreamGetProperty": [c_void_p, c_int, c_void_p, POINTER(c_int)],
    "oniStreamSetProperty": [c_void_p, c_int, c_void_p, c_int],
    "oniWaitForAnyStream": [POINTER(c_void_p), c_int, POINTER(c_int), c_int],
    "oniStreamReadFrame": [c_void_p, POINTER(POINTER(Frame))],
    "oniFrameRelease": [POINTER(Frame)],
}
_OTHER_RESULTS = {
    **dict.fromkeys(("oniReleaseDeviceList", "oniStreamDestroy", "oniStreamStop", "oniFrameRelease")),
    "oniGetExtendedError": c_char_p,
    "oniDeviceGetSensorInfo": POINTER(_SensorInfo),
}
_FLAGS = ("oniDeviceIsPropertySupported", "oniDeviceIsImageRegistrationModeSupported", "oniStreamIsPropertySupported")


class OpenNI2Library:
    """The loaded library. :meth:`start` must be called first."""

    def __init__(self) -> None:
        self._c = _load()
        for name, arguments in _SIGNATURES.items():
            function = getattr(self._c, name)
            function.argtypes, function.restype = arguments, _OTHER_RESULTS.get(name, c_int)

    def call(self, name: str, *arguments):
        """Call a function of the library.

        Parameters
        ----------
        name : str
            Name of the function.
        *arguments
            Its arguments, as ctypes takes them.

        Returns
        -------
        object
            The result of a function that returns no status, or else None.

        Raises
        ------
        OpenNI2Error
            The status is not OK.
        """
        result = getattr(self._c, name)(*arguments)
        if name in _OTHER_RESULTS or name in _FLAGS:
            return result
        if result != _OK:
            said = (self._c.oniGetExtendedError() or b"").decode(errors="replace").split()
            raise OpenNI2Error(result, " ".join(said)[:200] or f"{name} failed with status {result}")
        return None

    def start(self) -> None:
        """Load the vendor's drivers once. They stay loaded, and notice what is plugged in or out.

        Unloading them would take half a second, and crashes while one of their threads still runs.
        """
        global _started
        if not _started:
            self.call("oniInitialize", _API_VERSION)
            _started = True

    def devices(self) -> list[tuple[str, str]]:
        """Return (URI, name) of every connected device, without opened recordings, which the library lists, too."""
        infos, count = POINTER(DeviceInfo)(), c_int()
        self.call("oniGetDeviceList", byref(infos), byref(count))
        listed = [infos[i] for i in range(count.value) if infos[i].name != b"oni File"]
        found = [(info.uri.decode(errors="replace"), _title(info)) for info in listed]
        self.call("oniReleaseDeviceList", infos)
        return found

    def open(self, uri: str) -> Device:
        """Open the device of a URI, or the file at a path."""
        handle = c_void_p()
        self.call("oniDeviceOpen", os.fsencode(uri), byref(handle))
        return Device(self, handle)


class Device:
    """An open device or file with the streams that were created on it."""

    def __init__(self, library: OpenNI2Library, handle: c_void_p) -> None:
        self._library, self._handle = library, handle
        self.streams: list[Stream] = []
        self._opened = time.perf_counter()
        info = DeviceInfo()
        library.call("oniDeviceGetInfo", handle, byref(info))
        self.uri, self.title = info.uri.decode(errors="replace"), _title(info)

    @property
    def is_file(self) -> bool:
        """Whether the device plays a recording."""
        return bool(self._library.call("oniDeviceIsPropertySupported", self._handle, PLAYBACK_SPEED))

    def set(self, name: int, value) -> None:
        """Set a property to a ctypes value."""
        self._library.call("oniDeviceSetProperty", self._handle, name, byref(value), ctypes.sizeof(value))

    def registers_depth(self) -> bool:
        """Return whether the device can register depth to colour."""
        supported = "oniDeviceIsImageRegistrationModeSupported"
        return bool(self._library.call(supported, self._handle, DEPTH_TO_COLOUR))

    def synchronise(self) -> None:
        """Take depth and colour at the same moments. Raises :class:`OpenNI2Error` if the device cannot do so."""
        self._library.call("oniDeviceEnableDepthColorSync", self._handle)

    def modes(self, kind: int) -> list[VideoMode]:
        """Return the video modes of the depth or colour sensor. The list is empty if there is no such sensor."""
        info = self._library.call("oniDeviceGetSensorInfo", self._handle, kind)
        return [info[0].modes[i] for i in range(info[0].count)] if info else []

    def stream(self, kind: int) -> Stream:
        """Create a stream of depth or colour."""
        handle = c_void_p()
        self._library.call("oniDeviceCreateStream", self._handle, kind, byref(handle))
        self.streams.append(Stream(self._library, handle))
        return self.streams[-1]

    def wait(self, timeout: float) -> Stream | None:
        """Return the stream that has a new frame, or None after ``timeout`` s."""
        handles = (c_void_p * len(self.streams))(*(stream.handle for stream in self.streams))
        index = c_int(-1)
        try:
            self._library.call("oniWaitForAnyStream", handles, len(handles), byref(index), max(int(timeout * 1000), 1))
        except OpenNI2Error as error:
            if error.status == _TIME_OUT:
                return None
            raise
        return self.streams[index.value]

    def close(self) -> None:
        """Stop and destroy the streams, and close the device."""
        young = self._opened + _SETTLING_SECONDS - time.perf_counter()
        if self.is_file and young > 0:
            time.sleep(young)
        for stream in self.streams:
            self._library.call("oniStreamStop", stream.handle)
            self._library.call("oniStreamDestroy", stream.handle)
        self.streams = []
        self._library.call("oniDeviceClose", self._handle)


class Stream:
    """Depth or colour of a device."""

    def __init__(self, library: OpenNI2Library, handle: c_void_p) -> None:
        self._library, self.handle = library, handle

    def get(self, name: int, kind):
        """Return a property as a ctypes ``kind``. Raises :class:`OpenNI2Error` if the stream does not have it."""
        value = kind()
        self._library.call("oniStreamGetProperty", self.handle, name, byref(value), byref(c_int(ctypes.sizeof(value))))
        return value

    def set(self, name: int, value) -> None:
        """Set a property to a ctypes value."""
        self._library.call("oniStreamSetProperty", self.handle, name, byref(value), ctypes.sizeof(value))

    def supports(self, name: int) -> bool:
        """Return whether the stream has a property."""
        return bool(self._library.call("oniStreamIsPropertySupported", self.handle, name))

    def start(self) -> None:
        """Start the stream."""
        self._library.call("oniStreamStart", self.handle)

    def read(self) -> tuple[np.ndarray, int, float]:
        """Return image, frame number and timestamp (s) of the new frame."""
        frame = POINTER(Frame)()
        self._library.call("oniStreamReadFrame", self.handle, byref(frame))
        try:
            return frame[0].image(), int(frame[0].index), frame[0].timestamp * 1e-6
        finally:
            self._library.call("oniFrameRelease", frame)


def _title(info: DeviceInfo) -> str:
    return " ".join(f"{info.vendor.decode(errors='replace')} {info.name.decode(errors='replace')}".split())


def _load() -> ctypes.CDLL:
    names = _FILES.get(sys.platform, ("libOpenNI2.so.0", "libOpenNI2.so"))
    folders = [os.environ[name] for name in FOLDER_VARIABLES if os.environ.get(name)]
    candidates = [str(Path(folder) / name) for folder in folders for name in names]
    for candidate in candidates or names:  # the loader searches the system's folders for a bare name
        try:
            return ctypes.CDLL(candidate)
        except OSError:
            continue
    where = f"{' and '.join(folders)} (OPENNI2_REDIST) holds no {names[0]}" if folders else _install_line()
    raise DriverMissingError(f"OpenNI2 needs its library: {where}")


def _install_line() -> str:
    platform = "linux" if sys.platform not in _INSTALL else sys.platform
    return f"{_INSTALL[platform]}; elsewhere set OPENNI2_REDIST to the folder that holds it"
