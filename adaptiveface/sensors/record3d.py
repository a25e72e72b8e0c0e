"""Read ``.r3d`` files of the iPhone app Record3D (TrueDepth or LiDAR): a zip with calibration, pictures and depth.

    metadata            JSON: w, h (picture), dw, dh (depth), K (9, column-major, of the picture), fps,
                        perFrameIntrinsicCoeffs ([fx, fy, cx, cy] per frame, optional), frameTimestamps (s, optional)
    rgbd/N.jpg          picture
    rgbd/N.depth        (dh, dw) float32 metres, LZFSE-compressed; NaN = no measurement
    rgbd/N.conf         confidence, not used

Picture and depth have the same view, so the picture and its calibration are scaled to the depth's size.
"""

from __future__ import annotations

import os
import warnings
from io import BytesIO
from pathlib import Path

import numpy as np
from PIL import Image

from ..errors import FileFormatError, FrameError
from ..files import Archive, parse_json
from ..geometry.camera import MAX_PIXELS, Camera
from ..geometry.frame import RgbdFrame
from ..geometry.source import NumberedFrames
from ..runtime.timing import FrameTimes, frame_times
from .intrinsics import camera_of, focal_and_centre, rate_of
from .lzfse_stream import decompress, lzfse_module
from .recording import DEPTH_RANGE_MM

#: 80,000 frames, which are 22 minutes at 60 frames a second.
_MAX_DIRECTORY_BYTES, _MAX_METADATA_BYTES, _MAX_METADATA_VALUES = 16 << 20, 64 << 20, 4_000_000
_MAX_FILE_BYTES, _MAX_IMAGE_BYTES, _MAX_SIDE = 1 << 40, 64 << 20, 8192
_MAX_DEPTH_SIDE = 2048


