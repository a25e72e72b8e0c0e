"""Track a performance again whenever parameters change: the shown frame at once, the others in the background."""

from __future__ import annotations

import asyncio
import ctypes
import sys
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from ..geometry.frame import RgbdFrame
from ..model.actor import Actor
from ..parameters import Parameters
from ..studies.rendered import StoredFrames
from ..tracking.adaptive_pca import AdaptiveModel
from ..tracking.base import Tracker
from ..tracking.tracker import FaceTracker
from ..tracking.types import SampleState, TrackedFrame
from .history import History
from .kept import Keeper
from .kernel import BackgroundTask

MakeTracker = Callable[[Actor, Parameters], Tracker]


def give_memory_back(frames: Sequence[RgbdFrame] = ()) -> None:
    """Return memory to the system that tracking has freed and the C library keeps (glibc: about 90 MB after 300 frames).

    The pages of ``frames`` that are mapped from the cache's file are returned as well.
    """
    if isinstance(frames, StoredFrames):
        frames.release()
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None) if sys.platform == "linux" else None
    if trim is not None:
        trim(0)


class Replay:
    """Results of every frame with the current ``parameters``.

    Parameters
    ----------
    frames : sequence of RgbdFrame
        The performance.
    actor : Actor
        The performer's rig.
    parameters : Parameters, optional
        Our defaults without.
    on_result : callable, optional
        ``on_result(index)`` is called for every frame that the background run finishes.
    make_tracker : callable
        ``make_tracker(actor, parameters)`` -> Tracker, for a tracker with other stages.

    Attributes
    ----------
    results : list of TrackedFrame or None
        One result per frame; None until the frame is tracked.
    done : int
        Number of frames that are tracked with the current parameters.
    """

    def __init__(
        self,
        frames: Sequence[RgbdFrame],
        actor: Actor,
        parameters: Parameters | None = None,
        on_result: Callable[[int], None] | None = None,
        make_tracker: MakeTracker = FaceTracker,
    ) -> None:
        self.frames, self.actor, self.make_tracker = frames, actor, make_tracker
        self.parameters = parameters or Parameters()
        self.on_result = on_result or (lambda index: None)
        self.results: list[TrackedFrame | None] = [None] * len(self.frames)
        self.tracker = make_tracker(actor, self.parameters)
        self._keeper, self._history = Keeper(actor), History(len(self.frames))
        self._last: tuple[TrackedFrame, TrackedFrame] | None = None  # the last frame as it was tracked, and as it is kept
        self._made_with: list[Parameters | None] = [None] * len(self.frames)  # the parameters of every result
        self._previewer: tuple[Parameters, Tracker] | None = None  # parameters and tracker of the last preview
        self._task = BackgroundTask()
        #: Frames tracked under the current parameters.
        self.done = 0

    def run(self) -> list[TrackedFrame]:
        """Track every frame now."""
        self._task.stop()
        self._restart(self.parameters)
        while self.done < len(self.frames):
            self._advance()
        give_memory_back(self.frames)
        return [result for result in self.results if result is not None]

    def start(self) -> None:
        """Track every frame in the background."""
        self._task.start(self._run())

    async def finished(self) -> None:
        """Wait for the background run, and raise its error if it failed."""
        await self._task.finished()

    @property
    def busy(self) -> bool:
        """Whether a background run is in progress."""
        return self._task.running

    def close(self) -> None:
        """Stop the background run."""
        self._task.stop()

    def change(self, parameters: Parameters, index: int) -> TrackedFrame:
        """Change the parameters: track frame ``index`` at once, and all frames again in the background.

        If the preview fails, its error is raised and nothing changes.
        """
        result = self.preview(parameters, index)
        self._task.stop()
        self.parameters = parameters
        kept = self._keep(index, result)
        self.start()
        return self.results[index] or kept  # without an event loop, every frame is tracked by now

    def current(self, index: int) -> TrackedFrame | None:
        """The result of frame ``index`` with the current parameters, or None if it was never tracked.

        It is a preview until the background run reaches the frame.
        """
        stale = self.results[index] is not None and self._made_with[index] is not self.parameters
        if self.busy and stale and self._history.known(index):
            self._keep(index, self._quick_preview(index))
        return self.results[index]

    def _quick_preview(self, index: int) -> TrackedFrame:
        """:meth:`preview` with the stages of the last one, whose matrices cost more than a frame."""
        before = self._history.before(index)
        if before is None or self._previewer is None:
            return self.preview(self.parameters, index)
        known, tracker = self._previewer
        if known != self.parameters or len(tracker.state.coefficients) != len(before.state.coefficients):
            return self.preview(self.parameters, index)
        same_filter = before.parameters.kalman == self.parameters.kalman
        tracker = tracker.with_state(before.state if same_filter else replace(before.state, filter=None))
        if before.parameters.adaptive_pca == self.parameters.adaptive_pca:
            tracker.model = before.model
        if tracker.personal is not None and before.personal is not None:
            tracker.personal = before.personal
            tracker.wear_personal()
        return tracker.track(self.frames[index])

    def _keep(self, index: int, result: TrackedFrame) -> TrackedFrame:
        kept = self._keeper.keep(result, self._history.change(index))
        self.results[index], self._made_with[index] = kept, self.parameters
        return kept

    def preview(self, parameters: Parameters, index: int) -> TrackedFrame:
        """Track frame ``index`` with other parameters, starting from the state after the previous frame.

        If the parameters of learning differ, the correctives are learned again from the deformations of the earlier frames.
        All other changes of earlier frames must wait for the background run.
        """
        start = self._history.before(index)
        if start is None:
            return self.make_tracker(self.actor, parameters).track(self.frames[index])
        # The copy shares the buffer of samples, which the background run fills. It tracks one frame and learns nothing.
        tracker = start.with_parameters(parameters.replace(adaptive_pca__learn=False), relearn=False)
        if parameters.adaptive_pca != start.parameters.adaptive_pca:
            tracker.model = self._relearned(tracker, parameters, index)
        self._previewer = parameters, tracker.copy()
        return tracker.track(self.frames[index])

    def _relearned(self, tracker: Tracker, parameters: Parameters, index: int, most: int = 60) -> AdaptiveModel:
        """The model learned from the deformations v2 - v1 of at most ``most`` earlier frames, to answer at once."""
        model = AdaptiveModel(self.actor, tracker.transferred.basis, parameters.adaptive_pca)
        unseen = (SampleState.UNTRACKED, SampleState.HIDDEN)
        samples = [r for r in self.results[:index] if r is not None and r.tracked and r.sample_state not in unseen]
        if parameters.adaptive_pca.learn and samples:
            stride = max(1, -(-len(samples) // most))
            frontal = self.actor.frontal
            model.learn_all(np.array([(r.v2[frontal] - r.v1[frontal]).ravel() for r in samples[::stride]]))
        return model

    def _restart(self, parameters: Parameters) -> None:
        self.parameters, self.done, self._last = parameters, 0, None
        self.tracker = self.make_tracker(self.actor, parameters)
        self._history.start_over()

    def _advance(self) -> None:
        index = self.done
        self._history.keep(index, self.tracker, self._last)
        result = self.tracker.track(self.frames[index])
        self._last = result, self._keep(index, result)
        self.done += 1
        self.on_result(index)

    async def _run(self) -> None:
        # A moving slider starts this again and again, so wait until it rests before the expensive part.
        await asyncio.sleep(0.15)
        self._restart(self.parameters)
        while self.done < len(self.frames):
            self._advance()
            await asyncio.sleep(0.002)
        give_memory_back(self.frames)

    def model_after(self, index: int) -> AdaptiveModel:
        """The adaptive model after frame ``index``. It may be read, but must not learn."""
        following = index + 1
        return self._history.model(following) if following < self.done else self.tracker.model

    def learned_by(self, index: int) -> tuple:
        """A value that changes whenever :meth:`model_after` changes, and is cheap to compare."""
        following, model = index + 1, self.tracker.model
        if following < self.done:
            return self._made_with[index], self._history.samples(following)
        return self._made_with[index], model.updates, model.count, index

    def forget(self) -> None:
        """Go back to the first frame with nothing learned. :meth:`track_up_to` continues from there."""
        self._task.stop()
        self.results = [None] * len(self.frames)
        self._restart(self.parameters)

    def track_up_to(self, index: int) -> None:
        """Track all missing frames up to ``index`` now."""
        while self.done <= index:
            self._advance()

    def series(self, name: str) -> np.ndarray:
        """(F,) values of a quantity of every frame ("anchor_distance", "residual", ...); NaN for frames not tracked yet."""
        return np.array([np.nan if r is None or not r.tracked else getattr(r, name) for r in self.results], float)
