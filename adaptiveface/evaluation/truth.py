"""Read the truth from a synthetic sensor, or from the ``ground_truth.npz`` of a synthetic recording."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ..errors import FileFormatError
from ..files.npz import Field, load_checked
from ..geometry.mesh import transform_points
from ..renamed import renamed

#: The parts of a take: the neutral scan, the first performance of the script, and its repeat.
NEUTRAL, FIRST, REPEAT = -1, 0, 1
PERFORMANCE_NAMES = {NEUTRAL: "neutral", FIRST: "first", REPEAT: "repeat"}

_FIELDS = {
    "vertices": Field(("F", "V", 3)),
    "rigid": Field(("F", 4, 4)),
    "performance": Field(("F",), "iu"),
    "neutral": Field(("V", 3), optional=True),
}


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


@dataclass(frozen=True)
class GroundTruth:
    """The truth of every frame of a source. ``neutral`` (V, 3) is the true neutral in the true head frame, mm."""

    neutral: np.ndarray
    read: Callable[[int], TruthFrame] = field(repr=False)
    n_frames: int = 0

    def __len__(self) -> int:
        return self.n_frames

    def __getitem__(self, index: int) -> TruthFrame:
        return self.read(index)

    @classmethod
    def of(cls, source) -> GroundTruth:
        """Return the truth of a sensor with ``ground_truth(i)``, of a ``ground_truth.npz``, or a ``GroundTruth`` itself."""
        if isinstance(source, cls):
            return source
        if isinstance(source, (str, os.PathLike)):
            return cls.load(source)

        def read(index: int) -> TruthFrame:
            truth = source.ground_truth(index)
            pose = truth.head_pose if hasattr(truth, "head_pose") else truth.rigid  # an own class, written before
            return TruthFrame(np.asarray(truth.vertices, float), np.asarray(pose, float), int(truth.performance))

        # A synthetic performer knows its neutral. Any other source shows it in its first frames.
        neutral = getattr(getattr(source, "performer", None), "neutral", None)
        neutral = _mean_neutral(read, len(source)) if neutral is None else np.asarray(neutral, float)
        return cls(neutral, read, len(source))

    @classmethod
    def load(cls, path: str | os.PathLike) -> GroundTruth:
        """Read ``ground_truth.npz``; raises :class:`FileFormatError` naming the file and the array."""
        data = load_checked(path, _FIELDS, max_bytes=2 << 30)

        def read(index: int) -> TruthFrame:
            vertices, rigid = data["vertices"][index].astype(float), data["rigid"][index].astype(float)
            return TruthFrame(vertices, rigid, int(data["performance"][index]))

        n_frames = len(data["performance"])
        neutral = data["neutral"].astype(float) if "neutral" in data else _mean_neutral(read, n_frames, path)
        return cls(neutral, read, n_frames)


def _mean_neutral(read: Callable[[int], TruthFrame], n_frames: int, path="the source", most: int = 10) -> np.ndarray:
    """Mean (V, 3) of the first neutral frames, turned into the head frame, mm."""
    heads: list[np.ndarray] = []
    for index in range(n_frames):
        frame = read(index)
        if frame.performance != NEUTRAL or len(heads) == most:
            break
        heads.append(transform_points(np.linalg.inv(frame.head_pose), frame.vertices))
    if not heads:
        raise FileFormatError(f"{path}: the truth begins with no neutral frame (performance -1) and has no 'neutral'")
    return np.mean(heads, axis=0)


def truth_of(source):
    """Find the truth of a source: the source itself, the ``ground_truth.npz`` in its folder, or None."""
    if hasattr(source, "ground_truth"):
        return source
    path = getattr(source, "path", None)
    recorded = None if path is None else Path(path) / "ground_truth.npz"
    return recorded if recorded is not None and recorded.is_file() else None
