"""Run everything behind a live view: open a sensor, scan the neutral, build the head, and track."""

from __future__ import annotations

import threading
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from os import PathLike

from ..errors import AdaptiveFaceError, TrackingError
from ..model.actor import Actor
from ..parameters import Parameters
from ..runtime.closing import Closing
from ..sensors.catalogue import open_sensor
from ..sensors.live import LiveFrame, LiveSensor
from ..sensors.worker import Worker, packaged
from .feed import FeatureFeed
from .guided import Guidance, GuidedCapture
from .scan import Cancelled, NeutralScan
from .session import LiveResult, LiveSession

#: Longest time that :meth:`LiveRun.close` waits for the current step, s. After that, it ends in the background.
CLOSE_SECONDS = 1.0

#: The states of a run in order. FAILED and CLOSED end the run. In STARTING, the head is built but is not tracked yet.
OPENING, SCANNING, BUILDING, STARTING, TRACKING = "opening", "scanning", "building", "starting", "tracking"
FAILED, CLOSED = "failed", "closed"


class LiveRun(Closing):
    """A sensor and everything behind it. It is a context manager.

    ``state`` is one of the constants above, and ``error`` is the reason for ``FAILED``. During the scan, ``guide`` and
    ``guidance`` describe its progress, and ``frame`` is the newest frame of the sensor. While the head is built, ``progress``
    is the current step and the share of it that is done. After that, ``actor`` is the head, and ``session`` tracks it.

    A view polls these attributes or passes ``watch``. Once tracking begins, the functions that were added with
    :meth:`on_result` receive every result.

    Parameters
    ----------
    sensor : LiveSensor or str
        An open sensor, which stays open after :meth:`close`, or a name for :func:`open_sensor`.
    actor : Actor or path-like, optional
        The rig, or its file. Without it, the run begins with a neutral scan.
    parameters : Parameters, optional
        The parameters of the tracker; :meth:`.Parameters.live` by default.
    seconds : float
        Length of the neutral scan, s.
    detect : bool
        Whether MediaPipe looks for features even if the sensor provides its own.
    watch : callable, optional
        A function that is called with the run at every change until tracking begins. It is called on the run's thread. If it
        raises an exception, the run fails.
    """

    def __init__(
        self,
        sensor: LiveSensor | str,
        actor: Actor | str | PathLike | None = None,
        parameters: Parameters | None = None,
        seconds: float = 10.0,
        detect: bool = False,
        watch: Callable[[LiveRun], None] | None = None,
    ) -> None:
        self._given, self._detect = sensor, detect
        self.name = sensor if isinstance(sensor, str) else sensor.name
        self.actor = Actor.load(actor) if isinstance(actor, (str, PathLike)) else actor
        self._parameters, self.seconds = parameters or Parameters.live(), seconds
        self.sensor: LiveSensor | None = None
        self.feed: FeatureFeed | None = None
        self.session: LiveSession | None = None
        self.error: AdaptiveFaceError | None = None
        self._scan: NeutralScan | None = None
        self._trouble = ""  # the error of a session when it was closed
        self._callbacks: list[Callable[[LiveResult], None]] = []
        self._watch, self._closed = watch, False
        self._lock = threading.RLock()
        self.state = OPENING
        self._start(self._open)

    # ---- for views, on any thread ----------------------------------------------------------------------------------
    @property
    def head(self) -> Actor:
        """The head that is tracked. Raises :class:`TrackingError` while there is none."""
        if self.actor is None:
            raise TrackingError(f"{self.name}: there is no head yet; it is built after the neutral scan")
        return self.actor

    @property
    def colour_only(self) -> bool:
        """Whether the sensor measures no depth.

        Tracking is then less accurate. It uses the average head if no actor is given.
        """
        return self.sensor is not None and self.sensor.colour_only

    @property
    def guide(self) -> GuidedCapture | None:
        """The neutral scan's coverage. It is None before the scan and for sensors without depth."""
        return None if self._scan is None else self._scan.guide

    @property
    def guidance(self) -> Guidance | None:
        """The advice for the person and the gaps of the finished scan. It is None before the first frame."""
        return None if self._scan is None else self._scan.guidance

    @property
    def frame(self) -> LiveFrame | None:
        """The scan's newest frame."""
        return None if self._scan is None else self._scan.frame

    @property
    def progress(self) -> tuple[str, float]:
        """The current step of building the head, and the share of it that is done."""
        return ("", 0.0) if self._scan is None else self._scan.progress

    @property
    def message(self) -> str:
        """A description of the sensor's problem during the scan. It is empty if there is none."""
        return self._trouble if self._scan is None else self._scan.message or self._trouble

    @property
    def parameters(self) -> Parameters:
        """The parameters of the next frame."""
        return self._parameters

    def set_parameters(self, parameters: Parameters) -> None:
        """Track with other parameters from the next frame on."""
        with self._lock:
            if self.session is not None:
                self.session.set_parameters(parameters)
            self._parameters = parameters

    def finish_scan(self) -> None:
        """End the neutral scan and build the head.

        The head is built from the frames so far. If none is usable, it is built from the first usable frame that follows.
        """
        scan = self._scan
        if scan is not None:
            scan.finish()

    def relearn(self) -> None:
        """Scan the neutral face again, and then track with the new head. The call does nothing during a scan.

        Raises
        ------
        TrackingError
            The recording is over. Nothing is changed.
        """
        session = self.session
        if self.state != TRACKING or session is None:
            return
        if session.ended:
            raise TrackingError(f"{self.name}: the recording is over; start it again to scan the neutral anew")
        self._trouble, self._scan = "", None
        self._stop_session()
        self.state = SCANNING
        self._start(partial(self._scan_and_track, session.feed))

    def on_result(self, callback: Callable[[LiveResult], None]) -> Callable[[], None]:
        """Call a function with every result. The calls go on after :meth:`relearn`.

        Parameters
        ----------
        callback : callable
            A function of one :class:`LiveResult`.

        Returns
        -------
        callable
            A function without arguments that removes the callback.
        """
        with self._lock:
            self._callbacks.append(callback)
            if self.session is not None:
                self.session.add_callback(callback)

        def remove() -> None:
            """Stop the calls. Calling this again does nothing."""
            with self._lock:
                if callback in self._callbacks:
                    self._callbacks.remove(callback)
                if self.session is not None:
                    self.session.remove_callback(callback)

        return remove

    def wait(self, timeout: float | None = None) -> bool:
        """Wait until the run tracks.

        Parameters
        ----------
        timeout : float, optional
            Longest time to wait, s. By default, there is no limit.

        Returns
        -------
        bool
            Whether the run tracks.

        Raises
        ------
        AdaptiveFaceError
            The run has failed. The error is the run's own.
        """
        self._worker.join(timeout)
        if self.error is not None:
            raise self.error
        return self.state == TRACKING

    def close(self) -> None:
        """Stop every thread within a few seconds. Calling it again does nothing.

        A sensor that is being opened is closed as soon as its library returns.
        """
        with self._lock:
            self._closed, scan = True, self._scan
        if scan is not None:
            scan.cancel()
        self._worker.join(CLOSE_SECONDS)
        self._release()
        self.state = CLOSED

    # ---- the worker's thread, which ends where the session begins --------------------------------------------------
    def _start(self, work: Callable[[], None]) -> None:
        def body() -> None:
            """Do the work; to be cancelled is no error."""
            with suppress(Cancelled):
                work()

        self._worker = Worker(f"live run {self.name}", body, self._fail, self._wrap, self._ended)
        self._worker.start()

    def _wrap(self, error: Exception) -> AdaptiveFaceError:
        return packaged(error, f"{self.name}: the run failed", AdaptiveFaceError)

    def _ended(self) -> None:
        if self._closed:  # close() may not have waited for this thread
            self._release()

    def _fail(self, error: AdaptiveFaceError) -> None:
        with self._lock:
            if not self._closed:  # after close(), nobody needs the error
                self.error, self.state = error, FAILED

    def _enter(self, state: str) -> None:
        with self._lock:
            if self._closed:
                raise Cancelled
            self.state = state
        self._tell()

    def _tell(self) -> None:
        if self._watch is not None:
            self._watch(self)

    def _open(self) -> None:
        sensor = open_sensor(self._given) if isinstance(self._given, str) else self._given
        with self._lock:
            self.sensor, self.name = sensor, sensor.name
            if self._closed:
                raise Cancelled
            self.feed = feed = FeatureFeed(sensor, always=self._detect)
        if self.actor is None:
            self._scan_and_track(feed)
        else:
            self._track(feed, self.actor)

    def _scan_and_track(self, feed: FeatureFeed) -> None:
        with self._lock:
            self._scan = scan = NeutralScan(feed, self.seconds, self._tell)
        self._enter(SCANNING)
        scan.collect()
        self._enter(BUILDING)
        self.actor = actor = scan.build(self._parameters)
        self._track(feed, actor)

    def _track(self, feed: FeatureFeed, actor: Actor) -> None:
        self._enter(STARTING)
        with self._lock:
            if self._closed:
                raise Cancelled
            self.session = LiveSession(feed, actor, self._parameters, tuple(self._callbacks))
            self.state = TRACKING
        self._tell()

    # ---- ending ----------------------------------------------------------------------------------------------------
    def _stop_session(self) -> None:
        with self._lock:
            session, self.session = self.session, None
        if session is not None:
            try:
                session.close()
            except AdaptiveFaceError as error:
                self._trouble = str(error)

    def _release(self) -> None:
        self._stop_session()
        if self.feed is not None:
            self.feed.close()
        if isinstance(self._given, str) and self.sensor is not None:
            self.sensor.close()


__all__ = ["BUILDING", "CLOSED", "FAILED", "LiveRun", "OPENING", "SCANNING", "STARTING", "TRACKING"]
