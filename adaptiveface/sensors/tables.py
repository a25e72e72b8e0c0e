"""Read and write the tables of a recording: timestamps.csv (frame,timestamp), features.csv (frame,feature,u,v,confidence),
irises.csv (frame,eye,u,v) and intrinsics.csv (frame,fx,fy,cx,cy)."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from ..errors import FileFormatError, abbreviated
from ..files import decoded, read_bytes
from ..geometry.camera import Camera
from ..geometry.frame import FEATURE_IDS, Features2D
from ..runtime.timing import FrameTimes, frame_times
from .intrinsics import camera_of

TIMESTAMP_COLUMNS = ("frame", "timestamp")
CAMERA_COLUMNS = ("frame", "fx", "fy", "cx", "cy")
FEATURE_COLUMNS = ("frame", "feature", "u", "v", "confidence")
IRIS_COLUMNS = ("frame", "eye", "u", "v")
#: The subject's eyes, in the order of :attr:`~adaptiveface.geometry.frame.Features2D.iris_centres`.
EYES = ("left", "right")
#: Largest number of frames in a table. After a take was cut, there may be fewer images.
_FREE_FRAMES, _MOST_PER_FRAME = 20_000, 4
_MAX_LINE_BYTES = 100
#: Largest value of a clock: nanoseconds since 1970 are 1.7e18.
_MAX_SECONDS = 1e19
_SLOT = {int(feature): slot for slot, feature in enumerate(FEATURE_IDS)}


def read_timestamps(path: Path, frames: range, fps: float) -> FrameTimes:
    """Read timestamps.csv, and check the times with :func:`adaptiveface.runtime.timing.frame_times`.

    Parameters
    ----------
    path : Path
        The table. If it does not exist, the times follow from ``fps``.
    frames : range
        The numbers of the frames.
    fps : float
        Frames per second.

    Returns
    -------
    FrameTimes
        The times of ``frames`` in seconds.

    Raises
    ------
    FileFormatError
        The table is malformed, or there is no unit in which its times fit ``fps``.
    """
    known = {}
    if path.exists():
        for line, (frame, timestamp) in _rows(path, TIMESTAMP_COLUMNS, _most_frames(frames)):
            seconds = _float(path, line, "timestamp", timestamp)
            if not abs(seconds) <= _MAX_SECONDS:
                given = f"timestamp = {abbreviated(timestamp)}"
                raise FileFormatError(f"{path}: line {line}: {given} is no time, nor one in milli- to nanoseconds")
            known[_int(path, line, "frame", frame) - frames.start] = seconds
    return frame_times(known, len(frames), fps, str(path))


def read_features(path: Path, frames: range) -> dict[int, Features2D] | None:
    """Read features.csv.

    Parameters
    ----------
    path : Path
        The table.
    frames : range
        The numbers of the frames. Rows of other frames are skipped.

    Returns
    -------
    dict of int to Features2D, or None
        The features by frame number. Features other than the 40 are skipped, and NaN means that a feature was not seen.
        The result is None if the file does not exist.

    Raises
    ------
    FileFormatError
        The table is malformed. The message names the line.
    """
    if not path.exists():
        return None
    found: dict[int, Features2D] = {}
    for line, (frame, feature, u, v, confidence) in _rows(path, FEATURE_COLUMNS, 68 * _most_frames(frames)):
        number, identifier = _int(path, line, "frame", frame), _int(path, line, "feature", feature)
        if not 0 <= identifier < 68:
            raise FileFormatError(f"{path}: line {line}: feature {identifier} is not an iBUG-68 number (0 to 67)")
        trust = _float(path, line, "confidence", confidence)
        if not 0 <= trust <= 1:
            raise FileFormatError(f"{path}: line {line}: confidence = {abbreviated(confidence)} is not between 0 and 1")
        pixel = (_float(path, line, "u", u), _float(path, line, "v", v))
        if number not in frames or identifier not in _SLOT:
            continue
        features = found.setdefault(number, Features2D(np.full((40, 2), np.nan), np.zeros(40)))
        if all(abs(coordinate) < 1e6 for coordinate in pixel):  # NaN and infinity fail this test, and count as not seen
            features.pixels[_SLOT[identifier]] = pixel
            features.confidence[_SLOT[identifier]] = trust
    return found


def read_irises(path: Path, frames: range) -> dict[int, np.ndarray]:
    """Read irises.csv.

    Parameters
    ----------
    path : Path
        The table.
    frames : range
        The numbers of the frames. Rows of other frames are skipped.

    Returns
    -------
    dict of int to (2, 2) float64
        The iris centres in pixels, by frame number. NaN means that an iris was not seen. The dictionary is empty if the
        file does not exist.

    Raises
    ------
    FileFormatError
        The table is malformed. The message names the line.
    """
    found: dict[int, np.ndarray] = {}
    if not path.exists():
        return found
    for line, (frame, eye, u, v) in _rows(path, IRIS_COLUMNS, 2 * _most_frames(frames)):
        number = _int(path, line, "frame", frame)
        if eye not in EYES:
            raise FileFormatError(f"{path}: line {line}: eye = {abbreviated(eye)!r} is neither left nor right")
        pixel = (_float(path, line, "u", u), _float(path, line, "v", v))
        if number in frames and all(abs(coordinate) < 1e6 for coordinate in pixel):
            found.setdefault(number, np.full((2, 2), np.nan))[EYES.index(eye)] = pixel
    return found


def read_frame_cameras(path: Path, frames: range, camera: Camera) -> dict[int, Camera]:
    """Read intrinsics.csv, which lists the frames that have their own calibration.

    Parameters
    ----------
    path : Path
        The table.
    frames : range
        The numbers of the frames. Rows of other frames are skipped.
    camera : Camera
        The camera of the recording. It gives the size of the images.

    Returns
    -------
    dict of int to Camera
        The cameras by frame number. The dictionary is empty if the file does not exist.

    Raises
    ------
    FileFormatError
        The table is malformed, or a camera is impossible. The message names the line.
    """
    if not path.exists():
        return {}
    cameras = {}
    for line, (frame, *cells) in _rows(path, CAMERA_COLUMNS, _most_frames(frames)):
        number = _int(path, line, "frame", frame)
        fx, fy, cx, cy = (_float(path, line, name, cell) for name, cell in zip(CAMERA_COLUMNS[1:], cells, strict=True))
        known = camera_of(f"{path}: line {line}", (camera.width, camera.height), (fx, fy, cx, cy))
        if number in frames:
            cameras[number] = known
    return cameras


def camera_row(frame: int, camera: Camera) -> tuple:
    """Return the row of a frame for intrinsics.csv."""
    return frame, *(f"{value:.9g}" for value in (camera.fx, camera.fy, camera.cx, camera.cy))


def timestamp_row(frame: int, seconds: float) -> tuple:
    """Return the row of a frame for timestamps.csv. The time is rounded to the microsecond."""
    return frame, f"{float(seconds):.6f}"


def feature_rows(frame: int, seen: Features2D) -> list[tuple]:
    """Return the rows of a frame for features.csv. There is one row per feature that was seen."""
    return [
        (frame, int(FEATURE_IDS[slot]), f"{u:.4f}", f"{v:.4f}", f"{seen.confidence[slot]:.4f}")
        for slot, (u, v) in enumerate(seen.pixels)
        if seen.valid[slot]
    ]


def iris_rows(frame: int, seen: Features2D) -> list[tuple]:
    """Return the rows of a frame for irises.csv. There is one row per eye whose iris was seen."""
    centres = seen.iris_centres
    if centres is None:
        return []
    return [(frame, eye, f"{u:.4f}", f"{v:.4f}") for eye, (u, v) in zip(EYES, centres, strict=True) if np.isfinite(u + v)]


def _rows(path: Path, columns: tuple[str, ...], most: int) -> Iterator[tuple[int, list[str]]]:
    """Line number and cells of every row below the header ``columns``, for at most ``most`` rows.

    An incomplete last line, which a killed writer left, is skipped.
    """
    content = read_bytes(path, _MAX_LINE_BYTES * (most + 2))
    lines = max(content.count(b"\n"), content.count(b"\r"))
    if lines > most + 1:
        raise FileFormatError(f"{path}: {lines} lines; at most {most} fit the number of frames")
    whole, last, line = content.endswith((b"\n", b"\r")), lines + 1, 0
    try:
        reader = csv.reader(io.StringIO(decoded(content), newline=""))
        header = tuple(cell.strip().lower() for cell in next(reader, ()))
        if header != columns:
            raise FileFormatError(f"{path}: the first line is not '{','.join(columns)}'")
        for cells in reader:
            line = reader.line_num
            if not cells or (len(cells) < len(columns) and not whole and line == last):
                continue
            if len(cells) != len(columns):
                raise FileFormatError(f"{path}: line {line} has {len(cells)} values, not {len(columns)}")
            yield line, cells
    except (csv.Error, UnicodeDecodeError) as error:
        raise FileFormatError(f"{path}: not readable as a table ({error})") from None


def _most_frames(frames: range) -> int:
    return _FREE_FRAMES + _MOST_PER_FRAME * len(frames)


def _float(path: Path, line: int, name: str, text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise FileFormatError(f"{path}: line {line}: {name} = {abbreviated(text)!r} is not a number") from None


def _int(path: Path, line: int, name: str, text: str) -> int:
    value = _float(path, line, name, text)
    if not abs(value) < 1e9 or value != int(value):
        raise FileFormatError(f"{path}: line {line}: {name} = {abbreviated(text)!r} is not a frame or feature number")
    return int(value)
