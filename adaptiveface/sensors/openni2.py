"""PrimeSense Carmine, Asus Xtion and other OpenNI2 cameras, and ``.oni`` recordings, through the vendor's library.

The camera registers depth to colour. A recording does not say whether its depth was registered, so registration has to be on
while recording. The calibration follows from the field of view that the driver reports, without distortion.
"""

from __future__ import annotations

import ctypes
import math
import time
from pathlib import Path

import numpy as np

from ..errors import (
    EndOfRecording,
    FileFormatError,
    ParameterError,
    SensorError,
    SensorNotFoundError,
)
from ..geometry.camera import Camera
from . import openni2_library as oni
from .driver import CameraOrFile, RawFrame
from .openni2_library import Device, OpenNI2Error, OpenNI2Library, Stream, VideoMode, by_the_owner
from .pairing import Pairing

#: Preferred size and rate.
WIDTH, HEIGHT, FPS = 640, 480, 30
#: A picture that is more frames away from its depth does not show the same moment.
MAX_SKEW_FRAMES = 0.6
#: After this long without a frame, playback has ended, s.
PLAYBACK_PATIENCE = 10.0
#: After this long without a frame, check whether the camera is still connected, s.
LIVE_PATIENCE = 1.0
#: At this speed, the library's driver for files plays each frame when it is asked for.
_FRAME_BY_FRAME = -1.0


@by_the_owner
def connected_cameras() -> list[tuple[str, str]]:
    """Return (URI, name) of every connected camera. Raises :class:`DriverMissingError`."""
    library = OpenNI2Library()
    library.start()
    return library.devices()


