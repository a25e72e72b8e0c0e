"""Track the newest frame with features in a separate thread, whether or not anything displays the result."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np

from ..errors import AdaptiveFaceError, EndOfRecording, SensorError, SensorTimeoutError, TrackingError
from ..model.actor import Actor
from ..parameters import Parameters
from ..runtime.threads import one_thread
from ..sensors.live import LiveFrame
from ..sensors.worker import POLL_SECONDS, Latest, Worker, failure, packaged
from ..tracking.adaptive_pca import AdaptiveModel
from ..tracking.colour_tracker import make_tracker
from ..tracking.types import TrackedFrame
from .feed import FeatureFeed
from .statistics import LiveStatistics, Meter

#: Longest time that :meth:`LiveSession.close` waits for the current frame, s.
CLOSE_SECONDS = 0.9
#: After this long without a frame (s), the session says so.
SILENCE_SECONDS = 1.0
#: The session ends when the tracker itself fails on so many frames in a row, because it will not recover.
MOST_FAILURES = 30


@dataclass(frozen=True)
class LiveResult:
    """A tracked frame. ``index`` counts the session's results. ``latency_ms`` is the time from arrival to mesh."""

    index: int
    frame: LiveFrame
    tracked: TrackedFrame
    latency_ms: float


OnResult = Callable[[LiveResult], None]


