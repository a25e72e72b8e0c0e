"""Orbbec cameras (Femto, Gemini, Astra 2, ...) through the vendor's pyorbbecsdk, version 2. Not tested with a camera.

Depth and picture are read unregistered. :mod:`adaptiveface.sensors.registration` registers them with the calibration of the
two streams.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np

from ..errors import DriverMissingError, SensorError, SensorNotFoundError
from .capture_device import decoded_jpeg
from .driver import Driver, RawFrame
from .registration import Lens, Registration

#: A camera was unplugged if its stream delivers nothing for so many polls and it is no longer listed.
SILENT_POLLS = 10
_NO_DISTORTION = np.zeros(8)


def orbbec_module():
    """Return the vendor's library with its log turned off. Raises :class:`DriverMissingError`."""
    try:
        import pyorbbecsdk

        pyorbbecsdk.AlignFilter  # noqa: B018 - version 1 has none
    except (ImportError, AttributeError):
        line = 'pip install "adaptiveface[orbbec]"'
        raise DriverMissingError(f"Orbbec needs pyorbbecsdk2: {line} (Python 3.12 or newer with NumPy 2)") from None
    silent = pyorbbecsdk.OBLogLevel.NONE
    pyorbbecsdk.Context.set_logger_to_console(silent)
    pyorbbecsdk.Context.set_logger_to_file(silent, "")  # otherwise it creates a folder in the working directory
    return pyorbbecsdk


def connected_cameras() -> list[tuple[str, str]]:
    """Return (serial number, name) of every connected camera."""
    devices = orbbec_module().Context().query_devices()
    numbers = range(devices.get_count())
    return [(devices.get_device_serial_number_by_index(n), devices.get_device_name_by_index(n)) for n in numbers]


class OrbbecDriver(Driver):
    """The camera with a serial number, or the first one."""

    live, has_features, fps, depth_scale = True, False, 30.0, 1000.0
    description = "Orbbec"

    def __init__(self, serial: str = "") -> None:
        self._ob = orbbec_module()
        self.serial, self.name = serial, f"Orbbec {serial}".strip()
        self._pipeline: Any | None = None
        self._silent = 0

    @classmethod
    def connected(cls) -> list[tuple[str, str]]:
        """See :func:`connected_cameras`."""
        return connected_cameras()

    def open(self) -> None:
        """Start depth and colour. Raises :class:`SensorNotFoundError` or :class:`SensorError`."""
        ob = self._ob
        found = [serial for serial, _ in connected_cameras()]
        if not self._is_among(found):
            connected = ", ".join(found) or "none"
            raise SensorNotFoundError(f"{self.name}: no such camera (connected: {connected}); check the cable")
        self._context = ob.Context()
        try:
            device = self._context.query_devices().get_device_by_serial_number(self.serial or found[0])
            pipeline, config = ob.Pipeline(device), ob.Config()
            depth, colour = self._profiles(pipeline)
            config.enable_stream(depth)
            config.enable_stream(colour)
            config.set_frame_aggregate_output_mode(ob.OBFrameAggregateOutputMode.FULL_FRAME_REQUIRE)
            pipeline.enable_frame_sync()
            self._registration = self._calibrate(depth, colour)
            pipeline.start(config)
        except (ob.OBError, RuntimeError) as error:
            raise SensorError(f"{self.name}: cannot start depth and colour ({error}); use a USB 3 port") from None
        self._pipeline, self.fps = pipeline, float(depth.get_fps())

    def _profiles(self, pipeline):
        """Return the default depth stream, and the colour stream that is 640 pixels wide, or else the default one."""
        ob = self._ob
        depth = pipeline.get_stream_profile_list(ob.OBSensorType.DEPTH_SENSOR).get_default_video_stream_profile()
        colours = pipeline.get_stream_profile_list(ob.OBSensorType.COLOR_SENSOR)
        try:
            return depth, colours.get_video_stream_profile(640, 0, ob.OBFormat.RGB, depth.get_fps())
        except ob.OBError:
            return depth, colours.get_default_video_stream_profile()

    def _calibrate(self, depth, colour) -> Registration:
        between = depth.get_extrinsic_to(colour)
        return Registration(self._lens(depth), self._lens(colour), np.array(between.rot), np.array(between.transform))

    def _lens(self, profile) -> Lens:
        k, d, models = profile.get_intrinsic(), profile.get_distortion(), self._ob.OBCameraDistortionModel
        values = np.array([d.k1, d.k2, d.p1, d.p2, d.k3, d.k4, d.k5, d.k6], float)
        if d.model == models.NONE:
            values = _NO_DISTORTION
        elif values.any() and d.model not in (models.BROWN_CONRADY, models.BROWN_CONRADY_K6):
            raise SensorError(f"{self.name}: lens distortion of the kind {d.model.name} is not supported")
        matrix = np.array([[k.fx, 0, k.cx], [0, k.fy, k.cy], [0, 0, 1]], float)
        return Lens(profile.get_width(), profile.get_height(), matrix, values)

    def grab(self, timeout: float) -> RawFrame | None:
        """Return the next pair of depth and colour, or None if there is no depth."""
        frames = self._opened(self._pipeline).wait_for_frames(max(int(timeout * 1000), 1))
        depth = frames.get_depth_frame() if frames is not None else None
        if depth is None:
            self._check_connection()
            return None
        self._silent = 0
        colour = frames.get_color_frame()
        units = np.frombuffer(depth.get_data(), np.uint16).reshape(depth.get_height(), depth.get_width())
        unit = float(depth.get_depth_scale())  # millimetres
        self.depth_scale = round(1000.0 / unit, 2)
        millimetres = self._registration.depth(units * np.float32(unit))
        picture = self._rgb(colour) if colour is not None else None
        if picture is not None:
            picture = self._registration.colour(picture, millimetres)
        camera = self._registration.camera
        return RawFrame(millimetres, camera, picture, depth.get_index(), depth.get_timestamp_us() / 1e6)

    def _check_connection(self) -> None:
        self._silent += 1
        if self._silent % SILENT_POLLS == 0 and not self._is_among([serial for serial, _ in connected_cameras()]):
            raise self._unplugged()

    def _is_among(self, serials: list[str]) -> bool:
        return bool(serials) and self.serial in ("", *serials)

    def _rgb(self, frame) -> np.ndarray | None:
        formats, layout = self._ob.OBFormat, frame.get_format()
        content = np.frombuffer(frame.get_data(), np.uint8)
        if layout == formats.MJPG:
            return decoded_jpeg(content)
        size = frame.get_height(), frame.get_width()
        if layout == formats.RGB:
            return content.reshape(*size, 3)
        if layout == formats.BGR:
            return content.reshape(*size, 3)[..., ::-1].copy()
        if layout in (formats.YUYV, formats.YUY2):
            return cv2.cvtColor(content.reshape(*size, 2), cv2.COLOR_YUV2RGB_YUY2)
        raise SensorError(f"{self.name}: colour format {layout.name} is not supported")

    def close(self) -> None:
        """Stop the streams."""
        pipeline, self._pipeline, self._context = self._pipeline, None, None
        if pipeline is not None:
            pipeline.stop()