class OpenNI2Driver(CameraOrFile):
    """An OpenNI2 camera, or a recording that plays as fast as it is read.

    A damaged recording can crash the process. Therefore, :class:`~adaptiveface.sensors.file_player.FilePlayer` plays recordings
    in another process.

    Parameters
    ----------
    which : str
        URI or number of the camera, or "" for the first one.
    path : Path, optional
        A recording (.oni) to play instead.
    """

    has_features = False
    description = "PrimeSense Carmine, Asus Xtion and other OpenNI2 cameras"

    def __init__(self, which: str = "", path: Path | None = None) -> None:
        if len(which) > 255:
            raise ParameterError(f"openni2:{which[:32]}...: a URI is shorter")
        super().__init__(f"OpenNI2 {which}", path)
        self._library = OpenNI2Library()
        self.which, self.fps, self.depth_scale = which, float(FPS), 1000.0
        self._device: Device | None = None

    @classmethod
    def connected(cls) -> list[tuple[str, str]]:
        """See :func:`connected_cameras`."""
        return connected_cameras()

    @by_the_owner
    def open(self) -> None:
        """Start streaming. Raises :class:`SensorNotFoundError`, :class:`FileFormatError` or :class:`SensorError`."""
        try:
            self._library.start()
            self._device = device = self._open_device() if self.path is None else self._open_file(self.path)
            self._prepare(device)
            for stream in device.streams:
                stream.start()
        except OpenNI2Error as error:
            if not self.live:
                raise FileFormatError(f"{self.path}: not a complete OpenNI2 recording with depth ({error})") from None
            raise SensorError(f"{self.name}: cannot start depth and colour ({error}); plug it in again") from None
        self._silence, self._read = 0.0, 0
        self._last_index: dict[Stream, int] = {}
        self._waiting = Pairing(MAX_SKEW_FRAMES / self.fps)

    @by_the_owner
    def grab(self, timeout: float) -> RawFrame | None:
        """Return the next pair of depth and colour, or only depth if the device has no colour."""
        device, deadline = self._opened(self._device), time.perf_counter() + timeout
        while True:
            self._check_end()
            patience = max(deadline - time.perf_counter(), 0.001)
            stream = device.wait(patience)
            if stream is None:
                self._silence += patience  # not measured by the clock, because this process may have been suspended
                self._check_silence(device)
            else:
                waiting = self._waiting.depth if stream is self._depth else self._waiting.colour
                waiting.append(self._take(stream))
                frame = self._pair()
                if frame is not None:
                    return frame
            if time.perf_counter() >= deadline:
                return None

    @by_the_owner
    def close(self) -> None:
        """Stop the streams and close the device."""
        device, self._device = self._device, None
        if device is not None:
            device.close()

    # ---- opening ---------------------------------------------------------------------------------------------------
    def _open_device(self) -> Device:
        devices = self._library.devices()
        uri = self.which
        if uri.isdecimal() or not uri:
            number = int(uri or 0)
            if number >= len(devices):
                raise self._not_found(devices)
            uri = devices[number][0]
        elif Path(uri).exists():  # the library would open it, too
            raise ParameterError(f"openni2:{uri}: is a recording; give its path alone")
        try:
            return self._library.open(uri)
        except OpenNI2Error as error:
            if uri in [known for known, _ in devices]:
                raise SensorError(f"{self.name}: cannot be opened ({error}); is another program using it?") from None
            raise self._not_found(devices) from None

    def _not_found(self, devices: list[tuple[str, str]]) -> SensorNotFoundError:
        found = ", ".join(uri for uri, _ in devices) or "none"
        return SensorNotFoundError(f"{self.name}: no such OpenNI2 camera is connected (found: {found})")

    def _open_file(self, path: Path) -> Device:
        device = self._library.open(str(path.absolute()))
        device.set(oni.PLAYBACK_REPEAT, ctypes.c_int(1))  # without it, the library sometimes crashes at the end
        device.set(oni.PLAYBACK_SPEED, ctypes.c_float(_FRAME_BY_FRAME))
        return device

    def _prepare(self, device: Device) -> None:
        """Create the streams, register depth to colour, and note size, rate, scale and calibration."""
        depth_modes, colour_modes = device.modes(oni.DEPTH), device.modes(oni.COLOUR)
        if not depth_modes:
            raise OpenNI2Error(0, "it has no depth")
        self._depth = device.stream(oni.DEPTH)
        self._colour = device.stream(oni.COLOUR) if colour_modes else None
        if self.live:
            self._configure(device, depth_modes, colour_modes)
        modes = [stream.get(oni.VIDEO_MODE, oni.VideoMode) for stream in device.streams]
        self._check_modes(modes)
        self.fps = float(modes[0].fps or FPS)
        self.depth_scale = 10_000.0 if modes[0].format == oni.DEPTH_100_UM else 1000.0
        self.camera = self._calibration(modes[0])
        self._mirrored = [self._is_mirrored(stream) for stream in (self._depth, self._colour) if stream]
        self._count = 0 if self.live else self._depth.get(oni.NUMBER_OF_FRAMES, ctypes.c_int).value

    def _configure(self, device: Device, depth_modes: list[VideoMode], colour_modes: list[VideoMode]) -> None:
        for stream, mode in zip(device.streams, best_modes(depth_modes, colour_modes), strict=False):
            if stream.get(oni.VIDEO_MODE, oni.VideoMode) != mode:
                stream.set(oni.VIDEO_MODE, mode)
            if stream.supports(oni.MIRRORING):
                stream.set(oni.MIRRORING, ctypes.c_int(0))
        if self._colour is not None:
            self._register(device)

    def _register(self, device: Device) -> None:
        if not device.registers_depth():
            raise SensorError(f"{self.name}: {device.title} cannot register its depth to its colour; not supported")
        device.set(oni.IMAGE_REGISTRATION, ctypes.c_int(oni.DEPTH_TO_COLOUR))
        try:
            device.synchronise()
        except OpenNI2Error:
            pass  # then pictures are up to half a frame away from their depth

    def _check_modes(self, modes: list[VideoMode]) -> None:
        where = self.path or self.name
        formats = {oni.DEPTH: (oni.DEPTH_1_MM, oni.DEPTH_100_UM), oni.COLOUR: (oni.RGB888,)}
        for mode, (kind, allowed) in zip(modes, formats.items(), strict=False):
            if mode.format not in allowed:
                what = "depth" if kind == oni.DEPTH else "colour"
                raise FileFormatError(
                    f"{where}: {what} in the pixel format {mode.format} is not supported; "
                    "record depth in 1 mm or 0.1 mm and colour as RGB888"
                )
        if len({(mode.width, mode.height) for mode in modes}) > 1:
            sizes = " and ".join(f"{mode.width} x {mode.height}" for mode in modes)
            raise FileFormatError(f"{where}: depth and colour of {sizes} pixels; record both in the same size")

    def _calibration(self, mode: VideoMode) -> Camera:
        """Return the calibration of the camera to which depth is registered: the colour camera, or else the depth camera."""
        stream = self._colour if self.live and self._colour is not None else self._depth
        kinds = oni.FOV_HORIZONTAL, oni.FOV_VERTICAL
        return camera_from_fov(mode.width, mode.height, *(stream.get(kind, ctypes.c_float).value for kind in kinds))

    @staticmethod
    def _is_mirrored(stream: Stream) -> bool:
        try:
            return bool(stream.get(oni.MIRRORING, ctypes.c_int).value)
        except OpenNI2Error:
            return False

    # ---- frames ----------------------------------------------------------------------------------------------------
    def _take(self, stream: Stream) -> tuple[np.ndarray, int, float]:
        image, index, timestamp = stream.read()
        self._silence = 0.0
        wrapped, self._last_index[stream] = index <= self._last_index.get(stream, -1), index
        self._read += stream is self._depth
        if not self.live and wrapped:  # it plays from the start again
            if not self._read:
                self._no_depth()
            self._end()
        if self._mirrored[stream is not self._depth]:
            image = image[:, ::-1]
        return image, index, timestamp

    def _pair(self) -> RawFrame | None:
        """Return a frame if depth and colour of the same moment have arrived, or else None.

        A device without colour needs only depth.
        """
        if self._colour is not None:
            pair = self._waiting.take()
            if pair is None:
                return None
            (image, index, timestamp), (picture, *_) = pair
        elif self._waiting.depth:
            (image, index, timestamp), picture = self._waiting.depth.popleft(), None
        else:
            return None
        millimetres = image * np.float32(1000.0 / self.depth_scale)
        return RawFrame(millimetres, self.camera, picture, index, timestamp)

    def _check_end(self) -> None:
        """End the recording when the last depth frame was read and has found its picture."""
        if not self.live and 0 < self._count <= self._read and not self._waiting.depth:
            self._end()

    def _check_silence(self, device: Device) -> None:
        if self.live:
            if self._silence > LIVE_PATIENCE and device.uri not in [uri for uri, _ in self._library.devices()]:
                raise self._unplugged()
        elif self._silence > PLAYBACK_PATIENCE:
            if self._read:
                raise FileFormatError(f"{self.path}: broken after {self._read} of {self._count} depth frames")
            self._no_depth()

    def _no_depth(self) -> None:
        raise FileFormatError(f"{self.path}: plays no depth; it is broken or lacks the properties of its streams")

    def _end(self) -> None:
        raise EndOfRecording(f"{self.path}: the end of the recording")