class LiveSession:
    """Tracks the frames of ``feed`` in a separate thread. It is a context manager; feed and sensor stay open.

    The functions ``on_result`` are called with every :class:`LiveResult`, on the tracker's thread. A function that raises an
    error is not called again. The next :meth:`latest` or :meth:`close` raises this error once, and tracking goes on. If the
    sensor is disconnected, :attr:`statistics` reports this, and the session goes on when the sensor is back. ``running`` is
    False once no further result will come. ``ended`` is True if the recording is over. Without ``parameters``, they are
    :meth:`.Parameters.live`.
    """

    def __init__(
        self, feed: FeatureFeed, actor: Actor, parameters: Parameters | None = None, on_result: Iterable[OnResult] = ()
    ) -> None:
        self.feed, self.actor = feed, actor
        self.running, self.ended = True, False
        self._parameters, self._frozen = parameters or Parameters.live(), False
        self._tracker = make_tracker(actor, self._wanted(), feed.sensor.colour_only)
        self._callbacks = tuple(on_result)
        self._results: Latest[LiveResult] = Latest(feed.sensor.name, "session")
        self._changed = self._results.changed
        self._forget_learned = False
        self._count = self._failures = 0
        self._errors: list[AdaptiveFaceError] = []  # not raised yet
        self._fatal: AdaptiveFaceError | None = None
        self._meter = Meter(feed)
        self._worker = Worker(f"tracker {feed.sensor.name}", self._run, self._fail, self._wrap, self._stopped)
        self._worker.start()

    # ---- for readers, on any thread --------------------------------------------------------------------------------
    def latest(self, after: int = -1, timeout: float = 0.0) -> LiveResult | None:
        """Return the newest result, and wait for it if necessary.

        Parameters
        ----------
        after : int
            The index of the result must be larger than this.
        timeout : float
            Longest time to wait, s.

        Returns
        -------
        LiveResult or None
            The result. It is None if none came in time.

        Raises
        ------
        AdaptiveFaceError
            A thread of the session or a callback failed.
        """
        with self._changed:
            self._changed.wait_for(lambda: self._news(after) or not self.running, timeout)
            self._raise_error()
            newest = self._results.newest
            if newest is not None and newest.index > after:
                return newest
            if self._fatal is not None:
                raise self._fatal
            return None

    @property
    def parameters(self) -> Parameters:
        """The parameters of the next frame."""
        return self._parameters

    def set_parameters(self, parameters: Parameters) -> None:
        """Track with other parameters from the next frame on. The head and the learned shapes are kept."""
        with self._changed:
            self._parameters = parameters

    def freeze(self, on: bool) -> None:
        """Stop learning, or learn again with ``on=False``.

        While learning is stopped, the parameters cannot turn it on. The learned shapes stay in use.
        """
        with self._changed:
            self._frozen = bool(on)

    @property
    def frozen(self) -> bool:
        """Whether learning is stopped by :meth:`freeze`."""
        return self._frozen

    def reset_correctives(self) -> None:
        """Forget the correctives and the personal blendshapes before the next frame. The head is kept."""
        with self._changed:
            self._forget_learned = True

    def add_callback(self, callback: OnResult) -> None:
        """Call ``callback`` with every result from the next one on."""
        with self._changed:
            self._callbacks += (callback,)

    def remove_callback(self, callback: OnResult) -> None:
        """Stop calling ``callback``. An unknown one is ignored."""
        with self._changed:
            self._callbacks = tuple(known for known in self._callbacks if known != callback)

    @property
    def model(self) -> AdaptiveModel:
        """The adaptive model. Do not change it. Tracking replaces its arrays and never writes to them."""
        return self._tracker.model

    @property
    def expressions(self) -> np.ndarray | None:
        """The (A, N, 3) expressions that were learned so far, mm. Do not change them.

        The value is None as long as the expressions are those of the actor.
        """
        return self._tracker.expressions

    @property
    def statistics(self) -> LiveStatistics:
        """The rate, the latency, the lost frames and the current message."""
        return self._meter.statistics()

    def close(self) -> None:
        """Stop tracking within a second. Calling this again does nothing.

        Raises
        ------
        AdaptiveFaceError
            The session had an error that was not raised yet.
        """
        self._results.close()
        if self._worker.join(CLOSE_SECONDS):
            with self._changed:
                self._raise_error()

    def __enter__(self) -> LiveSession:
        return self

    def __exit__(self, kind, error, trace) -> None:
        try:
            self.close()
        except AdaptiveFaceError:
            if error is None:  # what ends the block already says what is wrong
                raise

    def _news(self, after: int) -> bool:
        newest = self._results.newest
        return bool(self._errors) or (newest is not None and newest.index > after)

    def _raise_error(self) -> None:
        if self._errors:
            raise self._errors.pop(0)

    def personal_actor(self) -> Actor:
        """Return the actor with the expressions that were learned so far. It can be saved."""
        return self._tracker.personal_actor()

    # ---- the tracker's thread --------------------------------------------------------------------------------------
    def _run(self) -> None:
        with one_thread():
            while not self._results.closed and self._step():
                pass

    @staticmethod
    def _wrap(error: Exception) -> AdaptiveFaceError:
        return packaged(error, "the tracker failed", TrackingError)

    def _stopped(self) -> None:
        self.feed.spare(1)  # nobody predicts features any more
        with self._changed:
            self.running = False
            self._changed.notify_all()

    def _step(self) -> bool:
        """Process one frame. Return False if no other frame will come."""
        try:
            frame = self.feed.read(POLL_SECONDS)
        except EndOfRecording as error:
            self.ended = True
            self._meter.message = str(error)
            return False
        except SensorTimeoutError:
            silence = self._meter.silence
            if silence > SILENCE_SECONDS:
                self._meter.message = f"{self.feed.sensor.name}: no new frame for {silence:.0f} s"
            return True
        except SensorError as error:
            if not self.feed.running or self._results.closed:
                raise
            self._meter.message = str(error)
            return True
        self._apply_changes()
        self._publish(frame, self._track(frame))
        return True

    def _wanted(self) -> Parameters:
        parameters = self._parameters
        return parameters.replace(adaptive_pca__learn=False) if self._frozen else parameters

    def _apply_changes(self) -> None:
        with self._changed:
            forget, self._forget_learned = self._forget_learned, False
            parameters = self._wanted()
        tracker = self._tracker
        if forget:
            tracker.forget_learned()
        if tracker.parameters != parameters:
            try:
                tracker = tracker.with_parameters(parameters)
            except Exception as error:
                self._report(failure(error, "these parameters cannot be used", TrackingError))
                with self._changed:
                    self._parameters = tracker.parameters.replace(adaptive_pca__learn=self._parameters.adaptive_pca.learn)
        self._tracker = tracker

    def _track(self, frame: LiveFrame) -> TrackedFrame:
        try:
            tracked = self._tracker.track(frame)
        except Exception as error:  # a frame that breaks the numerics is lost, but the session goes on
            self._failures += 1
            lost = failure(error, f"frame {frame.index} cannot be tracked", TrackingError)
            if self._failures >= MOST_FAILURES:
                raise lost from error
            self._tracker.forget()
            self.feed.spare(1)
            return self._tracker.untracked(frame, str(lost))
        self._failures = 0
        self.feed.spare(self._tracker.detect_every)
        return tracked

    def _publish(self, frame: LiveFrame, tracked: TrackedFrame) -> None:
        latency = frame.age * 1e3
        result = LiveResult(self._count, frame, tracked, latency)
        self._count += 1
        self._meter.add(result.latency_ms, tracked)
        with self._changed:
            self._results.put(result)
            callbacks = self._callbacks
        for callback in callbacks:
            try:
                callback(result)
            except Exception as error:
                self.remove_callback(callback)
                self._report(packaged(error, "a callback failed", TrackingError))

    def _report(self, error: AdaptiveFaceError) -> None:
        with self._changed:
            self._errors.append(error)
            self._meter.message = str(error)
            self._changed.notify_all()

    def _fail(self, error: AdaptiveFaceError) -> None:
        if self._results.closed and isinstance(error, SensorError):
            return  # the feed was closed first, which loses nothing
        with self._changed:
            self._fatal = error
            self._errors.append(error)
            self._meter.message = str(error)
