"""What the adapters use of a vendor's library, looked up in the real one; and what happens without a device.

``python vendor_check.py KIND ...`` prints JSON by kind: ``names``: how many names were looked up; ``missing``: those that
the library does not have; ``listed``: the state of the sensor in the list; ``error``: how opening one fails.
"""

from __future__ import annotations

import importlib
import inspect
import json
import re
import sys

import adaptiveface.sensors.kinect2 as kinect2
from adaptiveface.errors import SensorError
from adaptiveface.sensors import list_sensors, open_sensor
from adaptiveface.sensors.live import LiveSensor

#: Methods called on objects that the library hands out: class -> names.
METHODS = {
    "orbbec": {
        "Context": "query_devices set_logger_to_console set_logger_to_file",
        "DeviceList": "get_count get_device_by_serial_number get_device_serial_number_by_index get_device_name_by_index",
        "Pipeline": "get_stream_profile_list enable_frame_sync start stop wait_for_frames",
        "StreamProfileList": "get_default_video_stream_profile get_video_stream_profile",
        "VideoStreamProfile": "get_intrinsic get_distortion get_extrinsic_to get_width get_height get_fps",
        "Config": "enable_stream set_frame_aggregate_output_mode",
        "OBExtrinsic": "rot transform",
        "OBCameraIntrinsic": "fx fy cx cy",
        "OBCameraDistortion": "k1 k2 k3 k4 k5 k6 p1 p2 model",
        "FrameSet": "get_depth_frame get_color_frame",
        "DepthFrame": "get_data get_height get_width get_depth_scale get_index get_timestamp_us",
        "ColorFrame": "get_data get_height get_width get_format",
    },
    "oak": {
        "Device": "getAllAvailableDevices getPlatform isClosed close",
        "DeviceInfo": "getDeviceId name",
        "Pipeline": "create start stop isRunning",
        "node.Camera": "build requestOutput",
        "node.StereoDepth": "build setLeftRightCheck setSubpixel depth inputAlignTo",
        "node.ImageAlign": "input inputAlignTo outputAligned",
        "node.Sync": "setSyncThreshold inputs out",
        "Node.Output": "link createOutputQueue",
        "MessageQueue": "get",
        "MessageGroup": "__getitem__",
        "ImgFrame": "getFrame getTransformation getWidth getHeight getTimestampDevice getSequenceNum",
        "ImgTransformation": "getIntrinsicMatrix",
    },
    "azure": {
        "PyK4A": "start stop close opened get_capture calibration",
        "PyK4APlayback": "open close configuration calibration get_next_capture",
        "PyK4ACapture": "depth color depth_timestamp_usec",
        "Calibration": "get_camera_matrix get_distortion_coefficients get_extrinsic_parameters",
    },
    "kinect2": {
        "KinectSensor": "open close is_available wait_for_frames mapper",
        "CoordinateMapper": "get_depth_camera_intrinsics map_depth_frame_to_camera_space map_depth_frame_to_color_space",
        "FrameSet": "depth color",
        "DepthFrame": "data relative_time_ns",
        "ColorFrame": "as_rgb",
    },
}
LIBRARIES = {"azure": "pyk4a", "orbbec": "pyorbbecsdk", "oak": "depthai", "kinect2": "kinect_next"}
#: How the adapters call the library, or a group of its names.
ALIASES = {
    "azure": {"k4a": "", "self._k4a": "", "formats": "ImageFormat", "kinds": "CalibrationType"},
    "orbbec": {"ob": "", "models": "OBCameraDistortionModel", "formats": "OBFormat", "pyorbbecsdk": ""},
    "oak": {"dai": "", "self._dai": "", "sockets": "CameraBoardSocket", "depthai": ""},
    "kinect2": {"library": ""},
}


def names(kind: str) -> set[str]:
    """Dotted names below the library that its adapter mentions."""
    source = inspect.getsource(importlib.import_module(f"adaptiveface.sensors.{kind}"))
    found = {f"{owner}.{name}" for owner, text in METHODS[kind].items() for name in text.split()}
    for alias, owner in ALIASES[kind].items():
        for name in re.findall(rf"(?<![\w.]){re.escape(alias)}\.([A-Za-z_][\w.]*)", source):
            found.add(f"{owner}.{name}".strip("."))
    return found


def has(module, dotted: str) -> bool:
    value = module
    for part in dotted.split("."):
        if not hasattr(value, part) and part not in getattr(value, "__annotations__", {}):
            return False
        value = getattr(value, part, None)
    return True


def failure(kind: str) -> str:
    """How opening fails; the Kinect's library is asked also where the adapter knows that it will say no."""
    try:
        if kind == "kinect2":
            library = importlib.import_module("kinect_next")
            LiveSensor(lambda: kinect2.Kinect2Driver(library)).close()
        else:
            open_sensor(kind).close()
    except SensorError as error:
        return f"{type(error).__name__}: {error}"
    return "opened"


def check(kind: str) -> dict:
    error, module, wanted = failure(kind), importlib.import_module(LIBRARIES[kind]), sorted(names(kind))
    missing = [name for name in wanted if not has(module, name)]
    return {"names": len(wanted), "missing": missing, "error": error}


if __name__ == "__main__":
    states = {info.name: info.state for info in list_sensors()}
    print(json.dumps({kind: {**check(kind), "listed": states[kind]} for kind in sys.argv[1:]}))
