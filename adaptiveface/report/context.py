"""What the sections of the report share."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from ..errors import FrameError
from ..evaluation import PERFORMANCE_NAMES, Evaluation, GroundTruth
from ..geometry.frame import RgbdFrame
from ..model.actor import Actor
from .record import RunRecord

#: Stretches of the source to mark on time axes: (first second, last second, name).
Spans = tuple[tuple[float, float, str], ...]


class Source(Protocol):
    """What frames are read from again."""

    def read(self, index: int) -> RgbdFrame:
        """Frame ``index``. Raises :class:`~adaptiveface.errors.FrameError`."""
        ...


@dataclass(frozen=True)
class Context:
    """The run, its source (or None), the rig, the truth and the evaluation (or None), the time spans to mark."""

    record: RunRecord
    source: Source | None
    actor: Actor
    truth: GroundTruth | None = None
    evaluation: Evaluation | None = None
    spans: Spans = ()

    def frame(self, position: int) -> RgbdFrame | None:
        """The source's frame at a position of the record, or None where it cannot be read."""
        if self.source is None:
            return None
        try:
            return self.source.read(int(self.record.index[position]))
        except FrameError:
            return None

    def frames(self, positions: Iterable[int]) -> list[tuple[int, RgbdFrame]]:
        """(position, frame) of those that can be read."""
        read = ((position, self.frame(position)) for position in positions)
        return [(position, frame) for position, frame in read if frame is not None]

    @property
    def scored_times(self) -> np.ndarray:
        """(F,) seconds of the scored frames."""
        assert self.evaluation is not None  # only charts of errors ask
        return scored_times(self.record, self.evaluation)


def scored_times(record: RunRecord, evaluation: Evaluation) -> np.ndarray:
    """(F,) seconds of the frames that an evaluation scored."""
    position = {int(index): k for k, index in enumerate(record.index)}
    return np.array([record.timestamps[position[int(index)]] for index in evaluation.index])


def time_spans(record: RunRecord, evaluation: Evaluation | None) -> Spans:
    """First and last second of the neutral, the first performance and the repeat, as far as they were scored."""
    if evaluation is None:
        return ()
    times, spans = scored_times(record, evaluation), []
    for number in dict.fromkeys(evaluation.performance.tolist()):
        part = times[evaluation.performance == number]
        spans.append((float(part[0]), float(part[-1]), PERFORMANCE_NAMES.get(number, str(number))))
    return tuple(spans)
