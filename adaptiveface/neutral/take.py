"""Read, judge and choose the frames of a recording from which the neutral is captured."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence, Sized
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from ..geometry.frame import Features2D, RgbdFrame
from .choice import LOOK, Judged, choose, costs, doubts, judge, leading_is_calm

#: Smallest number of valid features at which a face counts as found.
MIN_FEATURES = 6
#: Says how to name the frames.
WAY_OUT = "--neutral-frames FIRST:LAST takes others"
Step = Callable[[], object]


class Reader(Protocol):
    """A reader of frames, such as :class:`~adaptiveface.pipeline.FrameReader`."""

    @property
    def source(self) -> Sized:
        """Number of frames, including broken ones."""

    def read(self, index: int) -> RgbdFrame | None:
        """Return frame ``index`` with its features, or None if it cannot be used."""

    def again(self, index: int, features: Features2D) -> RgbdFrame:
        """Return frame ``index``, which was read before, with the features that it had."""


def face_found(frame: RgbdFrame) -> bool:
    """Whether enough 2D features are visible to count as a face."""
    return frame.features is not None and int(frame.features.valid.sum()) >= MIN_FEATURES


@dataclass(frozen=True)
class NeutralTake:
    """The ``frames`` of the neutral face, a ``note`` about doubts or "", and whether they are the ``leading`` ones."""

    frames: list[RgbdFrame]
    note: str = ""
    leading: bool = False


def neutral_of(
    reader: Reader, wanted: int | range | None, points: np.ndarray, most: int, step: Step = lambda: None
) -> NeutralTake:
    """Choose the neutral frames of a source.

    Parameters
    ----------
    reader : Reader
        Reads the source's frames.
    wanted : int, range or None
        Number of leading frames with a face, or the numbers of the frames. None takes all, but at most ``most``, spread evenly.
    points : (40, 3)
        The model's features, mm.
    most : int
        Largest number of frames if ``wanted`` is None.
    step : callable
        Called for every frame that is taken.

    Returns
    -------
    NeutralTake
        The frames, and what is doubtful about them.
    """
    length = len(reader.source)
    if wanted is None:
        return _all_or_calm(_read(reader, range(0, length, max(1, math.ceil(length / most))), step), points)
    if not isinstance(wanted, range):
        return _leading(reader, int(wanted), points, step)
    named = _read(reader, [number for number in wanted if 0 <= number < length], step)
    faces = [frame for frame in named if face_found(frame)]
    trouble = doubts([judge(frame, points) for frame in faces])
    return NeutralTake(faces, f"the neutral frames are doubtful: of {len(faces)}, {trouble}" if trouble else "")


def _read(reader: Reader, numbers: Sequence[int], step: Step) -> list[RgbdFrame]:
    frames = []
    for index in numbers:
        frame = reader.read(index)
        if frame is not None:
            frames.append(frame)
            step()
    return frames


def _leading(reader: Reader, count: int, points: np.ndarray, step: Step) -> NeutralTake:
    """Choose the first ``count`` frames with a face, or calmer ones among the first ``LOOK``. Only the former are kept."""
    kept: list[RgbdFrame] = []
    found: list[tuple[int, Features2D]] = []
    judged: list[Judged | None] = []
    for index in range(len(reader.source)):
        if len(found) >= max(count, LOOK) or (len(found) >= count and index > found[count - 1][0] + 2 * LOOK):
            break
        frame = reader.read(index)
        if frame is None or not face_found(frame):
            continue
        found.append((index, frame.seen))
        judged.append(judge(frame, points))
        if len(found) <= count:
            kept.append(frame)
            step()
        if len(found) == count and leading_is_calm(costs(judged), judged):
            return NeutralTake(kept, leading=True)
    choice = choose(judged, count)
    numbers = [found[k][0] for k in choice.picked]
    leading = choice.picked == list(range(len(kept)))
    note = f"{choice.note}; {WAY_OUT}" if choice.note else ""
    if note and not leading:
        note = f"{choice.note}; {len(numbers)} of the frames {numbers[0]} to {numbers[-1]} are the neutral instead; {WAY_OUT}"
    frames = [kept[k] if k < len(kept) else reader.again(*found[k]) for k in choice.picked]
    return NeutralTake(frames, note, leading)


def _all_or_calm(frames: list[RgbdFrame], points: np.ndarray) -> NeutralTake:
    """Choose the frames of a whole recording. If it has many frames, those that talk or laugh are left out."""
    faces = [frame for frame in frames if face_found(frame)]
    judged = [judge(frame, points) for frame in faces]
    trouble = doubts(judged, turned=False)
    if not trouble:
        return NeutralTake(frames)
    moving = np.array([cost[2:].max() >= 1 for cost in costs(judged)])
    if (~moving).sum() < max(3, len(faces) // 8):
        return NeutralTake(frames, f"the neutral frames are doubtful: of {len(faces)}, {trouble}; {WAY_OUT}")
    out = {id(frame) for frame, moves in zip(faces, moving, strict=True) if moves}
    calm = [frame for frame in frames if id(frame) not in out]
    return NeutralTake(calm, f"of {len(faces)} frames with a face, {trouble}; these are left out of the neutral")
