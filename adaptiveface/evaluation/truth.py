"""Read the truth from a synthetic sensor, or from the ``ground_truth.npz`` of a synthetic recording."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Protocol, TypeAlias, runtime_checkable

import numpy as np

from ..errors import FileFormatError
from ..files.records import array, read, record
from ..geometry.mesh import transform_points
from ..geometry.source import Abilities
from ..renamed import renamed, warn
from ..synthetic.sensor import SyntheticSensor

#: The parts of a take: the neutral scan, the first performance of the script, and its repeat.
NEUTRAL, FIRST, REPEAT = -1, 0, 1
PERFORMANCE_NAMES = {NEUTRAL: "neutral", FIRST: "first", REPEAT: "repeat"}
#: Largest size of a file's arrays, bytes.
_MAX_BYTES = 2 << 30


class TrueValues(Protocol):
    """What a source knows about one of its frames. :class:`TruthFrame` describes the attributes."""

    @property
    def vertices(self) -> np.ndarray:
        """The (V, 3) true head in the camera frame, mm."""

    @property
    def head_pose(self) -> np.ndarray:
        """The (4, 4) transform from the head frame to the camera frame, mm."""

    @property
    def performance(self) -> int:
        """A number of ``PERFORMANCE_NAMES``."""


@runtime_checkable
class TrueSource(Protocol):
    """A source that knows the truth of its frames, as the synthetic sensor does."""

    def __len__(self) -> int:
        """Return the number of frames."""

    def ground_truth(self, index: int, /) -> TrueValues:
        """Return the truth of frame ``index`` (0-based)."""


@renamed
@dataclass(frozen=True)
class TruthFrame:
    """The truth of one frame.

    Attributes
    ----------
    vertices : (V, 3)
        The true head in the camera frame, mm.
    head_pose : (4, 4)
        Head frame to camera frame, mm.
    performance : int
        A number of ``PERFORMANCE_NAMES``.
    """

    vertices: np.ndarray
    head_pose: np.ndarray
    performance: int


@record
@dataclass(frozen=True)
class StoredTruth:
    """The contents of ``ground_truth.npz`` that scores are computed from, for F frames of V vertices."""

    vertices: np.ndarray = array("F V 3", doc="true heads in the camera frame", unit="mm")
    head_pose: np.ndarray = array("F 4 4", doc="head frame to camera frame", unit="mm", name="rigid")
    performance: np.ndarray = array("F", "i1", "-1 in the neutral scan, 0 in the first performance, 1 in its repeat")
    neutral: np.ndarray | None = array("V 3", doc="true neutral in the head frame", unit="mm", optional=True, default=None)

    def __len__(self) -> int:
        return len(self.performance)

    def frame(self, index: int) -> TruthFrame:
        """Return the truth of frame ``index`` (0-based) in double precision."""
        pose = self.head_pose[index].astype(float)
        return TruthFrame(self.vertices[index].astype(float), pose, int(self.performance[index]))


@dataclass(frozen=True)
class GroundTruth:
    """The truth of every frame of a source.

    Attributes
    ----------
    neutral : (V, 3)
        The true neutral in the true head frame, mm.
    read : callable
        Returns the :class:`TruthFrame` of a frame by its number.
    n_frames : int
        Number of frames.
    """

    neutral: np.ndarray
    read: Callable[[int], TruthFrame] = field(repr=False)
    n_frames: int = 0

    def __len__(self) -> int:
        return self.n_frames

    def __getitem__(self, index: int) -> TruthFrame:
        return self.read(index)

    @classmethod
    def of(cls, source: AnyTruth) -> GroundTruth:
        """Return the truth that something holds.

        Parameters
        ----------
        source : GroundTruth, TrueSource or path-like
            A source with ``ground_truth(index)``, the path of a ``ground_truth.npz``, or a ``GroundTruth``, which is returned
            itself.

        Returns
        -------
        GroundTruth
            The truth. Its neutral is the one of the synthetic performer or of the file. If there is none, it is the mean of the
            first neutral frames.

        Raises
        ------
        FileFormatError
            The file cannot be read, or the source has neither a neutral nor neutral frames at its beginning.
        """
        if isinstance(source, cls):
            return source
        if isinstance(source, (str, os.PathLike)):
            return cls.load(source)
        if not isinstance(source, TrueSource):
            raise TypeError(f"{source!r}: a source with ground_truth(index), or the path of a ground_truth.npz, is expected")
        known = source

        def read_frame(index: int) -> TruthFrame:
            truth = known.ground_truth(index)
            return TruthFrame(np.asarray(truth.vertices, float), np.asarray(_pose_of(truth), float), int(truth.performance))

        if isinstance(source, SyntheticSensor):
            neutral = np.asarray(source.performer.neutral, float)
        else:
            neutral = _mean_neutral(read_frame, len(source))
        return cls(neutral, read_frame, len(source))

    @classmethod
    def load(cls, path: str | os.PathLike) -> GroundTruth:
        """Read a ``ground_truth.npz``.

        Parameters
        ----------
        path : path-like
            The file. :class:`StoredTruth` describes it.

        Returns
        -------
        GroundTruth
            The truth of the file's frames.

        Raises
        ------
        FileFormatError
            The file cannot be read. The message names the file and the array.
        """
        stored = StoredTruth(**read(StoredTruth, path, _MAX_BYTES))
        if stored.neutral is not None:
            neutral = stored.neutral.astype(float)
        else:
            neutral = _mean_neutral(stored.frame, len(stored), path)
        return cls(neutral, stored.frame, len(stored))


#: What :meth:`GroundTruth.of` takes.
AnyTruth: TypeAlias = GroundTruth | TrueSource | str | os.PathLike


def _pose_of(truth: TrueValues) -> np.ndarray:
    """The pose of a frame's truth, also of a user's class that still has the old name for it."""
    try:
        return truth.head_pose
    except AttributeError:
        pose: np.ndarray = truth.rigid  # type: ignore[attr-defined]  # the name in the last version
        warn("rigid of a frame's truth", "head_pose")
        return pose


def _mean_neutral(
    read: Callable[[int], TruthFrame], n_frames: int, path: str | os.PathLike = "the source", most: int = 10
) -> np.ndarray:
    """Return the (V, 3) mean of the first neutral frames, turned into the head frame, mm."""
    heads: list[np.ndarray] = []
    for index in range(n_frames):
        frame = read(index)
        if frame.performance != NEUTRAL or len(heads) == most:
            break
        heads.append(transform_points(np.linalg.inv(frame.head_pose), frame.vertices))
    if not heads:
        raise FileFormatError(f"{path}: the truth begins with no neutral frame (performance -1) and has no 'neutral'")
    mean: np.ndarray = np.mean(heads, axis=0)
    return mean


def truth_of(source: object) -> AnyTruth | None:
    """Find the truth of a source.

    Parameters
    ----------
    source : FrameSource
        The source.

    Returns
    -------
    TrueSource, Path or None
        The source itself if it knows the truth, or else the ``ground_truth.npz`` in its folder. None if there is neither.
    """
    if isinstance(source, TrueSource):
        return source
    folder = Abilities.of(source).path
    recorded = None if folder is None else folder / "ground_truth.npz"
    return recorded if recorded is not None and recorded.is_file() else None
