"""Writes an Azure Kinect recording with the SDK's own recorder, without a camera: ``python azure_mkv.py TAKE.npz OUT.mkv``.

Runs where NumPy < 2 and pyk4a-bundle are installed. TAKE.npz: ``depth`` (n, 576, 640) uint16 mm (mode NFOV unbinned),
``colour`` (720, 1280, 3) uint8 RGB, ``depth_lens`` and ``colour_lens``: [fx, fy, cx, cy, k1, ..., k6, p2, p1] in
pixels, ``baseline`` mm from the depth to the colour camera along x.
"""

from __future__ import annotations

import ctypes as c
import glob
import json
import os
import sys

import cv2
import numpy as np
import pyk4a

LIBRARIES = os.path.join(os.path.dirname(os.path.dirname(pyk4a.__file__)), "pyk4a_bundle.libs")
K4A = c.CDLL(glob.glob(LIBRARIES + "/libk4a-*.so*")[0])
RECORD = c.CDLL(glob.glob(LIBRARIES + "/libk4arecord-*.so*")[0])
FREE = c.CFUNCTYPE(None, c.c_void_p, c.c_void_p)
MJPG, DEPTH16, IR16 = 0, 4, 5
#: The depth sensor has 1024 x 1024 pixels, of which this mode uses 640 x 576; the picture of 1280 x 720 is scaled from
#: 4096 x 3072, cropped to 16:9 (4096 x 2304).
RAW, CROP, PHOTO, SCALE, PHOTO_CROP = 1024, (192, 180), (4096, 3072), 3.2, 384


class Configuration(c.Structure):
    _fields_ = [
        ("color_format", c.c_int),
        ("color_resolution", c.c_int),
        ("depth_mode", c.c_int),
        ("fps", c.c_int),
        ("synchronised", c.c_bool),
        ("delay", c.c_int32),
        ("wired", c.c_int),
        ("subordinate", c.c_uint32),
        ("led", c.c_bool),
    ]


def declare(library, name, *arguments, returns=c.c_int):
    function = getattr(library, name)
    function.argtypes, function.restype = arguments, returns
    return function


POINTER = c.POINTER(c.c_void_p)
IMAGE = c.c_int, c.c_int, c.c_int, c.c_int, c.c_void_p, c.c_size_t, FREE, c.c_void_p, POINTER
image_create = declare(K4A, "k4a_image_create_from_buffer", *IMAGE)
image_time = declare(K4A, "k4a_image_set_device_timestamp_usec", c.c_void_p, c.c_uint64, returns=None)
image_release = declare(K4A, "k4a_image_release", c.c_void_p, returns=None)
capture_create = declare(K4A, "k4a_capture_create", POINTER)
capture_release = declare(K4A, "k4a_capture_release", c.c_void_p, returns=None)
capture_set = {
    kind: declare(K4A, f"k4a_capture_set_{kind}_image", c.c_void_p, c.c_void_p, returns=None)
    for kind in ("color", "depth", "ir")
}
record_create = declare(RECORD, "k4a_record_create", c.c_char_p, c.c_void_p, Configuration, POINTER)
record_attach = declare(RECORD, "k4a_record_add_attachment", c.c_void_p, c.c_char_p, c.c_void_p, c.c_size_t)
record_tag = declare(RECORD, "k4a_record_add_tag", c.c_void_p, c.c_char_p, c.c_char_p)
record_header = declare(RECORD, "k4a_record_write_header", c.c_void_p)
record_capture = declare(RECORD, "k4a_record_write_capture", c.c_void_p, c.c_void_p)
record_flush = declare(RECORD, "k4a_record_flush", c.c_void_p)
record_close = declare(RECORD, "k4a_record_close", c.c_void_p, returns=None)


def check(result: int) -> None:
    assert result == 0, result


def place(x: float = 0.0) -> dict:
    return {"Rotation": [1, 0, 0, 0, 1, 0, 0, 0, 1], "Translation": [x, 0, 0]}


def camera(location: str, purpose: str, size, parameters, x: float, radius: float) -> dict:
    return {
        "Intrinsics": {
            "ModelParameterCount": 14,
            "ModelParameters": parameters,
            "ModelType": "CALIBRATION_LensDistortionModelBrownConrady",
        },
        "Location": f"CALIBRATION_CameraLocation{location}",
        "Purpose": f"CALIBRATION_CameraPurpose{purpose}",
        "MetricRadius": radius,
        "Rt": place(x),
        "SensorHeight": size[1],
        "SensorWidth": size[0],
        "Shutter": "CALIBRATION_ShutterTypeUndefined",
        "ThermalAdjustmentParams": {"Params": [0.0] * 12},
    }


