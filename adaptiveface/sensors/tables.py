"""The tables of a recording: timestamps.csv (frame,timestamp), features.csv (frame,feature,u,v,confidence) and
intrinsics.csv (frame,fx,fy,cx,cy)."""

from __future__ import annotations

import csv
import math
import os
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from ..camera import Camera
from ..errors import FileFormatError
from ..frame import FEATURE_IDS, Features2D
from ..timing import FrameTimes, frame_times
from .intrinsics import camera_of

_MAX_BYTES = 512 << 20
_SLOT = {int(feature): slot for slot, feature in enumerate(FEATURE_IDS)}


def read_timestamps(path: Path, frames: range, fps: float) -> FrameTimes:
    """Seconds of ``frames`` as :func:`adaptiveface.timing.frame_times` judges them; without the file the frame rate's.

    Raises :class:`FileFormatError` for a table that is malformed, or whose times fit ``fps`` in no unit.
    """
    known = {}
    if path.exists():
        for line, (frame, timestamp) in _rows(path, ("frame", "timestamp")):
            seconds = _float(path, line, "timestamp", timestamp)
            if not math.isfinite(seconds):
                raise FileFormatError(f"{path}: line {line}: timestamp = {timestamp} is not a finite number")
            known[_int(path, line, "frame", frame) - frames.start] = seconds
    return frame_times(known, len(frames), fps, str(path))


def read_features(path: Path, frames: range) -> dict[int, Features2D] | None:
    """Frame number -> features; None without the file. Features outside the 40 are passed over, NaN means not seen."""
    if not path.exists():
        return None
    found: dict[int, Features2D] = {}
    for line, (frame, feature, u, v, confidence) in _rows(path, ("frame", "feature", "u", "v", "confidence")):
        number, identifier = _int(path, line, "frame", frame), _int(path, line, "feature", feature)
        if not 0 <= identifier < 68:
            raise FileFormatError(f"{path}: line {line}: feature {identifier} is not an iBUG-68 number (0 to 67)")
        trust = _float(path, line, "confidence", confidence)
        if not 0 <= trust <= 1:
            raise FileFormatError(f"{path}: line {line}: confidence = {confidence} is not between 0 and 1")
        pixel = (_float(path, line, "u", u), _float(path, line, "v", v))
        if number not in frames or identifier not in _SLOT:
            continue
        features = found.setdefault(number, Features2D(np.full((40, 2), np.nan), np.zeros(40)))
        if all(abs(coordinate) < 1e6 for coordinate in pixel):  # NaN and infinity fail this test: not seen
            features.pixels[_SLOT[identifier]] = pixel
            features.confidence[_SLOT[identifier]] = trust
    return found


def read_frame_cameras(path: Path, frames: range, camera: Camera) -> dict[int, Camera]:
    """Frame number -> camera of every frame that intrinsics.csv lists; empty without the file.

    ``camera``: the recording's, which gives the size of the images. Raises :class:`FileFormatError` with the line.
    """
    if not path.exists():
        return {}
    cameras = {}
    for line, (frame, *cells) in _rows(path, ("frame", "fx", "fy", "cx", "cy")):
        number = _int(path, line, "frame", frame)
        values = (_float(path, line, name, cell) for name, cell in zip(("fx", "fy", "cx", "cy"), cells, strict=True))
        known = camera_of(f"{path}: line {line}", (camera.width, camera.height), tuple(values))
        if number in frames:
            cameras[number] = known
    return cameras


def write_frame_cameras(path: Path, cameras: Mapping[int, Camera]) -> None:
    """One row per frame."""
    rows = ((frame, *(f"{value:.9g}" for value in (c.fx, c.fy, c.cx, c.cy))) for frame, c in cameras.items())
    _write(path, ("frame", "fx", "fy", "cx", "cy"), rows)


def write_timestamps(path: Path, timestamps: Sequence[float]) -> None:
    """One row per frame, microseconds kept."""
    _write(path, ("frame", "timestamp"), ((i, f"{t:.6f}") for i, t in enumerate(timestamps)))


def write_features(path: Path, features: Mapping[int, Features2D]) -> None:
    """One row per feature that was seen."""
    rows = (
        (frame, int(FEATURE_IDS[slot]), f"{u:.4f}", f"{v:.4f}", f"{seen.confidence[slot]:.4f}")
        for frame, seen in features.items()
        for slot, (u, v) in enumerate(seen.pixels)
        if seen.valid[slot]
    )
    _write(path, ("frame", "feature", "u", "v", "confidence"), rows)


def _rows(path: Path, columns: tuple[str, ...]) -> Iterator[tuple[int, list[str]]]:
    """Line number and cells of every row below the header ``columns``."""
    if path.stat().st_size > _MAX_BYTES:
        raise FileFormatError(f"{path}: {path.stat().st_size >> 20} MiB are too many")
    try:
        with open(path, newline="", encoding="utf-8-sig") as stream:
            reader = csv.reader(stream)
            header = tuple(cell.strip().lower() for cell in next(reader, ()))
            if header != columns:
                raise FileFormatError(f"{path}: the first line is not '{','.join(columns)}'")
            for cells in reader:
                if not cells:
                    continue
                if len(cells) != len(columns):
                    raise FileFormatError(f"{path}: line {reader.line_num} has {len(cells)} values, not {len(columns)}")
                yield reader.line_num, cells
    except (csv.Error, UnicodeDecodeError, OSError) as error:
        raise FileFormatError(f"{path}: not readable as a table ({error})") from None


def _float(path: Path, line: int, name: str, text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise FileFormatError(f"{path}: line {line}: {name} = {text[:40]!r} is not a number") from None


def _int(path: Path, line: int, name: str, text: str) -> int:
    value = _float(path, line, name, text)
    if not abs(value) < 1e9 or value != int(value):
        raise FileFormatError(f"{path}: line {line}: {name} = {text[:40]!r} is not a frame or feature number")
    return int(value)


def _write(path: Path, header: tuple[str, ...], rows: Iterator[tuple]) -> None:
    temporary = path.with_name(path.name + ".part")
    with open(temporary, "w", newline="", encoding="utf-8") as stream:
        csv.writer(stream).writerows([header, *rows])
    os.replace(temporary, path)
