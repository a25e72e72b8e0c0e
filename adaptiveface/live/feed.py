"""Find the features of the sensor's newest frame, in a separate thread."""

from __future__ import annotations

import time
from collections import deque

import numpy as np

from ..errors import (
    AdaptiveFaceError,
    FeatureDetectionError,
    SensorDisconnectedError,
    SensorTimeoutError,
)
from ..landmarks import FeatureDetector, Upright
from ..runtime.closing import Closing
from ..sensors.live import LiveFrame, LiveSensor
from ..sensors.worker import POLL_SECONDS, Latest, Worker, packaged

#: Longest time that :meth:`FeatureFeed.close` waits, s. Loading the detector takes longer, and ends in the background.
CLOSE_SECONDS = 0.9


class FeatureFeed(Closing):
    """Adds 2D features to the frames of a sensor in a separate thread. It is a context manager. The sensor stays open.

    Frames that already have features pass unchanged. If a ``detector`` is given or ``always`` is set, every colour image is
    searched instead. Without a ``detector``, one is made for the first frame that needs it, and it is closed at the end. A
    recording waits until its frames are read.

    Attributes
    ----------
    dropped : int
        Number of frames with features that a newer frame replaced before they were read. The sensor counts the frames for
        which the detector was too slow (``superseded``).
    running : bool
        False once no further frame will come.
    """

    def __init__(self, sensor: LiveSensor, detector: FeatureDetector | None = None, always: bool = False) -> None:
        self.sensor, self.dropped, self.running = sensor, 0, True
        self._detector, self._always = detector, always or detector is not None
        self._own_detector: FeatureDetector | None = None
        self._upright: Upright | None = None
        self._frames: Latest[LiveFrame] = Latest(sensor.name, "feed", waits=not sensor.live)
        self._detect_ms: deque[float] = deque(maxlen=30)
        self._worker = Worker(f"features {sensor.name}", self._run, self._end, self._wrap, self._release)
        self._worker.start()

    @property
    def detect_ms(self) -> float:
        """The median time of the last 30 detections, ms. It is 0 if no detection was needed."""
        return float(np.median(list(self._detect_ms))) if self._detect_ms else 0.0

    def read(self, timeout: float = 1.0) -> LiveFrame:
        """Return the newest unread frame with its features.

        Parameters
        ----------
        timeout : float
            Longest time to wait for a frame, s.

        Returns
        -------
        LiveFrame

        Raises
        ------
        SensorDisconnectedError
            The sensor is disconnected. This is raised at once, and then whenever ``timeout`` passes without a sensor.
        SensorTimeoutError
            No frame came in time.
        EndOfRecording
            The recording is over.
        AdaptiveFaceError
            The sensor or the detector failed.
        """
        return self._frames.read(timeout, self._fresh)

    def spare(self, every: int) -> None:
        """Search only every ``every``-th picture from now on, as :meth:`.Upright.spare` does. Any thread may call this."""
        if self._upright is not None:
            self._upright.spare(every)

    def close(self) -> None:
        """Stop the thread within a second. The sensor stays open. Calling it again does nothing."""
        self._frames.close()
        self._worker.join(CLOSE_SECONDS)

    def _fresh(self, frame: LiveFrame) -> bool:
        """Return whether a frame may be handed out. A frame that is too old is counted as dropped."""
        late = self.sensor.live and frame.age > self.sensor.max_age
        self.dropped += late
        return not late

    # ---- the feature thread ----------------------------------------------------------------------------------------
    def _run(self) -> None:
        while not self._frames.closed:
            self._step()

    def _wrap(self, error: Exception) -> AdaptiveFaceError:
        return packaged(error, f"{self.sensor.name}: the feature detector failed", FeatureDetectionError)

    def _release(self) -> None:
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
            with self._frames.changed:
                self.dropped += self._frames.drop()
                self._frames.interrupt(error)
            return
        found = self._with_features(frame)
        with self._frames.changed:
            replaced = self._frames.put(found)
            self.dropped += replaced

    def _with_features(self, frame: LiveFrame) -> LiveFrame:
        """Return ``frame`` with features. It is turned upright if the detector finds a turned face."""
        given = frame.features is not None or self.sensor.has_features
        if frame.colour is None or (given and not self._always):
            return frame
        if self._upright is None:
            self._detector = self._detector or self._load()
            self._upright = Upright(self._detector, self.sensor.name)
        start = time.perf_counter()
        found = self._upright.detect(frame)
        if found.searched:
            self._detect_ms.append((time.perf_counter() - start) * 1e3)
        return found

    def _load(self) -> FeatureDetector:
        self._own_detector = FeatureDetector(video=True)
        return self._own_detector

    def _end(self, error: AdaptiveFaceError) -> None:
        with self._frames.changed:
            self._frames.end(error)
            self.running = False
