"""Read and write recordings: folders in the layout of Open3D's RGB-D recorder, with optional timestamps and 2D features.

    intrinsic.json           width, height, fps, depth_scale (units per metre), intrinsic_matrix (9, column-major)
    color/00000.jpg|png      8-bit colour, aligned to the depth pixel by pixel
    depth/00000.png          16-bit, 0 = no measurement
    timestamps.csv           optional: frame,timestamp (s)
    features.csv             optional: frame,feature,u,v,confidence (iBUG-68 number; pixels of the depth image)
    irises.csv               optional: frame,eye,u,v (left or right of the subject; pixels), beside features.csv
    intrinsics.csv           optional: frame,fx,fy,cx,cy (px): frames whose camera is not the one of intrinsic.json

File names and tables number the frames. The lowest number that exists is index 0, and a number without files inside the range
is a missing frame. A fault of the whole recording raises :class:`FileFormatError` when it is opened. A fault of a single frame
raises :class:`FrameError` when that frame is read.
"""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import numpy as np

from ..errors import FileFormatError, FrameError
from ..files import GrowingTable, replacing
from ..geometry.camera import Camera
from ..geometry.frame import RgbdFrame
from ..geometry.source import NumberedFrames
from ..runtime.closing import Closing
from .images import read_colour, read_depth, write_image
from .intrinsics import check_rate_and_scale, intrinsics_json, read_intrinsics
from .tables import (
    CAMERA_COLUMNS,
    FEATURE_COLUMNS,
    IRIS_COLUMNS,
    TIMESTAMP_COLUMNS,
    camera_row,
    feature_rows,
    iris_rows,
    read_features,
    read_frame_cameras,
    read_irises,
    read_timestamps,
    timestamp_row,
)

#: A frame without any measurement in this range (mm) shows no face: the sensor failed, or depth_scale is wrong.
DEPTH_RANGE_MM = (100.0, 10_000.0)


class Recording(NumberedFrames):
    """A recorded performance on disk, read frame by frame.

    Parameters
    ----------
    path : path-like
        The folder.

    Attributes
    ----------
    camera : Camera
        The calibration. Frames that ``intrinsics.csv`` lists have their own.
    fps : float
        Frames per second.
    depth_scale : float
        Units of the depth images per metre.
    name : str
        Name of the folder.
    has_features : bool
        Whether the recording holds 2D features.
    timestamps : (F,) float64
        Times of the frames, s.
    notes : tuple of str
        What was converted or repaired in the timestamps.

    Raises
    ------
    FileFormatError
        The recording cannot be used at all. The message names the file and the value.
    """

    path: Path
    depth_scale: float
    timestamps: np.ndarray

    def __init__(self, path: str | os.PathLike) -> None:
        self.path = Path(path)
        if not self.path.is_dir():
            raise FileFormatError(f"{self.path}: no such folder")
        self.name = self.path.resolve().name
        self.unit_file = self.path / "intrinsic.json"  #: says how long a unit of depth is
        self.camera, self.fps, self.depth_scale = read_intrinsics(self.unit_file)
        self._depth = _numbered_files(self.path / "depth", (".png",))
        self._colour = _numbered_files(self.path / "color", (".jpg", ".jpeg", ".png"))
        numbers = self._depth.keys() | self._colour.keys()
        if not self._depth:
            raise FileFormatError(f"{self.path / 'depth'}: no depth images (00000.png, 00001.png, ...)")
        self._first, self._length = min(numbers), max(numbers) - min(numbers) + 1
        if self._length > 2 * len(numbers) + 1000:
            span = f"numbered from {self._first} to {max(numbers)}"
            raise FileFormatError(f"{self.path}: {len(numbers)} frames {span}; number them one by one")
        frames = range(self._first, self._first + self._length)
        times = read_timestamps(self.path / "timestamps.csv", frames, self.fps)
        self.timestamps, self.notes = times.seconds, times.notes
        self._features = read_features(self.path / "features.csv", frames)
        self.has_features = self._features is not None
        for number, irises in read_irises(self.path / "irises.csv", frames).items():
            if self._features is not None and number in self._features:
                self._features[number] = replace(self._features[number], irises=irises)
        self._cameras = read_frame_cameras(self.path / "intrinsics.csv", frames, self.camera)

    def __len__(self) -> int:
        return self._length

    def read(self, index: int) -> RgbdFrame:
        """Return a frame, as ``FrameSource.read`` says. Its colour is None if the recording has none."""
        if not 0 <= index < self._length:
            raise IndexError(f"frame {index} of a recording of {self._length}")
        number = self._first + index
        depth_file = self._depth.get(number)
        if depth_file is None:
            raise FrameError(f"{self.path / 'depth' / f'{number:05d}.png'}: missing")
        depth = read_depth(depth_file, self.camera) * np.float32(1000.0 / self.depth_scale)
        low, high = DEPTH_RANGE_MM
        if not ((depth > low) & (depth < high)).any():
            reason = f"every measurement lies outside {low:g} to {high:g} mm (depth_scale {self.depth_scale:g})"
            raise FrameError(f"{depth_file}: {reason if depth.any() else 'no measurement, every pixel is zero'}")
        return RgbdFrame(
            depth=depth,
            camera=self._cameras.get(number, self.camera),
            colour=self._read_colour(number),
            index=index,
            timestamp=float(self.timestamps[index]),
            features=self._features.get(number) if self._features is not None else None,
        )

    def read_colour(self, index: int) -> np.ndarray | None:
        """Return only the colour (H, W, 3) uint8 RGB of a frame, or None. The errors are those of :meth:`read`."""
        if not 0 <= index < self._length:
            raise IndexError(f"frame {index} of a recording of {self._length}")
        return self._read_colour(self._first + index)

    def _read_colour(self, number: int) -> np.ndarray | None:
        if not self._colour:
            return None
        if number not in self._colour:
            raise FrameError(f"{self.path / 'color' / f'{number:05d}.jpg'}: missing")
        return read_colour(self._colour[number], self.camera)


