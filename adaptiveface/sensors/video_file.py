"""A video file as a source without depth, for the degraded mode of ``tracking/colour_tracker.py``."""

from __future__ import annotations

import os
from collections.abc import Generator
from pathlib import Path

import numpy as np

from ..errors import FileFormatError, FrameError
from ..geometry.frame import RgbdFrame
from ..geometry.source import NumberedFrames
from .capture_device import calibration_for
from .matroska import is_plain_video
from .video_probe import MAX_BYTES, too_large
from .video_stream import pictures, read_index

#: Suffixes of plain videos. An .mkv of Azure Kinect's recorder is no plain video, and its depth must not be lost silently.
VIDEO_SUFFIXES = (".mp4", ".m4v", ".mov", ".avi", ".webm", ".mkv", ".wmv", ".mpg", ".mpeg", ".mts", ".3gp", ".flv", ".ogv")
#: FFmpeg finds the streams of these files only by decoding, and accepts no limit for that.
_LATE_STREAMS = (".mpg", ".mpeg", ".mts", ".flv")


def is_video(path: str | os.PathLike) -> bool:
    """Return whether a file has a suffix of plain videos, and is not a depth camera's recording."""
    path = Path(path)
    if path.suffix.lower() not in VIDEO_SUFFIXES or not path.is_file():
        return False
    return path.suffix.lower() != ".mkv" or is_plain_video(path)


class VideoFile(NumberedFrames):
    """A video as a source of frames with colour only, whose depth is 0 everywhere.

    Parameters
    ----------
    path : path-like
        The file.
    field_of_view : float, optional
        Angle across the longer side, degrees. By default, the camera is the one of an ``intrinsic.json`` beside the file.
        Without that file, the angle is assumed to be 60 degrees, and ``guessed_camera`` is True.

    Attributes
    ----------
    camera : Camera
        The calibration.
    fps : float
        Frames per second.
    name : str
        Name of the file.
    timestamps : (F,) float64
        When each frame is shown, s after the first one. F does not count frames that an edit list leaves out, nor those
        behind the place where a file is cut off.
    notes : tuple of str
        What is missing.

    Raises
    ------
    FileFormatError
        The file cannot be read.
    MissingExtraError
        PyAV is not installed.
    """

    colour_only = True
    path: Path
    timestamps: np.ndarray

    def __init__(self, path: str | os.PathLike, field_of_view: float | None = None) -> None:
        self.path, self.name = Path(path), Path(path).name
        self._pictures: Generator[tuple[int | None, np.ndarray], None, None] | None = None
        self._found: tuple[int, np.ndarray] | None = None  # the frame decoded last
        if not self.path.is_file():
            raise FileFormatError(f"{self.path}: no such file")
        if self.path.suffix.lower() in _LATE_STREAMS and too_large(os.fspath(self.path)):
            raise FileFormatError(f"{self.path}: its first picture needs more than {MAX_BYTES >> 20} MiB, or never comes")
        index = read_index(self.path)
        self.timestamps, self.fps, self._stamps = index.seconds, index.fps, index.stamps
        first = self._decode(0) if len(self.timestamps) else None
        if first is None:
            raise FileFormatError(f"{self.path}: not a video that can be decoded, or one without pictures")
        height, width = first.shape[:2]
        intrinsics = self.path.parent / "intrinsic.json"
        self.camera = calibration_for(width, height, intrinsics, field_of_view)
        self.guessed_camera = field_of_view is None and not intrinsics.is_file()
        missing = index.stated - len(self)
        self.notes = (f"{self.path}: is cut off: {len(self)} of its {index.stated} frames can be read",) if missing > 1 else ()

    def __len__(self) -> int:
        return len(self.timestamps)

    def read(self, index: int) -> RgbdFrame:
        """Return a frame, as ``FrameSource.read`` says. Its depth is 0 everywhere. Reading is quick in order."""
        if not 0 <= index < len(self):
            raise IndexError(f"frame {index} of a video of {len(self)}")
        picture = self._decode(index)
        if picture is None:
            raise FrameError(f"{self.path}: frame {index} cannot be decoded")
        if picture.shape[:2] != (self.camera.height, self.camera.width):
            raise FrameError(f"{self.path}: frame {index} has another size than the first one")
        depth = np.zeros(picture.shape[:2], np.float32)
        return RgbdFrame(depth, self.camera, picture, index, float(self.timestamps[index]))

    def close(self) -> None:
        """Release the file. Reading opens it again."""
        pictures, self._pictures, self._found = self._pictures, None, None
        if pictures is not None:
            pictures.close()

    def _decode(self, index: int) -> np.ndarray | None:
        """Return the RGB (H, W, 3) of a frame, or None.

        To go back, the film is decoded from its start, because seeking is not exact.
        """
        if self._pictures is None or (self._found is not None and index < self._found[0]):
            self.close()
            self._pictures = pictures(self.path)
        while self._found is None or self._found[0] < index:
            stamp, picture = next(self._pictures, (None, None))
            if picture is None:
                self.close()
                return None
            number = self._number(stamp)
            if number is not None:
                self._found = number, picture
        return self._found[1] if self._found[0] == index else None

    def _number(self, stamp: int | None) -> int | None:
        """Return the number of the frame that has a stamp, or None if that frame does not play."""
        if self._stamps is None:
            return 0 if self._found is None else self._found[0] + 1
        place = int(np.searchsorted(self._stamps, stamp)) if stamp is not None else len(self)
        return place if place < len(self) and self._stamps[place] == stamp else None
