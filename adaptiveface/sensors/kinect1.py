"""Kinect v1 (Xbox 360, Kinect for Windows) through libfreenect, with ctypes: its Python binding has no wheels.

The library registers depth to colour, in whole millimetres. The sensor measures an 11-bit disparity, whose steps are 1.4 mm
apart at 700 mm and 2.9 mm at 1 m. A library that cannot register (fakenect) delivers the disparity of the depth camera, which
is converted here. Its pictures are then left out, because they are not aligned to that depth.
"""

from __future__ import annotations

import ctypes
import os
import sys
import time
from ctypes import POINTER, byref, c_int, c_int8, c_int16, c_int32, c_long, c_uint32, c_void_p
from typing import Any

import numpy as np

from ..errors import DriverMissingError, ParameterError, SensorDisconnectedError, SensorError, SensorNotFoundError
from ..geometry.camera import Camera
from .driver import Driver, RawFrame
from .pairing import Pairing

WIDTH, HEIGHT, FPS = 640, 480, 30
#: Environment variable with the path of the library, if it is not in a folder of the system.
LIBRARY_VARIABLE = "FREENECT_LIBRARY"
#: Ticks of the camera's clock per second; the counter has 32 bits.
TICKS = 60e6
#: A picture that is more frames away from its depth does not show the same moment.
MAX_SKEW_FRAMES = 0.6
#: A camera that delivers nothing for this long counts as unplugged, s.
PATIENCE = 3.0
_NAMES = {"win32": ("freenect.dll",), "darwin": ("libfreenect.dylib", "libfreenect.0.dylib")}
_CAMERA_ONLY, _MEDIUM, _RGB, _DEPTH_11_BIT, _REGISTERED = 2, 1, 0, 0, 4


class _Mode(ctypes.Structure):
    _fields_ = [
        ("reserved", c_uint32),
        ("resolution", c_int),
        ("format", c_int32),
        ("bytes", c_int32),
        ("width", c_int16),
        ("height", c_int16),
        ("bits", c_int8),
        ("padding", c_int8),
        ("fps", c_int8),
        ("valid", c_int8),
    ]


class _Interval(ctypes.Structure):
    _fields_ = [("seconds", c_long), ("microseconds", c_long)]


_Callback = ctypes.CFUNCTYPE(None, c_void_p, c_void_p, c_uint32)
_SIGNATURES = {
    "init": [POINTER(c_void_p), c_void_p],
    "shutdown": [c_void_p],
    "num_devices": [c_void_p],
    "set_log_level": [c_void_p, c_int],
    "select_subdevices": [c_void_p, c_int],
    "open_device": [c_void_p, POINTER(c_void_p), c_int],
    "close_device": [c_void_p],
    "get_depth_mode_count": [],
    "get_depth_mode": [c_int],
    "find_video_mode": [c_int, c_int],
    "set_depth_mode": [c_void_p, _Mode],
    "set_video_mode": [c_void_p, _Mode],
    "set_depth_callback": [c_void_p, _Callback],
    "set_video_callback": [c_void_p, _Callback],
    "start_depth": [c_void_p],
    "start_video": [c_void_p],
    "stop_depth": [c_void_p],
    "stop_video": [c_void_p],
    "process_events_timeout": [c_void_p, POINTER(_Interval)],
}


class _Library:
    """The loaded libfreenect. Raises :class:`DriverMissingError`."""

    def __init__(self) -> None:
        self._c = _load()
        for name, arguments in _SIGNATURES.items():
            function = getattr(self._c, f"freenect_{name}")
            function.argtypes, function.restype = arguments, _Mode if name.endswith("_mode") and "set" not in name else c_int

    def call(self, name: str, *arguments: Any) -> Any:
        """Call the function ``freenect_name``, and return what it returns: a status, a number or a mode."""
        return getattr(self._c, f"freenect_{name}")(*arguments)

    def context(self) -> c_void_p:
        """Return a new context that opens cameras only. Raises :class:`SensorError`."""
        context = c_void_p()
        if self.call("init", byref(context), None) < 0:
            raise SensorError("Kinect v1: no access to the USB bus")
        self.call("set_log_level", context, 0)
        self.call("select_subdevices", context, _CAMERA_ONLY)
        return context


