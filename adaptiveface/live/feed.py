"""The feature thread: the sensor's newest frame goes through the detector and comes out with its own features."""

from __future__ import annotations

import threading
import time
from collections import deque

import numpy as np

from ..errors import (
    AdaptiveFaceError,
    FeatureDetectionError,
    SensorDisconnectedError,
    SensorError,
    SensorTimeoutError,
)
from ..landmarks import FeatureDetector, Upright
from ..sensors.live import LiveFrame, LiveSensor

#: Longest wait for the sensor, s: closing has to stay responsive.
POLL_SECONDS = 0.1
#: Longest :meth:`FeatureFeed.close` waits, s. Loading the detector takes longer and then ends in the background.
CLOSE_SECONDS = 0.9


class FeatureFeed:
    """Frames of ``sensor`` with 2D features, found in a thread of its own; a context manager. The sensor stays open.

    Frames that bring features pass unchanged, unless a ``detector`` is given or ``always`` is set: then every colour image
    is searched. Where no detector is given one is made for the first frame that needs it, and closed at the end. A
    recording waits until its frames are read.

    ``dropped``: frames whose features were found but which a newer one replaced before they were read. What the
    detector was too slow for is counted by the sensor (``superseded``). ``detect_ms``: median time of the last
    detections, 0 without any. ``running``: False once nothing more will come.
    """

    def __init__(self, sensor: LiveSensor, detector: FeatureDetector | None = None, always: bool = False) -> None:
        self.sensor, self.dropped, self.running = sensor, 0, True
        self._detector, self._always = detector, always or detector is not None
        self._own_detector: FeatureDetector | None = None
        self._upright: Upright | None = None
        self._changed = threading.Condition()
        self._frame: LiveFrame | None = None
        self._trouble: SensorError | None = None  # what the sensor reports since its last frame
        self._said = self._closed = False
        self._error: AdaptiveFaceError | None = None  # ends the feed
        self._detect_ms: deque[float] = deque(maxlen=30)
        self._thread = threading.Thread(target=self._run, name=f"features {sensor.name}", daemon=True)
        self._thread.start()

    @property
    def detect_ms(self) -> float:
        """Median time of the last 30 detections, ms; 0 where none was needed."""
        return float(np.median(list(self._detect_ms))) if self._detect_ms else 0.0

    def read(self, timeout: float = 1.0) -> LiveFrame:
        """The newest frame that was not read yet, with its features, waiting up to ``timeout`` s for it.

        Raises :class:`SensorDisconnectedError` (once at once, then whenever ``timeout`` passes without a sensor),
        :class:`SensorTimeoutError`, :class:`EndOfRecording`, or what the sensor or the detector failed with.
        """
        deadline = time.perf_counter() + timeout
        with self._changed:
            while True:
                if self._closed:
                    raise SensorError(f"{self.sensor.name}: the feed is closed")
                frame = self._take()
                if frame is not None:
                    return frame
                if self._error is not None:
                    raise self._error
                gone = isinstance(self._trouble, SensorDisconnectedError)
                if gone and not self._said:
                    self._said = True
                    raise self._trouble
                left = deadline - time.perf_counter()
                if left <= 0:
                    text = f"{self.sensor.name}: no new frame within {timeout:g} s"
                    raise self._trouble if gone else SensorTimeoutError(text)
                self._changed.wait(left)

    def close(self) -> None:
        """Stop the thread, within a second; calling it again does nothing. The sensor is left open."""
        with self._changed:
            self._closed, self._frame = True, None
            self._changed.notify_all()
        if threading.current_thread() is not self._thread:
            self._thread.join(CLOSE_SECONDS)

    def __enter__(self) -> FeatureFeed:
        return self

    def __exit__(self, *_) -> None:
        self.close()

    def _take(self) -> LiveFrame | None:
        frame, self._frame = self._frame, None
        if frame is None:
            return None
        self._changed.notify_all()  # a recording goes on
        if self.sensor.live and frame.age > self.sensor.max_age:
            self.dropped += 1
            return None
        return frame

    # ---- the feature thread ----------------------------------------------------------------------------------------
    def _run(self) -> None:
        try:
            while not self._closed:
                self._step()
        except AdaptiveFaceError as error:
            self._end(error)
        except Exception as error:  # whatever the detector's library raises ends here
            reason = str(error) or type(error).__name__
            failure = FeatureDetectionError(f"{self.sensor.name}: the feature detector failed ({reason})")
            failure.__cause__ = error
            self._end(failure)
        finally:
            self.running = False
            if self._own_detector is not None:
                self._own_detector.close()

    def _step(self) -> None:
        try:
            frame = self.sensor.read(POLL_SECONDS)
        except SensorTimeoutError:
            return
        except SensorDisconnectedError as error:
            if not self.sensor.reconnect:
                raise
            self._lost(error)
            return
        self._publish(self._with_features(frame))

    def _with_features(self, frame: LiveFrame) -> LiveFrame:
        """``frame`` with features; turned upright where the detector finds the face turned in the picture."""
        given = frame.features is not None or self.sensor.has_features
        if frame.colour is None or (given and not self._always):
            return frame
        if self._upright is None:
            self._detector = self._detector or self._load()
            self._upright = Upright(self._detector, self.sensor.name)
        start = time.perf_counter()
        found = self._upright.detect(frame)
        self._detect_ms.append((time.perf_counter() - start) * 1e3)
        return found

    def _load(self) -> FeatureDetector:
        self._own_detector = FeatureDetector(video=True)
        return self._own_detector

    def _publish(self, frame: LiveFrame) -> None:
        with self._changed:
            if not self.sensor.live:
                self._changed.wait_for(lambda: self._frame is None or self._closed)
            self.dropped += self._frame is not None
            self._frame = None if self._closed else frame
            self._trouble, self._said = None, False
            self._changed.notify_all()

    def _lost(self, error: SensorDisconnectedError) -> None:
        with self._changed:
            if self.sensor.live and self._frame is not None:
                self._frame = None  # from before the unplugging: not what the sensor sees now
                self.dropped += 1
            self._trouble = error
            self._changed.notify_all()

    def _end(self, error: AdaptiveFaceError) -> None:
        with self._changed:
            self._changed.wait_for(lambda: self.sensor.live or self._frame is None or self._closed)
            self._error, self.running = error, False
            self._changed.notify_all()