class RecordingWriter(Closing):
    """Writes frames in the layout that :class:`Recording` reads.

    Every image appears completely or not at all. The tables (timestamps.csv and, if any frame has them, features.csv and
    irises.csv) grow row by row with the frames. The folder is therefore a readable recording at any moment. Use the writer as a
    context manager, or call :meth:`close`.

    Parameters
    ----------
    folder : path-like
        The folder, which must not hold a recording yet.
    camera : Camera
        The calibration.
    fps : float
        Frames per second.
    depth_scale : float
        Units per metre in which depth is stored. A pixel holds 1 to 65,535 of them.
    colour_format : str
        "jpg" (quality 95) or "png" (lossless).

    Attributes
    ----------
    reserved : int
        Number of frames so far.
    moving_lens : bool
        Whether a frame had another camera than ``camera``, so that intrinsics.csv was written.

    Raises
    ------
    FileFormatError
        The folder already holds a recording, or a value is impossible.
    """

    def __init__(
        self,
        folder: str | os.PathLike,
        camera: Camera,
        fps: float = 30.0,
        depth_scale: float = 10_000.0,
        colour_format: str = "jpg",
    ) -> None:
        self.path, self.camera = Path(folder), camera
        self.fps, self.depth_scale, self.colour_format = float(fps), float(depth_scale), colour_format
        check_rate_and_scale(self.path / "intrinsic.json", self.fps, self.depth_scale)
        if (self.path / "intrinsic.json").exists():
            raise FileFormatError(f"{self.path}: already holds a recording; name another folder")
        for name in ("color", "depth"):
            (self.path / name).mkdir(parents=True, exist_ok=True)
        self.reserved, self.moving_lens = 0, False
        self._write_intrinsics()
        self._timestamps = GrowingTable(self.path / "timestamps.csv", TIMESTAMP_COLUMNS)
        self._features = GrowingTable(self.path / "features.csv", FEATURE_COLUMNS)
        self._irises = GrowingTable(self.path / "irises.csv", IRIS_COLUMNS)
        self._cameras = GrowingTable(self.path / "intrinsics.csv", CAMERA_COLUMNS)
        self._timestamps.append([])

    def _write_intrinsics(self) -> None:
        with replacing(self.path / "intrinsic.json") as temporary:
            temporary.write_text(intrinsics_json(self.camera, self.fps, self.depth_scale))

    def write(self, frame: RgbdFrame) -> int:
        """Append a frame, and return its number. Depth beyond the 16-bit range is stored as 0 (no measurement)."""
        number = self.reserve(frame)
        self.write_images(number, frame)
        return number

    def reserve(self, frame: RgbdFrame) -> int:
        """Append a frame to the tables on the disk. This comes before its images, so that every frame has its features.

        Parameters
        ----------
        frame : RgbdFrame
            The frame.

        Returns
        -------
        int
            The number for :meth:`write_images`.

        Raises
        ------
        FileFormatError
            The frame has another size than the camera.
        OSError
            The disk is full.
        """
        if frame.depth.shape != (self.camera.height, self.camera.width):
            size = f"{self.camera.width} x {self.camera.height} pixels"
            raise FileFormatError(f"{self.path}: a frame of {frame.depth.shape[::-1]} pixels, the camera has {size}")
        number = self.reserved
        if frame.features is not None:
            self._features.append(feature_rows(number, frame.features))
            irises = iris_rows(number, frame.features)
            if irises:
                self._irises.append(irises)
        if frame.camera != self.camera:
            self._cameras.append([camera_row(number, frame.camera)])
            self.moving_lens = True
        self._timestamps.append([timestamp_row(number, frame.timestamp)])
        self.reserved += 1
        return number

    def write_images(self, number: int, frame: RgbdFrame) -> None:
        """Write the images of a frame whose ``number`` is reserved. Several threads may do so at the same time."""
        units = np.rint(frame.depth.astype(float) * (self.depth_scale / 1000.0))
        units[~((units >= 1) & (units <= 65_535))] = 0
        write_image(self.path / "depth" / f"{number:05d}.png", units.astype(np.uint16))
        if frame.colour is not None:
            write_image(self.path / "color" / f"{number:05d}.{self.colour_format}", frame.colour)

    def close(self) -> None:
        """Close the tables. Everything is already on the disk. Calling it again does nothing."""
        for table in (self._timestamps, self._features, self._irises, self._cameras):
            table.close()


def _numbered_files(folder: Path, suffixes: tuple[str, ...]) -> dict[int, Path]:
    """Return the image files of a folder by frame number. Files whose name is no number are ignored."""
    if not folder.is_dir():
        return {}
    files = {}
    for entry in sorted(folder.iterdir()):
        if entry.suffix.lower() in suffixes and entry.stem.isdecimal() and len(entry.stem) <= 9:
            files[int(entry.stem)] = entry
    return files