def _load() -> ctypes.CDLL:
    chosen = os.environ.get(LIBRARY_VARIABLE)
    names = (chosen,) if chosen else _NAMES.get(sys.platform, ("libfreenect.so.0.5", "libfreenect.so.0", "libfreenect.so"))
    for name in names:
        try:
            return ctypes.CDLL(name)
        except OSError:
            continue
    if chosen:
        raise DriverMissingError(f"Kinect v1 needs libfreenect: {chosen} ({LIBRARY_VARIABLE}) cannot be loaded")
    lines = {"darwin": "brew install libfreenect", "win32": "build it from https://github.com/OpenKinect/libfreenect"}
    line = lines.get(sys.platform, "on Debian or Ubuntu: apt install libfreenect0.5")
    raise DriverMissingError(f"Kinect v1 needs libfreenect: {line}; elsewhere set {LIBRARY_VARIABLE} to its path")


def connected_kinects() -> list[tuple[str, str]]:
    """List the connected Kinects.

    Returns
    -------
    list of tuple of str
        Number and name of every Kinect v1.

    Raises
    ------
    DriverMissingError
        The library is not installed.
    RuntimeError
        There is no access to USB.
    """
    library = _Library()
    try:
        context = library.context()
    except SensorError as error:
        raise RuntimeError(str(error)) from None
    try:
        return [(str(number), "Kinect v1") for number in range(max(library.call("num_devices", context), 0))]
    finally:
        library.call("shutdown", context)


