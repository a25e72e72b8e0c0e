"""Luxonis OAK-D cameras through depthai, version 3: stereo depth aligned to the colour camera. Not tested with a camera.

The device rectifies, matches and aligns the images. Picture and depth arrive as those of a single pinhole camera.
"""

from __future__ import annotations

import os
from datetime import timedelta
from typing import Any

import numpy as np

from ..errors import DriverMissingError, SensorError, SensorNotFoundError
from ..geometry.camera import Camera
from .driver import Driver, RawFrame

WIDTH, HEIGHT, FPS = 640, 400, 30
#: Depth and picture that are further apart do not show the same moment, ms.
MAX_SKEW_MS = 17


def depthai_module():
    """Return the vendor's library. Raises :class:`DriverMissingError`."""
    os.environ.setdefault("DEPTHAI_LEVEL", "off")  # failures are reported as errors
    try:
        import depthai

        depthai.node.Camera  # noqa: B018 - version 2 has none
    except (ImportError, AttributeError):
        raise DriverMissingError('OAK-D needs depthai 3: pip install "adaptiveface[oak]"') from None
    return depthai


def connected_cameras() -> list[tuple[str, str]]:
    """Return (identifier, name) of every connected camera."""
    return [(info.getDeviceId(), f"OAK {info.name}") for info in depthai_module().Device.getAllAvailableDevices()]


class OakDriver(Driver):
    """The camera with an identifier, or the first one."""

    live, has_features, fps, depth_scale = True, False, float(FPS), 1000.0
    description = "Luxonis OAK-D"
    open_timeout = 60.0  # the device boots

    def __init__(self, identifier: str = "") -> None:
        self._dai = depthai_module()
        self.identifier, self.name = identifier, f"OAK {identifier}".strip()
        self._pipeline: Any | None = None
        self._device: Any | None = None

    @classmethod
    def connected(cls) -> list[tuple[str, str]]:
        """See :func:`connected_cameras`."""
        return connected_cameras()

    def open(self) -> None:
        """Boot the device, and start depth and colour. Raises :class:`SensorNotFoundError` or :class:`SensorError`."""
        dai = self._dai
        devices = dai.Device.getAllAvailableDevices()  # opening one that is absent would take 12 s
        info = next((d for d in devices if self.identifier in ("", d.getDeviceId())), None)
        if info is None:
            found = ", ".join(d.getDeviceId() for d in devices) or "none"
            raise SensorNotFoundError(f"{self.name}: no such camera (connected: {found}); check the cable")
        try:
            self._device = device = dai.Device(info)
            self._pipeline = pipeline = dai.Pipeline(device)
            self._queue = self._build(pipeline, device)
            pipeline.start()
        except RuntimeError as error:
            raise SensorError(f"{self.name}: cannot start depth and colour ({error}); use a USB 3 port") from None

    def _build(self, pipeline, device):
        """Set up stereo depth that is aligned to the undistorted picture of the same moment. Returns the queue of both."""
        dai, sockets, size = self._dai, self._dai.CameraBoardSocket, (WIDTH, HEIGHT)
        colour, left, right = (
            pipeline.create(dai.node.Camera).build(socket) for socket in (sockets.CAM_A, sockets.CAM_B, sockets.CAM_C)
        )
        picture = colour.requestOutput(size, dai.ImgFrame.Type.RGB888i, fps=FPS, enableUndistortion=True)
        stereo = pipeline.create(dai.node.StereoDepth).build(
            left=left.requestOutput(size, fps=FPS),
            right=right.requestOutput(size, fps=FPS),
            presetMode=dai.node.StereoDepth.PresetMode.FACE,
        )
        stereo.setLeftRightCheck(True)
        stereo.setSubpixel(True)  # whole disparities are centimetres apart at half a metre
        depth = stereo.depth
        if device.getPlatform() == dai.Platform.RVC4:
            align = pipeline.create(dai.node.ImageAlign)
            stereo.depth.link(align.input)
            picture.link(align.inputAlignTo)
            depth = align.outputAligned
        else:
            picture.link(stereo.inputAlignTo)
        sync = pipeline.create(dai.node.Sync)
        sync.setSyncThreshold(timedelta(milliseconds=MAX_SKEW_MS))
        depth.link(sync.inputs["depth"])
        picture.link(sync.inputs["picture"])
        return sync.out.createOutputQueue(maxSize=4, blocking=False)

    def grab(self, timeout: float) -> RawFrame | None:
        """Return the next pair of depth and picture."""
        pipeline, device = self._opened(self._pipeline), self._opened(self._device)
        try:
            group = self._queue.get(timedelta(seconds=timeout))
        except self._dai.MessageQueue.QueueException as error:
            raise self._unplugged() from error
        if group is None:
            if device.isClosed() or not pipeline.isRunning():
                raise self._unplugged()
            return None
        depth, picture = group["depth"], group["picture"]
        (fx, _, cx), (_, fy, cy), _ = depth.getTransformation().getIntrinsicMatrix()
        camera = Camera(depth.getWidth(), depth.getHeight(), fx, fy, cx, cy)
        rgb = np.asarray(picture.getFrame())
        seconds = depth.getTimestampDevice().total_seconds()
        return RawFrame(np.asarray(depth.getFrame()), camera, rgb, depth.getSequenceNum(), seconds)

    def close(self) -> None:
        """Stop the pipeline and release the device."""
        pipeline, device, self._pipeline, self._device = self._pipeline, self._device, None, None
        try:
            if pipeline is not None and pipeline.isRunning():
                pipeline.stop()
        finally:
            if device is not None:
                device.close()
