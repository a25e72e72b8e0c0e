"""Hold the data that the sections of the report share."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from ..errors import FrameError
from ..evaluation import PERFORMANCE_NAMES, Evaluation, GroundTruth
from ..geometry.frame import RgbdFrame
from ..model.actor import Actor
from ..parameters import Parameters
from ..result import Result

#: Parts of the source to mark on time axes, each with its first second, its last second and its name.
Spans = tuple[tuple[float, float, str], ...]


class Source(Protocol):
    """A source from which frames can be read again."""

    def read(self, index: int) -> RgbdFrame:
        """Return frame ``index``. Raises :class:`~adaptiveface.errors.FrameError`."""
        ...


@dataclass(frozen=True)
class Context:
    """The run with its parameters and rig. Source, truth and evaluation may be None."""

    result: Result
    parameters: Parameters
    source: Source | None
    actor: Actor
    truth: GroundTruth | None = None
    evaluation: Evaluation | None = None

    def frames(self, numbers: Iterable[int]) -> list[tuple[int, RgbdFrame]]:
        """Return number and frame of those among ``numbers`` that can be read."""
        read = ((number, self._frame(number)) for number in numbers)
        return [(number, frame) for number, frame in read if frame is not None]

    def _frame(self, number: int) -> RgbdFrame | None:
        if self.source is None:
            return None
        try:
            return self.source.read(number)
        except FrameError:
            return None

    def initial_vertices(self, number: int) -> np.ndarray:
        """Return v1 = b0 + B x of a frame in the camera frame, (N, 3) mm, as it was kept or from the initial coefficients."""
        if self.result.v1 is not None:
            return self.result.v1[number].astype(float)
        x, pose = self.result.coefficients_initial[number], self.result.head_pose[number]
        head = self.actor.neutral + np.tensordot(x, self.actor.blendshapes[: len(x)], axes=1)
        return head @ pose[:3, :3].T + pose[:3, 3]

    @property
    def scored_times(self) -> np.ndarray:
        """The times (F,) of the scored frames, s."""
        assert self.evaluation is not None  # only charts of errors use it
        return self.result.timestamps[self.evaluation.index]

    @property
    def spans(self) -> Spans:
        """First and last second of each scored part: the neutral, the first performance and the repeat."""
        if self.evaluation is None:
            return ()
        times, spans = self.scored_times, []
        for number in dict.fromkeys(self.evaluation.performance.tolist()):
            part = times[self.evaluation.performance == number]
            spans.append((float(part[0]), float(part[-1]), PERFORMANCE_NAMES.get(number, str(number))))
        return tuple(spans)
