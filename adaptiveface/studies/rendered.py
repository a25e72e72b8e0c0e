"""Hold a rendered performance of a synthetic performer as one record: in memory, in a file, and as frames."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ..evaluation import GroundTruth, TruthFrame
from ..files.mapped import release
from ..files.npz import load_checked
from ..files.records import array, by_attribute, checks, record
from ..geometry.camera import Camera
from ..geometry.frame import Features2D, RgbdFrame
from ..runtime.threads import one_thread

if TYPE_CHECKING:
    from ..synthetic.lesson import LessonSensor
    from ..synthetic.sensor import SyntheticSensor

#: Name of the performance that was made for watching the correctives.
LESSON = "lesson"
#: Arrays that stay on the disk from this size on, bytes. Kernels that work on the same performance share them.
_MAPPED, _MAPPED_FROM = ("depth", "colour", "truth_vertices"), 1 << 20
_MAX_BYTES = 2 << 30
#: Unit of the stored depth, mm.
_DEPTH_UNIT = 0.1


@record
@dataclass(frozen=True)
class RenderedPerformance:
    """F frames of H x W pixels, with the true head of V vertices."""

    depth: np.ndarray = array("F H W", "u2", "depth in units of ``depth_unit``; 0 where nothing was measured")
    colour: np.ndarray = array("F H W 3", "u1", "RGB")
    confidence: np.ndarray = array("F 40", "f8", "confidence of the features; 0 for a hidden one")
    pixels: np.ndarray = array("F 40 2", "f8", "places of the features; -1 for a hidden one", unit="px")
    intrinsics: np.ndarray = array("4", "f8", "fx, fy, cx, cy", unit="px")
    depth_unit: np.ndarray = array("", "f8", "unit of ``depth``", unit="mm")
    truth_vertices: np.ndarray = array("F V 3", doc="true heads in the camera frame", unit="mm")
    truth_rigid: np.ndarray = array("F 4 4", "f8", "true head frame to camera frame", unit="mm")
    performance: np.ndarray = array("F", "i4", "-1 in the neutral frames, 0 in the first performance, 1 in its repeat")
    truth_neutral: np.ndarray = array("V 3", "f8", "true neutral in the head frame", unit="mm")

    def __len__(self) -> int:
        return len(self.depth)

    @classmethod
    def load(cls, path: str | os.PathLike) -> RenderedPerformance:
        """Read a performance. Its large arrays are mapped from the file. Raises FileFormatError for a damaged file."""
        data = load_checked(path, checks(cls), _MAX_BYTES, mapped=_MAPPED, mapped_from=_MAPPED_FROM)
        return cls(**by_attribute(cls, path, data))

    @classmethod
    def render(cls, source: str, neutral_frames: int, count: int) -> RenderedPerformance:
        """Render a synthetic source.

        Parameters
        ----------
        source : str
            "synthetic", "synthetic:SEED[:NOISE]..." or "lesson".
        neutral_frames : int
            Number of leading frames with the face at rest.
        count : int
            Number of frames after them.

        Returns
        -------
        RenderedPerformance
            The second half of its performance repeats the first one, except in the lesson.
        """
        from tqdm.auto import tqdm

        sensor, chosen = _performance(source, neutral_frames, count)
        rows: list[list] = [[] for _ in range(7)]
        with one_thread():
            for index in tqdm(chosen, desc="rendering the performance (first time only)", unit="frame"):
                frame, truth = sensor.read(index), sensor.ground_truth(index)
                values = (
                    np.round(frame.depth / _DEPTH_UNIT).astype(np.uint16),
                    frame.colour,
                    frame.seen.confidence,
                    # Checked files contain no NaN. Hidden features have confidence 0 and any position.
                    np.nan_to_num(frame.seen.pixels, nan=-1.0),
                    truth.vertices.astype(np.float32),
                    truth.head_pose,
                    truth.performance,
                )
                for column, value in zip(rows, values, strict=True):
                    column.append(value)
        neutral, c = GroundTruth.of(sensor).neutral if neutral_frames else np.zeros((1, 3)), sensor.camera
        depth, colour, confidence, pixels, vertices, poses = map(np.stack, rows[:6])
        return cls(
            depth=depth,
            colour=colour,
            confidence=confidence,
            pixels=pixels,
            intrinsics=np.array([c.fx, c.fy, c.cx, c.cy]),
            depth_unit=np.array(_DEPTH_UNIT),
            truth_vertices=vertices,
            truth_rigid=poses,
            performance=np.array(rows[6], np.int64),
            truth_neutral=neutral,
        )

    @property
    def camera(self) -> Camera:
        """The camera of the frames."""
        height, width = self.depth.shape[1:]
        fx, fy, cx, cy = map(float, self.intrinsics)
        return Camera(width, height, fx, fy, cx, cy)

    @property
    def truth(self) -> GroundTruth:
        """The truth of all frames."""
        return GroundTruth(self.truth_neutral, self._true_frame, len(self))

    def _true_frame(self, index: int) -> TruthFrame:
        vertices, pose = self.truth_vertices[index].astype(float), self.truth_rigid[index]
        return TruthFrame(vertices, pose, int(self.performance[index]))


class StoredFrames(Sequence[RgbdFrame]):
    """Frames whose depth stays in the sensor's integers until a frame is read, which halves the memory."""

    def __init__(self, data: RenderedPerformance, numbers: range | None = None) -> None:
        self._data, self._camera = data, data.camera
        self._numbers = range(len(data)) if numbers is None else numbers

    def __len__(self) -> int:
        return len(self._numbers)

    def __getitem__(self, which):
        if isinstance(which, slice):
            return StoredFrames(self._data, self._numbers[which])
        data, i = self._data, self._numbers[which]
        confidence, colour = data.confidence[i], np.asarray(data.colour[i])
        features = Features2D(np.where((confidence <= 0)[:, None], np.nan, data.pixels[i]), confidence)
        depth = data.depth[i].astype(np.float32) * np.float32(data.depth_unit)
        return RgbdFrame(depth, self._camera, colour, i, i / 30.0, features)

    def release(self) -> None:
        """Release the memory of the mapped file. Its data are read again when they are needed."""
        for name in _MAPPED:
            release(getattr(self._data, name))

    def __add__(self, other: Sequence[RgbdFrame]) -> list[RgbdFrame]:
        return [*self, *other]