def best_modes(depth_modes: list[VideoMode], colour_modes: list[VideoMode]) -> list[VideoMode]:
    """Choose the video modes.

    Parameters
    ----------
    depth_modes, colour_modes : list of VideoMode
        The modes of the device. A device without colour has no colour modes.

    Returns
    -------
    list of VideoMode
        The depth mode that is closest to 640 x 480 pixels at 30 Hz, with steps of 0.1 mm rather than 1 mm. The colour mode of
        the same size and rate follows if the device has colour.

    Raises
    ------
    OpenNI2Error
        No depth mode has a colour mode of its size and rate.
    """
    colours = {(m.width, m.height, m.fps): m for m in colour_modes if m.format == oni.RGB888}
    depths = [m for m in depth_modes if m.format in (oni.DEPTH_1_MM, oni.DEPTH_100_UM)]
    depths = [m for m in depths if not colour_modes or (m.width, m.height, m.fps) in colours]
    if not depths:
        raise OpenNI2Error(0, "no video mode in mm with a picture of the same size and rate")
    best = min(depths, key=lambda m: (abs(m.width - WIDTH) + abs(m.height - HEIGHT), abs(m.fps - FPS), -m.format))
    return [best, *([colours[best.width, best.height, best.fps]] if colour_modes else [])]


def camera_from_fov(width: int, height: int, horizontal: float, vertical: float) -> Camera:
    """Return the pinhole camera of a field of view.

    Parameters
    ----------
    width, height : int
        Size of the image, px.
    horizontal, vertical : float
        Angles from border to border of the image, rad.

    Returns
    -------
    Camera
        The calibration. Its principal point is the middle of the image.
    """
    if not (0 < horizontal < math.pi and 0 < vertical < math.pi):
        raise OpenNI2Error(0, f"a field of view of {horizontal:g} x {vertical:g} rad")
    fx, fy = width / 2 / math.tan(horizontal / 2), height / 2 / math.tan(vertical / 2)
    return Camera(width, height, fx, fy, (width - 1) / 2, (height - 1) / 2)