class Kinect1Driver(Driver):
    """A Kinect v1.

    Parameters
    ----------
    index : str
        Number of the Kinect, or "" for the first one.

    Attributes
    ----------
    colour_camera : Camera
        The calibration of depth that is registered to colour. It is nominal, because the device reports none.
    depth_camera : Camera
        The nominal calibration of the depth camera, whose disparity is used if the library cannot register.
    """

    live, has_features, fps, depth_scale = True, False, float(FPS), 1000.0
    colour_camera = Camera(WIDTH, HEIGHT, 525.0, 525.0, 319.5, 239.5)
    depth_camera = Camera(WIDTH, HEIGHT, 580.0, 580.0, 319.5, 239.5)
    withholds_unaligned = True  #: leave out pictures that are not aligned to the depth
    description = "Kinect v1 (Xbox 360)"

    def __init__(self, index: str = "") -> None:
        if index and not (index.isascii() and index.isdecimal() and len(index) < 4):
            raise ParameterError(f"kinect1:{index}: the number of a Kinect is expected, 0 for the first")
        self._library = _Library()
        self.index, self.name = int(index or 0), f"Kinect v1 {index}".strip()
        self._context: c_void_p | None = None
        self._device: c_void_p | None = None

    @classmethod
    def connected(cls) -> list[tuple[str, str]]:
        """See :func:`connected_kinects`."""
        return connected_kinects()

    def open(self) -> None:
        """Start depth and colour. Raises :class:`SensorNotFoundError` or :class:`SensorError`."""
        library = self._library
        self._context = context = library.context()
        found = library.call("num_devices", context)
        if found <= self.index:
            raise SensorNotFoundError(
                f"{self.name}: no such Kinect is connected (found: {max(found, 0)}); it needs its power supply besides USB"
            )
        device = c_void_p()
        if library.call("open_device", context, byref(device), self.index) < 0:
            raise SensorError(f"{self.name}: cannot be opened; is another program using it, or are its udev rules missing?")
        self._device = device
        self._waiting = Pairing(MAX_SKEW_FRAMES / FPS)
        self._clock: dict[str, int] = {}
        self._sequence = -1
        self._last_time: float | None = None
        self._start(device)
        self._last_frame = time.perf_counter()

    def _start(self, device: c_void_p) -> None:
        library = self._library
        modes = [library.call("get_depth_mode", number) for number in range(library.call("get_depth_mode_count"))]
        formats = {mode.format: mode for mode in modes if mode.valid and mode.resolution == _MEDIUM}
        self.registered = _REGISTERED in formats
        depth_mode = formats.get(_REGISTERED, formats.get(_DEPTH_11_BIT))
        # the library keeps bare pointers, so the callbacks must live as long as the driver
        self._callbacks = _Callback(self._on_depth), _Callback(self._on_video)
        library.call("set_depth_callback", device, self._callbacks[0])
        library.call("set_video_callback", device, self._callbacks[1])
        steps = (
            depth_mode is not None and library.call("set_depth_mode", device, depth_mode) >= 0,
            library.call("set_video_mode", device, library.call("find_video_mode", _MEDIUM, _RGB)) >= 0,
            library.call("start_depth", device) >= 0,
            library.call("start_video", device) >= 0,
        )
        if not all(steps):
            raise SensorError(f"{self.name}: cannot start depth and colour; plug it in again, into another USB port")

    def grab(self, timeout: float) -> RawFrame | None:
        """Return the next pair of depth and colour."""
        context, deadline = self._opened(self._context), time.perf_counter() + timeout
        while True:
            left = max(deadline - time.perf_counter(), 0.001)
            if self._library.call("process_events_timeout", context, byref(_Interval(0, int(left * 1e6)))) < 0:
                raise self._unplugged()
            frame = self._pair()
            if frame is not None:
                self._last_frame = time.perf_counter()
                return frame
            if time.perf_counter() - self._last_frame > PATIENCE:
                raise SensorDisconnectedError(f"{self.name}: sends no frames; check its power supply and its cable")
            if time.perf_counter() >= deadline:
                return None

    def close(self) -> None:
        """Stop both streams and release the device."""
        device, self._device, context, self._context = self._device, None, self._context, None
        if device is not None:
            self._library.call("stop_depth", device)
            self._library.call("stop_video", device)
            self._library.call("close_device", device)
        if context is not None:
            self._library.call("shutdown", context)

    # ---- called by the library, within process_events_timeout ------------------------------------------------------
    def _on_depth(self, _device, address, ticks) -> None:
        units = np.ctypeslib.as_array((ctypes.c_uint16 * (WIDTH * HEIGHT)).from_address(address))
        self._waiting.depth.append((units.reshape(HEIGHT, WIDTH).copy(), self._seconds("depth", ticks)))

    def _on_video(self, _device, address, ticks) -> None:
        pixels = np.ctypeslib.as_array((ctypes.c_uint8 * (WIDTH * HEIGHT * 3)).from_address(address))
        self._waiting.colour.append((pixels.reshape(HEIGHT, WIDTH, 3).copy(), self._seconds("colour", ticks)))

    def _seconds(self, stream: str, ticks: int) -> float:
        """Return the clock's time without its overflow every 72 s. Depth and colour share the clock."""
        before = self._clock.get(stream, self._clock.get("colour" if stream == "depth" else "depth", ticks))
        self._clock[stream] = before + (ticks - before + 2**31) % 2**32 - 2**31
        return self._clock[stream] / TICKS

    def _pair(self) -> RawFrame | None:
        """Return a frame if depth and colour of the same moment have arrived, or else None."""
        found = self._waiting.take()
        if found is None:
            return None
        (units, moment), (picture, _) = found
        passed = 1 if self._last_time is None else round((moment - self._last_time) * FPS)
        self._sequence, self._last_time = self._sequence + max(passed, 1), moment
        if self.registered:
            return RawFrame(units, self.colour_camera, picture, self._sequence, moment)
        aligned = None if self.withholds_unaligned else picture
        return RawFrame(millimetres(units), self.depth_camera, aligned, self._sequence, moment)


def millimetres(disparity: np.ndarray) -> np.ndarray:
    """Convert the sensor's disparity to depth by OpenKinect's formula (Magnenat's fit).

    Parameters
    ----------
    disparity : (H, W)
        The 11-bit disparity.

    Returns
    -------
    (H, W) float32
        Depth in mm. A pixel of 0 has no measurement.
    """
    table = 123.6 * np.tan(np.arange(2048) / 2842.5 + 1.1863)
    table[(table <= 0) | (table > 10_000)] = 0  # past the pole of the tangent there is no depth
    table[2047] = 0
    return table.astype(np.float32)[np.minimum(disparity, 2047)]
