"""A video file as a source without depth, for the degraded mode of ``tracking/colour_tracker.py``."""

from __future__ import annotations

import os
from pathlib import Path

import cv2
import numpy as np

from ..errors import FileFormatError, FrameError
from ..frame import RgbdFrame
from .capture_device import FIELD_OF_VIEW, as_rgb, calibration_for, quiet
from .matroska import is_plain_video

#: Suffixes taken for plain videos; .mkv unless Azure Kinect's recorder wrote it, whose depth must not be lost silently.
VIDEO_SUFFIXES = (".mp4", ".m4v", ".mov", ".avi", ".webm", ".mkv")


def is_video(path: str | os.PathLike) -> bool:
    """Whether ``path`` is a file with a suffix of plain videos, and not a depth camera's recording."""
    path = Path(path)
    if path.suffix.lower() not in VIDEO_SUFFIXES or not path.is_file():
        return False
    return path.suffix.lower() != ".mkv" or is_plain_video(path)


class VideoFile:
    """Frames of a video: colour only, depth all 0. ``colour_only`` is True; ``camera``, ``fps``, ``name``, ``path``.

    ``field_of_view`` degrees across the longer side, unless an intrinsic.json lies beside the file; ``mirrored`` flips
    the pictures, for videos recorded as in a mirror. ``len()`` is the number that the file states, or counted where it
    states none; reading past its true end raises :class:`FrameError`. Raises :class:`FileFormatError`.
    """

    colour_only, has_features = True, False

    def __init__(
        self, path: str | os.PathLike, field_of_view: float = FIELD_OF_VIEW, mirrored: bool = False
    ) -> None:
        self.path, self.name, self.mirrored = Path(path), Path(path).name, mirrored
        self._capture, self._picture, self._next = None, None, 0
        if not self.path.is_file():
            raise FileFormatError(f"{self.path}: no such file")
        first = self._decode(0)
        if first is None:
            raise FileFormatError(f"{self.path}: not a video that can be decoded, or one without pictures")
        height, width = first.shape[:2]
        self.camera = calibration_for(width, height, self.path.parent / "intrinsic.json", field_of_view)
        rate = float(self._capture.get(cv2.CAP_PROP_FPS))
        self.fps = rate if 1.0 <= rate <= 240.0 else 30.0
        stated = self._capture.get(cv2.CAP_PROP_FRAME_COUNT)
        self._length = int(stated) if 1 <= stated < 1e8 else self._count()

    def __len__(self) -> int:
        return self._length

    def read(self, index: int) -> RgbdFrame:
        """Frame ``index`` (0-based), quick in order. Raises :class:`FrameError`, :class:`IndexError` outside."""
        if not 0 <= index < self._length:
            raise IndexError(f"frame {index} of a video of {self._length}")
        picture = self._decode(index)
        if picture is None:
            raise FrameError(f"{self.path}: frame {index} cannot be decoded")
        if picture.shape[:2] != (self.camera.height, self.camera.width):
            raise FrameError(f"{self.path}: frame {index} has another size than the first one")
        depth = np.zeros(picture.shape[:2], np.float32)
        return RgbdFrame(depth, self.camera, as_rgb(picture, self.mirrored), index, index / self.fps)

    def close(self) -> None:
        """Release the file; reading opens it again."""
        capture, self._capture, self._picture = self._capture, None, None
        if capture is not None:
            capture.release()

    def _decode(self, index: int) -> np.ndarray | None:
        """The picture (H, W, 3) BGR of a frame, decoding from the start where it lies behind: exact, unlike seeking."""
        if self._picture is not None and index == self._next - 1:
            return self._picture
        self._picture = None
        with quiet():
            if self._capture is None or index < self._next:
                self.close()
                self._capture, self._next = cv2.VideoCapture(str(self.path), cv2.CAP_FFMPEG), 0
            while self._next <= index:
                self._next += 1
                if not self._capture.grab():
                    return None
            found, picture = self._capture.retrieve()
        self._picture = picture if found else None
        return self._picture

    def _count(self) -> int:
        with quiet():
            count = 1
            while self._capture.grab():
                count += 1
        self._picture, self._next = None, count + 1  # at the end: the next frame is found from the start
        return count
