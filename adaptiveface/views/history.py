"""Keep the tracker before every frame of a performance in a twentieth of the memory.

Samples are kept once for all frames, personal blendshapes once for all between two updates, and meshes in single precision:
what the last frame's result has is not kept twice.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass, replace

import numpy as np

from ..tracking.adaptive_pca import AdaptiveModel
from ..tracking.base import Tracker
from ..tracking.personal_blendshapes import PersonalBlendshapes
from ..tracking.types import TrackedFrame
from .kept import in_own_pages

_NONE = np.zeros((0, 3))
_MESHES = ("v1", "v4", "deformation")


@dataclass
class _Entry:
    """A tracker without its sample buffer, which held some among the first ``seen`` of the run's samples ``rows``.

    Its fit is that of the transferred expressions; ``before`` adds the personal ones. ``last`` is the result that has the
    state's meshes and displacement, or None where the tracker's state has them itself.
    """

    tracker: Tracker
    last: TrackedFrame | None
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
        self._personal: PersonalBlendshapes | None = None

    def keep(self, index: int, tracker: Tracker, last: tuple[TrackedFrame, TrackedFrame] | None) -> None:
        """Keep ``tracker`` as the one before frame ``index``.

        ``last``: what it made of the frame before, and as which result that is kept.
        """
        kept, state = copy.copy(tracker), tracker.state
        follows = last is not None and last[0].v1 is state.v1 and last[0].v4 is state.v4
        meshes = dict.fromkeys(_MESHES, _NONE) if follows else {name: _single(getattr(state, name)) for name in _MESHES}
        kept.state = replace(state, **meshes)
        kept.blendshapes, kept.personal = tracker.transferred, self._remembered(tracker.personal)
        model = tracker.model
        if model.seen != len(self._rows):  # at most one sample per frame
            self._rows.append(in_own_pages(model._samples[model.ages.argmax()]))
            self._model = None
        if self._model is None:
            self._model = copy.copy(model)
            self._model._samples, self._model._correctives = model._samples[:0].copy(), None
        kept.model = self._model
        self._entries[index] = _Entry(kept, last[1] if last is not None and follows else None, self._rows, len(self._rows))

    def _remembered(self, personal: PersonalBlendshapes | None) -> PersonalBlendshapes | None:
        """The expressions as they are now, one object until the next update."""
        if personal is None or self._personal is None or personal.updates != self._personal.updates:
            self._personal = None if personal is None else personal.remembered(in_own_pages)
        return self._personal

    def known(self, index: int) -> bool:
        """Whether there is a tracker before frame ``index``."""
        return self._entries[index] is not None

    def samples(self, index: int) -> int:
        """Number of samples that the tracker before frame ``index`` had seen."""
        return self._entry(index).seen

    def before(self, index: int) -> Tracker | None:
        """The tracker before frame ``index``; the same object when asked again."""
        entry = self._entries[index]
        if entry is None:
            return None
        tracker = self._whole(entry)
        if tracker.expressions is None:
            tracker.wear_personal()
        return tracker

    def model(self, index: int) -> AdaptiveModel:
        """The adaptive model of :meth:`before`, without making its fit anew. There must be a tracker."""
        return self._whole(self._entry(index)).model

    def change(self, index: int) -> np.ndarray | None:
        """(A, n, 3) mm by which the expressions before frame ``index`` differ from the transferred ones, or None."""
        entry = self._entries[index]
        personal = None if entry is None else entry.tracker.personal
        return personal.change if personal is not None and personal.updates else None

    def _entry(self, index: int) -> _Entry:
        entry = self._entries[index]
        if entry is None:
            raise KeyError(f"no tracker is kept before frame {index}")
        return entry

    def _whole(self, entry: _Entry) -> Tracker:
        if self._given is None or self._given[0] is not entry:
            whole = entry.tracker.copy()
            state, last = whole.state, entry.last
            if last is None:
                meshes = {name: getattr(state, name).astype(float) for name in _MESHES}
            else:
                v1, v2, v4 = (getattr(last, name).astype(float) for name in ("v1", "v2", "v4"))
                meshes = {"v1": v1, "v4": v4, "deformation": (v2 - v1)[whole.actor.frontal]}
            whole.state = replace(state, **meshes)
            whole.model._samples = _buffer(entry, whole.model)
            self._given = entry, whole
        return self._given[1]


def _single(mesh: np.ndarray) -> np.ndarray:
    return in_own_pages(mesh.astype(np.float32))


def _buffer(entry: _Entry, model: AdaptiveModel) -> np.ndarray:
    """(count, 3n) the sample buffer as it was, in its own order."""
    rows = [entry.rows[number] for number in model.ages[: model.count]]
    return np.array(rows, np.float32).reshape(model.count, len(model.anchors))
