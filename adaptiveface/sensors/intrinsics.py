"""Read and check calibrations in files: intrinsic.json, and matrices of nine numbers."""

from __future__ import annotations

import json
import logging
import math
from pathlib import Path

from ..errors import FileFormatError, abbreviated
from ..files import read_json
from ..geometry.camera import Camera

#: Units per metre that a 16-bit depth image of a face can have: centimetre steps up to a range of 0.65 m.
DEPTH_SCALE_RANGE = (100.0, 100_000.0)
#: The usual values of ``depth_scale``, for messages.
USUAL_DEPTH_SCALES = "1000 (millimetres: Kinect, RealSense, Azure, Open3D), 5000 (TUM), 8000 or 10000 (fine steps)"
#: Frames per second of a recording that states none.
USUAL_FPS = 30.0
_MAX_JSON_BYTES, _MAX_JSON_VALUES = 1 << 20, 10_000
_EXPECTED = "a list of 9 numbers: the camera's intrinsics, column-major, [fx, 0, 0, 0, fy, 0, cx, cy, 1]"
_log = logging.getLogger(__name__)


def read_intrinsics(path: Path) -> tuple[Camera, float, float]:
    """Read the ``intrinsic.json`` of a recording.

    Parameters
    ----------
    path : Path
        The file. If it has no ``fps``, 30 frames per second are assumed, and a warning is logged. A file without
        ``depth_scale`` is refused, because nothing else tells the unit of its depth images.

    Returns
    -------
    camera : Camera
        The calibration.
    fps : float
        Frames per second.
    depth_scale : float
        Depth units per metre.

    Raises
    ------
    FileFormatError
        The file cannot be used. The message names the file, the value and the usual values.
    """
    content = _read_json(path)
    if content.get("depth_scale") is None:
        state = "depth_scale = None" if "depth_scale" in content else "depth_scale is missing"
        raise FileFormatError(
            f"{path}: {state}; it says how many units of the depth images are a metre, usually {USUAL_DEPTH_SCALES}"
        )
    fps = rate_of(path, None) if content.get("fps") is None else _number(path, "fps", content["fps"])
    depth_scale = _number(path, "depth_scale", content["depth_scale"])
    check_rate_and_scale(path, fps, depth_scale)
    return _camera_in(path, content), fps, depth_scale


def read_camera(path: Path) -> Camera:
    """Read only the calibration of a JSON file, for pictures that need nothing else from it, such as a video's.

    Parameters
    ----------
    path : Path
        The file. It has ``width``, ``height`` and ``intrinsic_matrix`` as in an ``intrinsic.json``. Its other values are
        ignored.

    Returns
    -------
    Camera
        The calibration.

    Raises
    ------
    FileFormatError
        The calibration cannot be used. The message names the file and the value.
    """
    return _camera_in(path, _read_json(path))


def _camera_in(path: Path, content: dict) -> Camera:
    width, height = (_number(path, name, content.get(name)) for name in ("width", "height"))
    if not (width.is_integer() and height.is_integer()):
        raise FileFormatError(f"{path}: the image size {width:g} x {height:g} is not whole")
    values = focal_and_centre(path, "intrinsic_matrix", content.get("intrinsic_matrix"))
    return camera_of(path, (int(width), int(height)), values)


def focal_and_centre(path: Path, name: str, matrix: object) -> tuple[float, float, float, float]:
    """Take the focal lengths and the principal point from the matrix in a file.

    Parameters
    ----------
    path : Path
        The file, for messages.
    name : str
        The name of the value in the file, for messages.
    matrix : object
        The value. It must be a list of 9 numbers in column-major order: [fx, 0, 0, 0, fy, 0, cx, cy, 1].

    Returns
    -------
    tuple of 4 float
        fx, fy, cx and cy in pixels.

    Raises
    ------
    FileFormatError
        The value is something else. The message has a hint if the matrix looks row-major.
    """
    if not isinstance(matrix, list) or len(matrix) != 9:
        raise FileFormatError(f"{path}: {name} = {abbreviated(matrix)} is not {_EXPECTED}")
    fx, b, c, skew, fy, d, cx, cy, one = (_number(path, name, value) for value in matrix)
    if any((b, c, skew, d)) or one != 1:
        row_major = not (cx or cy or b or skew) and c and d
        hint = f"; it looks row-major, write [{fx:g}, 0, 0, 0, {fy:g}, 0, {c:g}, {d:g}, 1]" if row_major else ""
        raise FileFormatError(f"{path}: {name} {abbreviated(matrix, 120)} is not {_EXPECTED}{hint}")
    return fx, fy, cx, cy