def motion_sensor(kind: str) -> dict:
    return {
        "BiasTemperatureModel": [0.0] * 12,
        "BiasUncertainty": [1e-4] * 3,
        "Id": "CALIBRATION_InertialSensorId_LSM6DSM",
        "MixingMatrixTemperatureModel": [1.0, 0, 0, 0] + [0.0] * 32,
        "ModelTypeMask": 16,
        "Noise": [1e-4] * 6,
        "Rt": place(),
        "SecondOrderScaling": [0.0] * 9,
        "SensorType": f"CALIBRATION_InertialSensorType_{kind}",
        "TemperatureBounds": [5.0, 60.0],
        "TemperatureC": 0,
    }


def raw_parameters(lens, scale, offset, size) -> list[float]:
    """Parameters of a mode's image as the SDK stores them: shares of the whole sensor, edges instead of centres."""
    fx, fy, cx, cy, *rest = map(float, lens)
    centre = [((v + 0.5) * scale + o) / s for v, o, s in zip((cx, cy), offset, size)]  # noqa: B905
    return [*centre, fx * scale / size[0], fy * scale / size[1], *rest[:6], 0.0, 0.0, *rest[6:]]


def calibration(depth_lens, colour_lens, baseline) -> bytes:
    depth = raw_parameters(depth_lens, 1, CROP, (RAW, RAW))
    colour = raw_parameters(colour_lens, SCALE, (0, PHOTO_CROP), PHOTO)
    cameras = [
        camera("D0", "Depth", (RAW, RAW), depth, 0.0, 1.74),
        camera("PV0", "PhotoVideo", PHOTO, colour, float(baseline) / 1000.0, 0),
    ]
    metadata = {
        "SerialId": "000000000001",
        "FactoryCalDate": "1/1/2020 0:00:00 AM GMT",
        "Version": {"Major": 1, "Minor": 2},
        "DeviceName": "AzureKinect-PV",
        "Notes": "PV0_max_radius_invalid",
    }
    sensors = [motion_sensor("Gyro"), motion_sensor("Accelerometer")]
    content = {"CalibrationInformation": {"Cameras": cameras, "InertialSensors": sensors, "Metadata": metadata}}
    return json.dumps(content, separators=(",", ":")).encode() + b"\0"


def image(layout: int, width: int, height: int, stride: int, content: bytes, time: int, keep: list) -> c.c_void_p:
    buffer, out = c.create_string_buffer(content, len(content)), c.c_void_p()
    keep.append(buffer)
    pointer = c.cast(buffer, c.c_void_p)
    check(image_create(layout, width, height, stride, pointer, len(content), FREE(0), None, c.byref(out)))
    image_time(out, time)
    return out


def write(path: str, depths, picture, calibration_json: bytes) -> None:
    record, keep = c.c_void_p(), []
    check(record_create(path.encode(), None, Configuration(MJPG, 1, 2, 2, True, 0, 0, 0, False), c.byref(record)))
    check(record_attach(record, b"calibration.json", calibration_json, len(calibration_json)))
    check(record_tag(record, b"K4A_DEVICE_SERIAL_NUMBER", b"000000000001"))
    check(record_header(record))
    quality = [cv2.IMWRITE_JPEG_QUALITY, 100, cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444]
    jpeg = cv2.imencode(".jpg", picture[..., ::-1], quality)[1].tobytes()
    infrared = np.full(depths.shape[1:], 300, np.uint16).tobytes()
    for number, depth in enumerate(depths):
        time, capture = 1_000_000 + round(number * 1e6 / 30), c.c_void_p()
        check(capture_create(c.byref(capture)))
        images = {
            "depth": image(DEPTH16, 640, 576, 1280, np.ascontiguousarray(depth).tobytes(), time, keep),
            "ir": image(IR16, 640, 576, 1280, infrared, time, keep),
            "color": image(MJPG, 1280, 720, 0, jpeg, time, keep),
        }
        for kind, content in images.items():
            capture_set[kind](capture, content)
        check(record_capture(record, capture))
        for content in images.values():
            image_release(content)
        capture_release(capture)
    check(record_flush(record))
    record_close(record)


if __name__ == "__main__":
    with np.load(sys.argv[1]) as take:
        lenses = calibration(take["depth_lens"], take["colour_lens"], take["baseline"])
        write(sys.argv[2], take["depth"], take["colour"], lenses)
