"""The tracker before every frame of a performance, in a twentieth of the memory.

Samples are kept once for all frames, and meshes in single precision, shared with the result of the frame before.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass, replace

import numpy as np

from ..tracking.adaptive_pca import AdaptiveModel
from ..tracking.base import Tracker
from ..tracking.types import TrackedFrame

_MESHES = ("v1", "v4", "deformation")


@dataclass
class _Entry:
    """A tracker without its sample buffer, which held the newest among the first ``seen`` of the run's samples ``rows``."""

    tracker: Tracker
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
        self._next, self._model = 0, None

    def keep(self, index: int, tracker: Tracker, last: TrackedFrame | None) -> None:
        """Keep ``tracker`` as the one before frame ``index``; ``last``: the result of the frame before."""
        kept = copy.copy(tracker)
        kept.state = replace(kept.state, **{name: _single(getattr(kept.state, name), name, last) for name in _MESHES})
        model = tracker.model
        if model._next != self._next:  # at most one sample per frame
            self._rows.append(model._samples[self._next].copy())
            self._next = model._next
            self._model = None
        if self._model is None:
            self._model = copy.copy(model)
            self._model._samples = self._model._correctives = None
        kept.model = self._model
        self._entries[index] = _Entry(kept, self._rows, len(self._rows))

    def known(self, index: int) -> bool:
        """Whether there is a tracker before frame ``index``."""
        return self._entries[index] is not None

    def samples(self, index: int) -> int:
        """How many samples the tracker before frame ``index`` had seen."""
        return self._entries[index].seen

    def before(self, index: int) -> Tracker | None:
        """The tracker before frame ``index``; the same object when asked again."""
        entry = self._entries[index]
        if entry is None:
            return None
        if self._given is None or self._given[0] is not entry:
            whole = entry.tracker.copy()
            whole.state = replace(whole.state, **{name: getattr(whole.state, name).astype(float) for name in _MESHES})
            whole.model._samples = _buffer(entry, whole.model)
            self._given = entry, whole
        return self._given[1]


def _single(mesh: np.ndarray, name: str, last: TrackedFrame | None) -> np.ndarray:
    """A mesh in single precision, and that of the last result where it is the same."""
    single = mesh.astype(np.float32)
    known = getattr(last, name, None)
    return known if known is not None and np.array_equal(known, single) else single


def _buffer(entry: _Entry, model: AdaptiveModel) -> np.ndarray:
    """(count, 3n) the sample buffer as it was, in its own order: sample n lies in row n modulo its size."""
    newest, size = entry.seen - 1, model.parameters.S
    rows = [entry.rows[newest - (newest - row) % size] for row in range(model.count)]
    return np.array(rows, np.float32).reshape(model.count, len(model.anchors))
