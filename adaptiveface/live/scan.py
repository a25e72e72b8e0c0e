"""Scan the neutral face, and make a head from the frames. Without depth, only the proportions of the head are measured.

The scan runs on the caller's thread, without a view. :class:`~adaptiveface.live.run.LiveRun` calls it.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

from ..errors import EndOfRecording, SensorError, SensorTimeoutError, TrackingError
from ..geometry.frame import RgbdFrame
from ..model.actor import Actor
from ..neutral.colour import capture_colour_actor
from ..parameters import Parameters
from ..runtime.threads import one_thread
from ..sensors.live import LiveFrame
from ..sensors.worker import POLL_SECONDS
from ..tracking.colour_tracker import make_tracker
from .feed import FeatureFeed
from .guided import STEPS, Guidance, GuidedCapture

#: After this long without a frame, the scan has a message, s.
SILENCE_SECONDS = 1.0
#: Number of frames with a face from which the proportions are measured without depth.
COLOUR_FRAMES = 30
#: Number of the scan's frames that are tracked before live ones: the first finds the head, the second follows it.
REHEARSED = 2


class Cancelled(Exception):  # noqa: N818 - it was requested, and is not an error
    """The scan was cancelled."""


class NeutralScan:
    """A neutral scan. Call :meth:`collect`, and then :meth:`build`.

    Parameters
    ----------
    feed : FeatureFeed
        The frames with their features.
    seconds : float
        Length of the scan, s.
    watch : callable
        A function without arguments that is called after every frame, message and step of the work.

    Attributes
    ----------
    guidance : Guidance or None
        What to tell the person. It is None before the first frame.
    guide : GuidedCapture or None
        The scan behind the guidance. It is None without depth.
    frame : LiveFrame or None
        The newest frame.
    message : str
        A description of the sensor's problem, or "".
    progress : tuple
        The step of :meth:`build`, and the share of it that is done.
    """

    def __init__(self, feed: FeatureFeed, seconds: float = 10.0, watch: Callable[[], None] = lambda: None) -> None:
        self.feed, self._watch = feed, watch
        self.guide = None if feed.sensor.colour_only else GuidedCapture(seconds)
        self.guidance: Guidance | None = None
        self.frame: LiveFrame | None = None
        self.message, self.progress = "", ("", 0.0)
        self._enough = self._cancelled = False
        self._faces: list[LiveFrame] = []  # the frames that show a face; used without depth
        self._last_frame = time.perf_counter()

    # ---- from any thread -------------------------------------------------------------------------------------------
    def finish(self) -> None:
        """End the scan with the frames so far. If none is usable, it ends with the first usable one that follows."""
        self._enough = True

    def cancel(self) -> None:
        """End :meth:`collect` or :meth:`build` with :class:`Cancelled` after the current step."""
        self._cancelled = True

    # ---- the work --------------------------------------------------------------------------------------------------
    def collect(self) -> None:
        """Read frames until there are enough, or until the recording ends.

        Raises
        ------
        TrackingError
            The recording shows no face.
        SensorError
            The sensor has failed, and does not come back.
        Cancelled
            :meth:`cancel` was called.
        """
        while self.guidance is None or not self.guidance.done:
            self._check()
            try:
                frame = self._read()
            except EndOfRecording:
                self.guidance = self._finished()
            else:
                if frame is not None:
                    self.guidance = self._judged(frame)
            self._watch()

    def build(self, parameters: Parameters) -> Actor:
        """Build the head, and track the last frames of the scan with it. This takes some seconds.

        What is tracked is thrown away. On a machine where the tracker never ran, its functions are compiled here for some
        15 s, and not while the first live frames are lost.

        Parameters
        ----------
        parameters : Parameters
            The parameters of the capture, and of the tracking that follows.

        Returns
        -------
        Actor
            The head.

        Raises
        ------
        TrackingError
            The frames do not show a person's head.
        Cancelled
            :meth:`cancel` was called.
        """
        frames: Sequence[RgbdFrame]
        with one_thread():
            if self.guide is None:
                actor, frames = capture_colour_actor(self._faces, parameters=parameters), self._faces
            else:
                actor, frames = self.guide.build(parameters, self._report), self.guide.frames
            tracker = make_tracker(actor, parameters, self.feed.sensor.colour_only)
            for number, frame in enumerate(frames[-REHEARSED:]):
                self._report("compile", number / REHEARSED)
                tracker.track(frame)
        return actor

    def _check(self) -> None:
        if self._cancelled:
            raise Cancelled

    def _report(self, step: str, share: float) -> None:
        self._check()
        self.progress = (step, share)
        self._watch()

    def _read(self) -> LiveFrame | None:
        """Return the newest frame, or None if there is none at the moment."""
        try:
            frame = self.feed.read(POLL_SECONDS)
        except EndOfRecording:
            raise
        except SensorTimeoutError:
            silence = time.perf_counter() - self._last_frame
            if silence > SILENCE_SECONDS:
                self.message = f"{self.feed.sensor.name}: no new frame for {silence:.0f} s"
            return None
        except SensorError as error:
            if not self.feed.running:
                raise
            self.message = str(error)
            return None
        self.frame, self.message, self._last_frame = frame, "", time.perf_counter()
        return frame

    def _judged(self, frame: LiveFrame) -> Guidance:
        if self.guide is None:
            return self._face_or_not(frame)
        guidance = self.guide.add(frame)
        return self.guide.finish() if self._enough and self.guide.frames else guidance

    def _face_or_not(self, frame: LiveFrame) -> Guidance:
        found = frame.features is not None
        self._faces += [frame] if found else []
        share = len(self._faces) / COLOUR_FRAMES
        done = share >= 1 or (self._enough and bool(self._faces))
        warnings = () if found else ("no face: look at the camera, well lit",)
        return Guidance(STEPS["straight"], "straight", min(share, 1.0), {}, warnings, done)

    def _finished(self) -> Guidance:
        """Go on with the frames so far, because the recording is over."""
        if self.guide is not None:
            return self.guide.finish()
        if not self._faces:
            raise TrackingError(f"{self.feed.sensor.name}: no frame of the recording shows a face")
        return Guidance(STEPS["straight"], "straight", 1.0, {}, (), True)


__all__ = ["COLOUR_FRAMES", "Cancelled", "NeutralScan"]