def rate_of(path: Path, fps: object) -> float:
    """Return the frame rate that a file states.

    Parameters
    ----------
    path : Path
        The file, for messages.
    fps : object
        The value in the file.

    Returns
    -------
    float
        Frames per second. If the value is not usable, the usual rate is returned, and a warning is logged.
    """
    if isinstance(fps, (int, float)) and 0.1 <= fps <= 1000:
        return float(fps)
    state = "fps is missing" if fps is None else f"fps = {abbreviated(fps)} is not between 0.1 and 1000"
    _log.warning("%s: %s; %g is taken (usual are 30, 60 and 15)", path, state, USUAL_FPS)
    return USUAL_FPS


def camera_of(where: Path | str, size: tuple[int, int], values: tuple[float, float, float, float]) -> Camera:
    """Make a camera, and check that its values are possible.

    Parameters
    ----------
    where : Path or str
        The origin of the values, for messages.
    size : (int, int)
        Width and height of the images in pixels.
    values : tuple of 4 float
        fx, fy, cx and cy in pixels.

    Returns
    -------
    Camera
        The calibration.

    Raises
    ------
    FileFormatError
        The values are impossible for images of this size.
    """
    try:
        camera = Camera(*size, *values)
    except FileFormatError as error:
        raise FileFormatError(f"{where}: {error}") from None
    fx, fy, cx, cy = values
    most = max(size)
    if not (most / 20 < fx < most * 20 and most / 20 < fy < most * 20 and abs(cx) < 4 * most and abs(cy) < 4 * most):
        raise FileFormatError(f"{where}: fx, fy, cx, cy = {fx:g}, {fy:g}, {cx:g}, {cy:g} do not fit images of {most} pixels")
    return camera


def check_rate_and_scale(path: Path, fps: float, depth_scale: float) -> None:
    """Raise :class:`FileFormatError` for values that no recording can have."""
    low, high = DEPTH_SCALE_RANGE
    if not low <= depth_scale <= high:
        inverse = 0 < depth_scale < 1 and low <= 1 / depth_scale <= high
        hint = f"; as metres per unit it would be {1 / depth_scale:g} units per metre" if inverse else ""
        raise FileFormatError(
            f"{path}: depth_scale = {depth_scale:g} is not between {low:g} and {high:g} per metre; usual are "
            f"{USUAL_DEPTH_SCALES}{hint}"
        )
    if not 0.1 <= fps <= 1000:
        raise FileFormatError(f"{path}: fps = {fps:g} is not between 0.1 and 1000; usual are 30, 60 and 15")


def intrinsics_json(camera: Camera, fps: float, depth_scale: float) -> str:
    """Return the text of an ``intrinsic.json``. ``depth_scale`` is in depth units per metre."""
    content = {
        "width": camera.width,
        "height": camera.height,
        "fps": fps,
        "depth_scale": depth_scale,
        "intrinsic_matrix": camera.matrix.T.ravel().tolist(),
    }
    return json.dumps(content, indent=1) + "\n"


def _read_json(path: Path) -> dict:
    if not path.exists():
        raise FileFormatError(f"{path}: no such file; a recording needs its camera's calibration")
    content = read_json(path, _MAX_JSON_BYTES, _MAX_JSON_VALUES)
    if not isinstance(content, dict):
        raise FileFormatError(f"{path}: not a JSON object")
    return content


def _number(path: Path, name: str, value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not _finite(value):
        raise FileFormatError(f"{path}: {name} = {abbreviated(value)} is not a finite number")
    return float(value)


def _finite(value: int | float) -> bool:
    try:
        return math.isfinite(value)
    except OverflowError:  # an integer too large for a float
        return False