def _performance(source: str, neutral_frames: int, count: int) -> tuple[SyntheticSensor | LessonSensor, Sequence[int]]:
    """The sensor of a synthetic source, and the numbers of the frames to take from it."""
    from ..synthetic.lesson import LessonSensor
    from ..synthetic.look import parse_performer
    from ..synthetic.sensor import SyntheticSensor

    if source == LESSON:
        lesson = LessonSensor(neutral_frames=neutral_frames)
        return lesson, range(min(neutral_frames + count, len(lesson)))
    seed, noise, look = parse_performer(source.partition(":")[2])
    half = max(count // 2, 1)
    # The liveliest window of a script that is three times as long, so that expressions have a natural speed.
    sensor = SyntheticSensor(7 if seed is None else seed, noise or "structured-light", neutral_frames, 3 * half, 2, look=look)
    first = neutral_frames + liveliest_window(sensor.script, half)
    return sensor, [*range(neutral_frames), *range(first, first + half), *range(first + 3 * half, first + 4 * half)]


def liveliest_window(script: np.ndarray, length: int) -> int:
    """First frame of the ``length`` frames of a script (F, E) in which the activations change most."""
    change = np.concatenate([[0.0], np.abs(np.diff(script, axis=0)).sum(axis=1)])
    sums = np.convolve(change, np.ones(length), mode="valid")
    return int(sums.argmax())