class R3dRecording(NumberedFrames):
    """A Record3D recording, read frame by frame.

    Each frame has its own camera if the file holds one per frame.

    Parameters
    ----------
    path : path-like
        The file.

    Attributes
    ----------
    camera : Camera
        The calibration of frames that have none of their own.
    fps : float
        Frames per second.
    name : str
        Name of the file, without the suffix.
    timestamps : (F,) float64
        Times of the frames, s.
    notes : tuple of str
        What was converted or repaired in the timestamps.

    Raises
    ------
    FileFormatError
        The file cannot be used at all.
    DriverMissingError
        The extra ``record3d`` is not installed.
    """

    path: Path
    depth_scale: float = 10_000.0
    timestamps: np.ndarray

    def __init__(self, path: str | os.PathLike) -> None:
        lzfse_module()
        self.path, self.name = Path(path), Path(path).stem
        self._zip = Archive(self.path, _MAX_FILE_BYTES, _MAX_DIRECTORY_BYTES)
        try:
            self._read_metadata()
        except BaseException:
            self._zip.close()
            raise

    def _read_metadata(self) -> None:
        metadata = self._metadata()
        self._size = self._side(metadata, "dw"), self._side(metadata, "dh")
        self._picture = picture = self._side(metadata, "w"), self._side(metadata, "h")
        if not 0.98 < self._size[0] * picture[1] / (self._size[1] * picture[0]) < 1.02:
            raise FileFormatError(f"{self.path}: depth {self._size} and picture {picture} differ in shape")
        k = focal_and_centre(self.path, "K", metadata.get("K"))
        entries = self._zip.namelist()
        names = (entry[5:-6] for entry in entries if entry.startswith("rgbd/") and entry.endswith(".depth"))
        numbers = sorted(int(name) for name in names if name.isascii() and name.isdecimal() and len(name) <= 9)
        if not numbers:
            raise FileFormatError(f"{self.path}: no depth images (rgbd/0.depth, rgbd/1.depth, ...)")
        self._frame_numbers, self._entries = numbers, frozenset(entries)
        self.fps = rate_of(self.path, metadata.get("fps"))
        coefficients = metadata.get("perFrameIntrinsicCoeffs")
        self._per_frame = coefficients if isinstance(coefficients, list) else []
        times = self._times(metadata.get("frameTimestamps"))
        self.timestamps, self.notes = times.seconds, times.notes
        self.camera = self._camera(self.path, k)

    def __len__(self) -> int:
        return len(self._frame_numbers)

    def read(self, index: int) -> RgbdFrame:
        """Return a frame, as ``FrameSource.read`` says. Its colour is scaled to the size of its depth."""
        if not 0 <= index < len(self):
            raise IndexError(f"frame {index} of a recording of {len(self)}")
        number = self._frame_numbers[index]
        entry = f"rgbd/{number}.depth"
        width, height = self._size
        content = decompress(self._entry(entry, _MAX_IMAGE_BYTES), 4 * width * height, f"{self.path}: {entry}")
        depth = np.frombuffer(content, "<f4").reshape(height, width) * np.float32(1000.0)
        low, high = DEPTH_RANGE_MM
        depth = np.where((depth > low) & (depth < high), depth, np.float32(0))  # NaN fails both
        if not depth.any():
            raise FrameError(f"{self.path}: {entry}: no measurement between {low:g} and {high:g} mm")
        return RgbdFrame(depth, self._frame_camera(number), self._colour(number), index, float(self.timestamps[index]))

    def close(self) -> None:
        """Close the file."""
        self._zip.close()

    def _colour(self, number: int) -> np.ndarray | None:
        entry = f"rgbd/{number}.jpg"
        if entry not in self._entries:
            return None
        content = self._entry(entry, _MAX_IMAGE_BYTES)
        try:
            with warnings.catch_warnings(), Image.open(BytesIO(content), formats=("JPEG", "PNG")) as image:
                warnings.simplefilter("error", Image.DecompressionBombWarning)
                if image.size[0] * image.size[1] > MAX_PIXELS:
                    raise FrameError(f"{self.path}: {entry}: {image.size} pixels are too many")
                image.draft("RGB", self._size)
                picture = image.convert("RGB")
                return np.array(
                    picture if picture.size == self._size else picture.resize(self._size, Image.Resampling.BILINEAR)
                )
        except FrameError:
            raise
        except Exception as error:  # image decoders raise anything on damaged files
            raise FrameError(f"{self.path}: {entry}: not readable as an image ({error})") from None

    def _entry(self, entry: str, limit: int) -> bytes:
        """Return the content of an entry. Its declared size is checked first, and enforced while unpacking."""
        try:
            member = self._zip.member(entry)
            if member.file_size > limit:
                raise FrameError(f"{self.path}: {entry}: {member.file_size} bytes are too many")
            with self._zip.open(member) as stream:
                content = stream.read(limit + 1)
        except FrameError:
            raise
        except FileFormatError as error:
            raise FrameError(str(error)) from None
        except Exception as error:  # KeyError, BadZipFile, zlib.error, EOFError, RuntimeError (encrypted), ...
            raise FrameError(f"{self.path}: {entry}: not readable ({error})") from None
        if len(content) > limit:
            raise FrameError(f"{self.path}: {entry}: more than {limit} bytes")
        return content

    def _metadata(self) -> dict:
        try:
            content = self._entry("metadata", _MAX_METADATA_BYTES)
        except FrameError as error:
            raise FileFormatError(str(error)) from None
        content = parse_json(content, f"{self.path}: metadata", _MAX_METADATA_VALUES)
        if not isinstance(content, dict):
            raise FileFormatError(f"{self.path}: metadata is not a JSON object")
        return content

    def _side(self, metadata: dict, key: str) -> int:
        value, limit = metadata.get(key), _MAX_DEPTH_SIDE if key.startswith("d") else _MAX_SIDE
        if isinstance(value, bool) or not isinstance(value, int) or not 8 <= value <= limit:
            raise FileFormatError(f"{self.path}: {key} = {_short(value)} is not an image size (8 to {limit})")
        return value

    def _times(self, given) -> FrameTimes:
        """Return the times of the existing frames: the file's if it has all of them, or else those of the frame rate."""
        numbers = np.array(self._frame_numbers)
        known = dict(enumerate(numbers / self.fps))
        if isinstance(given, list) and len(given) > numbers[-1] and all(_is_time(given[number]) for number in numbers):
            known = {index: float(given[number]) for index, number in enumerate(numbers)}
        return frame_times(known, len(numbers), self.fps, f"{self.path}: frameTimestamps")

    def _frame_camera(self, number: int) -> Camera:
        if number < len(self._per_frame):
            values = self._per_frame[number]
            if isinstance(values, list) and len(values) == 4 and all(map(_is_number, values)):
                try:
                    return self._camera(f"{self.path}: frame {number}", values)
                except FileFormatError as error:
                    raise FrameError(str(error)) from None
        return self.camera

    def _camera(self, where: Path | str, values) -> Camera:
        fx, fy, cx, cy = map(float, values)
        return scaled_camera(camera_of(where, self._picture, (fx, fy, cx, cy)), self._size)


def scaled_camera(picture: Camera, depth: tuple[int, int]) -> Camera:
    """Scale the camera of a picture to the size of the depth.

    Parameters
    ----------
    picture : Camera
        The calibration of the picture.
    depth : (int, int)
        Width and height of the depth, px.

    Returns
    -------
    Camera
        The calibration of the depth. The edge of the first pixel is at -0.5.
    """
    sx, sy = depth[0] / picture.width, depth[1] / picture.height
    return Camera(*depth, picture.fx * sx, picture.fy * sy, (picture.cx + 0.5) * sx - 0.5, (picture.cy + 0.5) * sy - 0.5)


def _short(value) -> str:
    try:
        return repr(value)[:80]
    except ValueError:  # an integer of more than 4300 digits
        return "a huge number"


def _is_time(value) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and abs(value) < 1e21


def _is_number(value) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and abs(value) < 1e12
