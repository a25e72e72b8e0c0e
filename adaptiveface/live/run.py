"""From a sensor's name to a tracked face: open, scan the neutral, build the head, track; one object for any view."""

from __future__ import annotations

import threading
from collections.abc import Callable
from os import PathLike

from ..actor import Actor
from ..errors import AdaptiveFaceError, EndOfRecording, SensorError, SensorTimeoutError
from ..landmarks import FeatureDetector
from ..neutral.colour import capture_colour_actor
from ..parameters import Parameters
from ..sensors.catalogue import open_sensor
from ..sensors.live import LiveFrame, LiveSensor
from .feed import FeatureFeed
from .guided import STEPS, Guidance, GuidedCapture
from .session import LiveResult, LiveSession

#: Longest wait for a frame, s; closing has to stay responsive.
POLL_SECONDS = 0.1
CLOSE_SECONDS = 1.0
#: Frames with a face from which the proportions are taken where there is no depth.
COLOUR_FRAMES = 30

#: What a run is doing.
OPENING, SCANNING, BUILDING, TRACKING, FAILED, CLOSED = "opening", "scanning", "building", "tracking", "failed", "closed"


class LiveRun:
    """A sensor (an open one, or a name for :func:`open_sensor`) and everything behind it; a context manager.

    ``actor``: an :class:`Actor` or its file; without one the neutral scan comes first, ``seconds`` long. ``state`` is one of
    the constants above; ``error`` says why it is ``FAILED``. While scanning, ``guide`` and ``guidance`` tell how far it
    is and ``frame`` is what the sensor saw; while building, ``progress`` is the step and the share done; from then on
    ``session`` tracks. ``detect``: MediaPipe looks for features even where the sensor brings its own. An open sensor
    stays open after :meth:`close`; one that was opened here is closed.
    """

    def __init__(
        self,
        sensor: LiveSensor | str,
        actor: Actor | str | PathLike | None = None,
        parameters: Parameters | None = None,
        seconds: float = 10.0,
        detect: bool = False,
    ) -> None:
        self._given, self._owned, self._detect = sensor, isinstance(sensor, str), detect
        self.name = sensor if self._owned else sensor.name
        self.actor = Actor.load(actor) if isinstance(actor, (str, PathLike)) else actor
        self._parameters, self.seconds = parameters or Parameters(), seconds
        self.sensor: LiveSensor | None = None
        self.feed: FeatureFeed | None = None
        self.session: LiveSession | None = None
        self.guide: GuidedCapture | None = None
        self.guidance: Guidance | None = None
        self.frame: LiveFrame | None = None
        self.error: AdaptiveFaceError | None = None
        self.progress = ("", 0.0)
        self.message = ""
        self._callbacks: list[Callable[[LiveResult], None]] = []
        self._enough = self._closed = False
        self._lock = threading.RLock()
        self.state = OPENING
        self._start(self._open)

    # ---- for views, on any thread ----------------------------------------------------------------------------------
    @property
    def colour_only(self) -> bool:
        """Whether the sensor measures no depth: the degraded mode, on the average head where no actor is given."""
        return self.sensor is not None and self.sensor.colour_only

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
        """Enough of the neutral scan: build from the frames there are (an error is shown while there are none)."""
        self._enough = True

    def relearn(self) -> None:
        """Scan the neutral face again, then go on tracking with the new head. Does nothing where that is going on."""
        if self.state != TRACKING:
            return
        self._stop_session()
        self.state = SCANNING
        self._start(self._scan_and_track)

    def on_result(self, callback: Callable[[LiveResult], None]) -> Callable[[], None]:
        """Call ``callback`` with every result, also after relearning; returns a function that ends this."""
        with self._lock:
            self._callbacks.append(callback)
            if self.session is not None:
                self.session.add_callback(callback)

        def remove() -> None:
            with self._lock:
                if callback in self._callbacks:
                    self._callbacks.remove(callback)
                if self.session is not None:
                    self.session.remove_callback(callback)

        return remove

    def close(self) -> None:
        """Stop every thread, within a few seconds; calling it again does nothing.

        A sensor that is just being opened is closed as soon as its library lets go.
        """
        self._closed = True
        self._thread.join(CLOSE_SECONDS)
        self._stop_session()
        if self.feed is not None:
            self.feed.close()
        if self._owned and self.sensor is not None:
            self.sensor.close()
        self.state = CLOSED

    def __enter__(self) -> LiveRun:
        return self

    def __exit__(self, *_) -> None:
        self.close()

    # ---- the worker's thread, which ends where the session begins --------------------------------------------------
    def _start(self, work: Callable[[], None]) -> None:
        self._thread = threading.Thread(target=self._guarded, args=(work,), name=f"live run {self.name}", daemon=True)
        self._thread.start()

    def _guarded(self, work: Callable[[], None]) -> None:
        try:
            work()
        except AdaptiveFaceError as error:
            self.error = error
        except Exception as error:
            self.error = AdaptiveFaceError(f"{self.name}: {error or type(error).__name__}")
            self.error.__cause__ = error
        if self.error is not None and not self._closed:
            self.state = FAILED

    def _open(self) -> None:
        sensor = open_sensor(self._given) if self._owned else self._given
        if self._closed:
            if self._owned:
                sensor.close()
            return
        self.sensor, self.name = sensor, sensor.name
        self.feed = FeatureFeed(sensor, FeatureDetector(video=True) if self._detect else None)
        if self.actor is None:
            self._scan_and_track()
        else:
            self._track()

    def _scan_and_track(self) -> None:
        if self.colour_only:
            self._proportions_and_track()
            return
        self.guide, self._enough = GuidedCapture(self.seconds), False
        self.guidance = None
        self.state = SCANNING
        while not self.guide.done:
            if self._closed:
                return
            self._scan_one()
        self.state = BUILDING
        self.actor = self.guide.build(self._parameters, self._report)
        self._track()

    def _proportions_and_track(self) -> None:
        """Without depth: the average head, with what the 2D features of some frames tell about its proportions."""
        frames: list[LiveFrame] = []
        self.guide, self._enough, self.state = None, False, SCANNING
        while len(frames) < COLOUR_FRAMES and not (self._enough and frames):
            if self._closed:
                return
            frame = self._read()
            if frame is None:
                continue
            found = frame.features is not None
            frames += [frame] if found else []
            warnings = () if found else ("no face: look at the camera, well lit",)
            text, share = STEPS["straight"], len(frames) / COLOUR_FRAMES
            self.guidance = Guidance(text, "straight", share, {}, warnings, share >= 1)
        self.state = BUILDING
        self.actor = capture_colour_actor(frames, parameters=self._parameters)
        self._track()

    def _read(self) -> LiveFrame | None:
        """The newest frame, or None for a moment without."""
        try:
            frame = self.feed.read(POLL_SECONDS)
        except SensorTimeoutError:
            return None
        except EndOfRecording:
            raise
        except SensorError as error:
            if not self.feed.running:
                raise
            self.message = str(error)
            return None
        self.frame, self.message = frame, ""
        return frame

    def _scan_one(self) -> None:
        try:
            frame = self._read()
        except EndOfRecording:
            self.guidance = self.guide.finish()
            return
        if frame is None:
            return
        self.guidance = self.guide.add(frame)
        if self._enough and self.guide.frames:
            self.guidance = self.guide.finish()

    def _report(self, step: str, share: float) -> None:
        self.progress = (step, share)

    def _track(self) -> None:
        with self._lock:
            if self._closed:  # while the head was built, which close() does not wait for
                return
            self.session = LiveSession(self.feed, self.actor, self._parameters, tuple(self._callbacks))
            self.state = TRACKING

    def _stop_session(self) -> None:
        with self._lock:
            session, self.session = self.session, None
        if session is not None:
            try:
                session.close()
            except AdaptiveFaceError as error:
                self.message = str(error)


__all__ = ["BUILDING", "CLOSED", "FAILED", "LiveRun", "OPENING", "SCANNING", "TRACKING"]
