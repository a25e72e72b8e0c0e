"""Record every frame that the sensor delivers during tracking, even if detector and tracker do not keep up."""

from __future__ import annotations

import threading
import time
from pathlib import Path

from ..errors import AdaptiveFaceError, FileFormatError
from ..files import check_new_folder
from ..sensors.live import LiveFrame, LiveSensor
from ..sensors.record import FrameRecorder, RecordingSummary, check_has_depth
from ..sensors.recording import RecordingWriter


class LiveRecorder:
    """Writes every frame of ``sensor`` from now on to the new ``folder``, until :meth:`close`.

    Frames for which the disk is too slow are counted in ``refused``. An error, such as a full disk or another image size, stops
    only the recording. The attribute ``error`` holds it, and :meth:`close` raises it. The frames that were written are kept.

    Raises
    ------
    AdaptiveFaceError
        The folder cannot be used.
    SensorError
        The sensor measures no depth.
    """

    def __init__(self, sensor: LiveSensor, folder: Path) -> None:
        check_new_folder(folder)
        check_has_depth(sensor)
        self.sensor, self.folder = sensor, Path(folder)
        self.error: AdaptiveFaceError | None = None
        self._lock, self._closed = threading.Lock(), False
        self._recorder: FrameRecorder | None = None
        self._start, self._lost = time.perf_counter(), sensor.lost_by_device
        sensor.add_listener(self._write)

    @property
    def frames(self) -> int:
        """The number of frames on disk so far."""
        return self._recorder.frames if self._recorder else 0

    def _write(self, frame: LiveFrame) -> None:
        with self._lock:
            if self._closed or self.error is not None:
                return
            try:
                if self._recorder is None:
                    scale = min(max(self.sensor.depth_scale, 100.0), 100_000.0)
                    writer = RecordingWriter(self.folder, frame.camera, self.sensor.fps, scale)
                    self._recorder = FrameRecorder(writer, lossless=not self.sensor.live)
                self._recorder.write(frame)
            except (AdaptiveFaceError, OSError) as error:
                self.error = error if isinstance(error, AdaptiveFaceError) else FileFormatError(str(error))

    def close(self) -> RecordingSummary:
        """Write the queued frames, and raise ``error`` if there is one. Calling this again only returns the summary."""
        self.sensor.remove_listener(self._write)
        with self._lock:
            first, self._closed = not self._closed, True
            if first and self._recorder is not None:
                try:
                    self._recorder.close()
                except AdaptiveFaceError as error:
                    self.error = self.error or error
        if first and self.error is not None:
            raise self.error
        refused = self._recorder.refused if self._recorder else 0
        lost = self.sensor.lost_by_device - self._lost
        moving = self._recorder is not None and self._recorder.writer.moving_lens
        took, broken = time.perf_counter() - self._start, tuple(self.sensor.broken)
        return RecordingSummary(self.folder, self.frames, lost, refused, took, broken, moving)
