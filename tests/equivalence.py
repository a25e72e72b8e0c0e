"""One short performance, tracked from its recording and through a vendor's library: how far the results lie apart.

A test of a sensor pushes the frames of :func:`performance` into the vendor's library, in the unit of its format::

    p = performance()
    for number, frame in enumerate(p.quantised(1000)):     # whole millimetres, as uint16 for units_of(frame, 1000)
        ...
    compared = p.compare(frames_from_the_sdk, 1000)        # its recording has the same unit
    assert compared.worst < 0.2 and compared.frames == len(p)

2D features do not pass through a vendor's library: both sides get those of the performance, by frame number.
"""

from __future__ import annotations

import dataclasses
import tempfile
from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np

from adaptiveface.geometry.frame import RgbdFrame
from adaptiveface.pipeline import capture_source, one_thread
from adaptiveface.sensors import Recording, RecordingWriter
from adaptiveface.synthetic.sensor import SyntheticSensor
from adaptiveface.tracking.tracker import FaceTracker

SEED, NEUTRAL, EXPRESSIONS = 5, 10, 25


@dataclass(frozen=True)
class Compared:
    """Root mean square distance of v4 over the vertices, mm: the worst frame, all frames; how many were compared."""

    worst: float
    overall: float
    frames: int

    def __str__(self) -> str:
        return f"v4 differs by {self.overall:.4f} mm rms, {self.worst:.4f} mm in the worst of {self.frames} frames"


class Performance:
    """The rendered frames (depth in tenths of a millimetre, no colour), their actor, and what the tracker makes of it.

    ``width``, ``height`` pixels, ``focal`` pixels at 640 pixels of width.
    """

    def __init__(self, width: int = 640, height: int = 480, focal: float = 525.0) -> None:
        size = {"width": width, "height": height, "focal": focal}
        source = SyntheticSensor(SEED, "truedepth", NEUTRAL, EXPRESSIONS, repeats=1, colour=False, **size)
        self.camera, self.frames = source.camera, tuple(source)
        self._folder = tempfile.TemporaryDirectory(prefix="performance")
        self._references: dict = {}
        self.actor = capture_source(self.recording(10_000), neutral_frames=NEUTRAL)

    def __len__(self) -> int:
        return len(self.frames)

    def quantised(self, units_per_metre: float) -> list[RgbdFrame]:
        """The frames with depth rounded to the unit of a format, mm."""
        unit = np.float32(1000.0 / units_per_metre)
        return [dataclasses.replace(f, depth=units_of(f, units_per_metre) * unit) for f in self.frames]

    def recording(self, units_per_metre: float) -> Recording:
        """The performance as a recording on disk whose images have this unit."""
        folder = Path(self._folder.name) / f"{units_per_metre:g}"
        if not folder.exists():
            with RecordingWriter(folder, self.camera, depth_scale=units_per_metre) as writer:
                for frame in self.frames:
                    writer.write(frame)
        return Recording(folder)

    def track(self, frames: Iterable[RgbdFrame], numbers: Iterable[int] | None = None) -> dict[int, np.ndarray]:
        """Number -> v4 (N, 3) mm in the camera frame; ``numbers``: of the frames, else their ``sequence`` or index.

        Features are taken by number. Every frame must be tracked.
        """
        tracker, out = FaceTracker(self.actor), {}
        frames = list(frames)
        given = [getattr(f, "sequence", f.index) for f in frames] if numbers is None else list(numbers)
        with one_thread():
            for number, frame in zip(given, frames, strict=True):
                features = self.frames[number].features
                plain = RgbdFrame(frame.depth, frame.camera, None, number, number / 30.0, features)
                tracked = tracker.track(plain)
                assert tracked.tracked, f"frame {number}: {tracked.reason}"
                out[number] = tracked.vertices
        return out

    def compare(self, frames: Iterable[RgbdFrame], units_per_metre: float, numbers: Iterable[int] | None = None) -> Compared:
        """``frames`` of a sensor against the same frame numbers of the recording with this unit."""
        got = self.track(frames, numbers)
        key = units_per_metre, tuple(got)
        if key not in self._references:
            recording = self.recording(units_per_metre)
            self._references[key] = self.track((recording.read(n) for n in got), got)
        return compared(got, self._references[key])

    def numbers_of(self, frames: Iterable[RgbdFrame]) -> list[int]:
        """Number of the performance's frame whose depth each frame resembles most: for libraries that do not count."""
        known = np.stack([f.depth[::8, ::8] for f in self.frames])
        return [int(np.argmin(np.abs(known - f.depth[::8, ::8]).mean(axis=(1, 2)))) for f in frames]


def units_of(frame: RgbdFrame, units_per_metre: float) -> np.ndarray:
    """(H, W) uint16 depth of ``frame`` in units of a format."""
    return np.rint(frame.depth.astype(float) * (units_per_metre / 1000.0)).astype(np.uint16)


def compared(got: dict[int, np.ndarray], expected: dict[int, np.ndarray]) -> Compared:
    """How far two tracked runs of the same frames lie apart."""
    assert got.keys() == expected.keys() and got
    squared = np.array([((got[n] - expected[n]) ** 2).sum(axis=1).mean() for n in got])
    return Compared(float(np.sqrt(squared.max())), float(np.sqrt(squared.mean())), len(squared))


@lru_cache
def performance(width: int = 640, height: int = 480, focal: float = 525.0) -> Performance:
    """The performance, rendered and captured once per test run."""
    return Performance(width, height, focal)
