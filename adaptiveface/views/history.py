"""Keep the tracker before every frame of a performance in a twentieth of the memory.

Samples are kept once for all frames, and meshes in single precision: those of the last frame's result are not kept twice.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass, replace

import numpy as np

from ..tracking.adaptive_pca import AdaptiveModel
from ..tracking.base import Tracker
from ..tracking.types import TrackedFrame
from .kept import in_own_pages

_NONE = np.zeros((0, 3))


@dataclass
class _Entry:
    """A tracker without its sample buffer, which held some among the first ``seen`` of the run's samples ``rows``.

    ``v1``, ``v4``: its state's meshes, or the result that has them.
    """

    tracker: Tracker
    v1: np.ndarray | TrackedFrame
    v4: np.ndarray | TrackedFrame
    rows: list[np.ndarray]
    seen: int


class History:
    """``keep`` a tracker before each frame, in order; ``before(index)`` gives it back, None where there is none.

    What is given back must not learn: the sample buffer is shared by all.
    """

    def __init__(self, count: int) -> None:
        self._entries: list[_Entry | None] = [None] * count
        self._given: tuple[_Entry, Tracker] | None = None
        self.start_over()

    def start_over(self) -> None:
        """Another run begins; what is known of the last one stays until its frames come."""
        self._rows: list[np.ndarray] = []
        self._model: AdaptiveModel | None = None

    def keep(self, index: int, tracker: Tracker, last: tuple[TrackedFrame, TrackedFrame] | None) -> None:
        """Keep ``tracker`` as the one before frame ``index``.

        ``last``: what it made of the frame before, and as which result that is kept.
        """
        kept, state = copy.copy(tracker), tracker.state
        meshes = [_mesh(getattr(state, name), name, last) for name in ("v1", "v4")]
        kept.state = replace(state, v1=_NONE, v4=_NONE, deformation=in_own_pages(state.deformation.astype(np.float32)))
        model = tracker.model
        if model.seen != len(self._rows):  # at most one sample per frame
            self._rows.append(in_own_pages(model._samples[model.ages.argmax()]))
            self._model = None
        if self._model is None:
            self._model = copy.copy(model)
            self._model._samples = self._model._correctives = None
        kept.model = self._model
        self._entries[index] = _Entry(kept, *meshes, self._rows, len(self._rows))

    def known(self, index: int) -> bool:
        """Whether there is a tracker before frame ``index``."""
        return self._entries[index] is not None

    def samples(self, index: int) -> int:
        """Number of samples that the tracker before frame ``index`` had seen."""
        return self._entries[index].seen

    def before(self, index: int) -> Tracker | None:
        """The tracker before frame ``index``; the same object when asked again."""
        entry = self._entries[index]
        if entry is None:
            return None
        if self._given is None or self._given[0] is not entry:
            whole = entry.tracker.copy()
            v1, v4 = (getattr(one, name, one).astype(float) for name, one in (("v1", entry.v1), ("v4", entry.v4)))
            whole.state = replace(whole.state, v1=v1, v4=v4, deformation=whole.state.deformation.astype(float))
            whole.model._samples = _buffer(entry, whole.model)
            self._given = entry, whole
        return self._given[1]


def _mesh(mesh: np.ndarray, name: str, last: tuple[TrackedFrame, TrackedFrame] | None) -> np.ndarray | TrackedFrame:
    """The kept result of the last frame if it has this mesh, otherwise a copy in single precision."""
    return last[1] if last is not None and getattr(last[0], name) is mesh else in_own_pages(mesh.astype(np.float32))


def _buffer(entry: _Entry, model: AdaptiveModel) -> np.ndarray:
    """(count, 3n) the sample buffer as it was, in its own order."""
    rows = [entry.rows[number] for number in model.ages[: model.count]]
    return np.array(rows, np.float32).reshape(model.count, len(model.anchors))
