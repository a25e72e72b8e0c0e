"""Silence OpenCV's VideoCapture, and calibrate colour cameras whose calibration is unknown."""

from __future__ import annotations

import math
import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import cv2
import numpy as np

from ..errors import FileFormatError
from ..geometry.camera import FIELD_OF_VIEW, FIELD_OF_VIEW_RANGE, Camera
from .intrinsics import read_camera

__all__ = ["FIELD_OF_VIEW", "FIELD_OF_VIEW_RANGE", "as_rgb", "calibration_for", "camera_of_view", "decoded_jpeg", "quiet"]

_level_lock, _quiet, _level = threading.Lock(), 0, 0


@contextmanager
def quiet() -> Iterator[None]:
    """Silence OpenCV and its FFmpeg on stderr. Our own errors say what is wrong."""
    global _quiet, _level
    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")  # read when FFmpeg is first used
    with _level_lock:  # the level belongs to the whole process: the first user saves it, and the last one restores it
        if _quiet == 0:
            _level = cv2.utils.logging.getLogLevel()
            cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
        _quiet += 1
    try:
        yield
    finally:
        with _level_lock:
            _quiet -= 1
            if _quiet == 0:
                cv2.utils.logging.setLogLevel(_level)


def camera_of_view(width: int, height: int, field_of_view: float = FIELD_OF_VIEW) -> Camera:
    """Return a camera with square pixels.

    Parameters
    ----------
    width, height : int
        Size of the pictures, px.
    field_of_view : float
        Angle across the longer side, degrees. The longer side is used because turning a phone upright does not change its lens.

    Returns
    -------
    Camera
        The calibration. Its principal point is the middle of the pictures.
    """
    focal = max(width, height) / 2 / math.tan(math.radians(field_of_view) / 2)
    return Camera(width, height, focal, focal, (width - 1) / 2, (height - 1) / 2)


def calibration_for(width: int, height: int, intrinsics: Path, field_of_view: float | None) -> Camera:
    """Find the camera of a video.

    Parameters
    ----------
    width, height : int
        Size of the pictures, px.
    intrinsics : Path
        A JSON file with the calibration. It is used if it exists and ``field_of_view`` is None.
    field_of_view : float or None
        Angle across the longer side, degrees. If it is None and there is no file, the angle is a guess.

    Returns
    -------
    Camera
        The calibration.

    Raises
    ------
    FileFormatError
        The file is malformed, or belongs to pictures of another size.
    """
    if field_of_view is not None or not intrinsics.is_file():
        return camera_of_view(width, height, FIELD_OF_VIEW if field_of_view is None else field_of_view)
    camera = read_camera(intrinsics)
    if (camera.width, camera.height) != (width, height):
        raise FileFormatError(
            f"{intrinsics}: is for pictures of {camera.width} x {camera.height}, the video's have {width} x {height}; "
            "correct it or move the video to a folder of its own"
        )
    return camera


def decoded_jpeg(content: np.ndarray) -> np.ndarray | None:
    """Decode the bytes (n,) uint8 of a JPEG to RGB (H, W, 3) uint8. A broken JPEG gives None."""
    decoded = cv2.imdecode(content, cv2.IMREAD_COLOR)
    return None if decoded is None else as_rgb(decoded)


def as_rgb(picture: np.ndarray, mirrored: bool = False) -> np.ndarray:
    """Convert a picture of OpenCV.

    Parameters
    ----------
    picture : (H, W, 3) or (H, W) uint8
        A picture in BGR or grey.
    mirrored : bool
        Whether to flip it left to right.

    Returns
    -------
    (H, W, 3) uint8
        The picture in RGB.
    """
    if picture.ndim == 2:
        picture = cv2.cvtColor(picture, cv2.COLOR_GRAY2BGR)
    picture = picture[:, ::-1, 2::-1] if mirrored else picture[:, :, 2::-1]
    return np.ascontiguousarray(picture, np.uint8)
