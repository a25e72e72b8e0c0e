"""Intel RealSense through pyrealsense2: connected cameras, and playback of ``.db3`` and ``.bag`` recordings.

The SDK aligns colour to depth. The aligned picture is black where depth has no measurement.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import (
    DriverMissingError,
    EndOfRecording,
    FileFormatError,
    ParameterError,
    SensorError,
    SensorNotFoundError,
)
from ..geometry.camera import Camera
from .driver import CameraOrFile, Driver, RawFrame

#: Size and rate that every D400 camera has for both streams.
WIDTH, HEIGHT, FPS = 640, 480, 30
#: A picture that was taken longer before or after its depth does not show the same moment, ms.
MAX_SKEW_MS = 50.0
#: After this long without a frame, playback is over even if its status says otherwise, s.
PLAYBACK_PATIENCE = 10.0


def realsense_module():
    """Return the vendor's library. Raises :class:`DriverMissingError`."""
    try:
        import pyrealsense2
    except ImportError:
        raise DriverMissingError('RealSense needs pyrealsense2: pip install "adaptiveface[realsense]"') from None
    return pyrealsense2


def connected_cameras() -> list[tuple[str, str]]:
    """Return (serial number, name) of every connected camera."""
    rs = realsense_module()
    fields = rs.camera_info.serial_number, rs.camera_info.name
    return [tuple(device.get_info(field) for field in fields) for device in rs.context().query_devices()]


class RealSenseDriver(CameraOrFile):
    """A RealSense camera, or a recording that plays as fast as it is read.

    Parameters
    ----------
    serial : str
        Serial number of the camera, or "" for the first one.
    path : Path, optional
        A recording (.db3 or .bag) to play instead.
    device : object, optional
        A device of the SDK to use instead, such as a software device.
    """

    has_features, fps, depth_scale = False, float(FPS), 1000.0
    description = "Intel RealSense"

    def __init__(self, serial: str = "", path: Path | None = None, device=None) -> None:
        super().__init__(f"RealSense {serial}", path)
        self._rs = realsense_module()
        self.serial, self._injected = serial, device
        self._pipeline: Any | None = None

    @classmethod
    def named(cls, argument: str) -> Callable[[], Driver]:
        """Return a function that makes the driver of the camera with the serial number ``argument``, or of the first one."""
        if len(argument) > 32:
            raise ParameterError(f"realsense:{argument[:32]}...: a serial number is shorter")
        return lambda: cls(argument)

    @classmethod
    def connected(cls) -> list[tuple[str, str]]:
        """See :func:`connected_cameras`."""
        return connected_cameras()

    def open(self) -> None:
        """Start both streams. Raises :class:`SensorNotFoundError`, :class:`FileFormatError` or :class:`SensorError`."""
        rs = self._rs
        if self.live and self._injected is None:
            self._find()  # the SDK would wait 15 s for a camera
        pipeline, config = rs.pipeline(), rs.config()
        try:
            self._start(pipeline, config)
        except RuntimeError as error:
            if not self.live:
                raise FileFormatError(f"{self.path}: not a RealSense recording with depth ({error})") from None
            raise SensorError(f"{self.name}: cannot start depth and colour ({error}); use a USB 3 port") from None
        self._align = rs.align(rs.stream.depth)
        self._waited = 0.0

    def _start(self, pipeline, config) -> None:
        rs = self._rs
        if self.live:
            if self._injected is not None:
                pipeline.set_device(self._injected)
            elif self.serial:
                config.enable_device(self.serial)
            config.enable_stream(rs.stream.depth, WIDTH, HEIGHT, rs.format.z16, FPS)
            config.enable_stream(rs.stream.color, WIDTH, HEIGHT, rs.format.rgb8, FPS)
        else:
            config.enable_device_from_file(str(self.path), repeat_playback=False)
            playback = config.resolve(rs.pipeline_wrapper(pipeline)).get_device().as_playback()
            playback.set_real_time(False)  # before the start: no frame is lost
            playback.pause()  # reading begins with the first stream, and a later stream would miss what was read before
        profile = pipeline.start(config)
        if not self.live:
            playback.resume()
        self._pipeline, self._device = pipeline, profile.get_device()
        stream = profile.get_stream(rs.stream.depth).as_video_stream_profile()
        self.fps = float(stream.fps())
        self.camera = self._camera(stream.get_intrinsics())
        unit = self._device.first_depth_sensor().get_depth_scale()
        self.depth_scale = round(1.0 / unit, 2)  # the SDK's unit is a float32, which is not exactly 0.0001

    def grab(self, timeout: float) -> RawFrame | None:
        """Return the next pair of depth and colour, or None if one of them is missing or shows another moment."""
        arrived, frames = self._opened(self._pipeline).try_wait_for_frames(max(int(timeout * 1000), 1))
        if not arrived:
            self._waited += timeout
            self._check_end()
            return None
        self._waited = 0.0
        depth, colour = frames.get_depth_frame(), frames.get_color_frame()
        if not depth or (colour and _skewed(depth, colour)):
            return None
        if colour:
            aligned = self._align.process(frames)
            depth, colour = aligned.get_depth_frame(), aligned.get_color_frame()
        per_metre = round(1.0 / depth.get_units(), 2)
        millimetres = np.asanyarray(depth.get_data()) * np.float32(1000.0 / per_metre)
        picture = self._rgb(colour) if colour else None
        return RawFrame(millimetres, self.camera, picture, depth.get_frame_number(), depth.get_timestamp() / 1000.0)

    def close(self) -> None:
        """Stop the streams."""
        pipeline, self._pipeline, self._device = self._pipeline, None, None
        if pipeline is not None:
            pipeline.stop()

    def _find(self) -> None:
        serials = [serial for serial, _ in connected_cameras()]
        if not serials:
            raise SensorNotFoundError(f"{self.name}: no RealSense camera is connected; check the cable and the port")
        if self.serial and self.serial not in serials:
            raise SensorNotFoundError(f"{self.name}: not connected; connected are {', '.join(serials)}")

    def _check_end(self) -> None:
        if self.live:
            if not self._device.is_connected():
                raise self._unplugged()
            return
        stopped = self._device.as_playback().current_status() == self._rs.playback_status.stopped
        if stopped or self._waited > PLAYBACK_PATIENCE:
            raise EndOfRecording(f"{self.path}: the end of the recording")

    def _camera(self, intrinsics) -> Camera:
        if any(intrinsics.coeffs):
            raise SensorError(f"{self.name}: depth with lens distortion {list(intrinsics.coeffs)} is not supported")
        i = intrinsics
        return Camera(i.width, i.height, i.fx, i.fy, i.ppx, i.ppy)

    def _rgb(self, colour) -> np.ndarray:
        pixels, layout = np.asanyarray(colour.get_data()), colour.profile.format()
        formats = self._rs.format
        if layout in (formats.rgb8, formats.rgba8):
            return pixels[..., :3]
        if layout in (formats.bgr8, formats.bgra8):
            return pixels[..., 2::-1]
        raise SensorError(f"{self.name}: colour format {layout.name} is not supported; record rgb8 or bgr8")


def _skewed(depth, colour) -> bool:
    """Return whether the picture shows another moment. The SDK repeats the last picture while the colour stream stalls."""
    same_clock = depth.frame_timestamp_domain == colour.frame_timestamp_domain
    return same_clock and abs(depth.get_timestamp() - colour.get_timestamp()) > MAX_SKEW_MS
