"""The tracker before every frame of a performance, in a twentieth of the memory.

Correctives are kept as mixes of the samples that they were learned from, and meshes in single precision, shared with the
result of the frame before.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..tracking.base import Tracker
from ..tracking.types import TrackedFrame

_MESHES = ("v1", "v4", "deformation")


@dataclass
class _Entry:
    """A tracker without its correctives, which ``mix`` (s, k) makes of the newest samples among the first ``seen`` ``rows``.

    ``rows``: all samples of that run, in their order. ``mix`` is None where the tracker has its correctives.
    """

    tracker: Tracker
    mix: np.ndarray | None
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
        self._next, self._newest = 0, None

    def keep(self, index: int, tracker: Tracker, last: TrackedFrame | None) -> None:
        """Keep ``tracker`` as the one before frame ``index``; ``last``: the result of the frame before."""
        kept = tracker.copy()
        model = kept.model
        kept.state = replace(kept.state, **{name: _single(getattr(kept.state, name), name, last) for name in _MESHES})
        if model._next != self._next:  # at most one sample per frame
            self._rows.append(model._samples[self._next].copy())
            self._next = model._next
        newest = self._newest
        if newest is not None and newest[0] is model.correctives:  # nothing was learned since
            kept.model = newest[1].tracker.model
            entry = _Entry(kept, newest[1].mix, newest[1].rows, newest[1].seen)
        else:
            entry = _Entry(kept, model.mix, self._rows, len(self._rows))
            self._newest = model.correctives, entry
            if model.mix is not None:
                del model.correctives
        self._entries[index] = entry

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
            if entry.mix is not None:
                whole.model.correctives = whole.model.combined(entry.mix, _buffer(entry, whole.model.parameters.S))[0]
            self._given = entry, whole
        return self._given[1]


def _single(mesh: np.ndarray, name: str, last: TrackedFrame | None) -> np.ndarray:
    """A mesh in single precision, and that of the last result where it is the same."""
    single = mesh.astype(np.float32)
    known = getattr(last, name, None)
    return known if known is not None and np.array_equal(known, single) else single


def _buffer(entry: _Entry, size: int) -> np.ndarray:
    """(s, 3n) the sample buffer as it was, in its own order: sample n lies in row n modulo its size."""
    newest = entry.seen - 1
    return np.stack([entry.rows[newest - (newest - row) % size] for row in range(len(entry.mix))])
