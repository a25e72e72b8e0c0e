"""Recording beside the tracking: the frames of a live run go to a folder, by the recorder's own threads."""

from __future__ import annotations

import time
from pathlib import Path

from ..errors import RecordingError
from ..live.run import LiveRun
from ..live.session import LiveResult
from ..sensors.record import FrameRecorder
from ..sensors.recording import RecordingWriter


class LiveRecorder:
    """Writes every tracked frame of ``run``, with its features, to the new ``folder`` until :meth:`close`."""

    def __init__(self, run: LiveRun, folder: str | Path | None = None) -> None:
        name = time.strftime("recording-%Y%m%d-%H%M%S")
        self.folder, self._run, self._recorder = Path(folder or name), run, None
        if (self.folder / "intrinsic.json").exists():
            raise RecordingError(f"{self.folder}: already holds a recording; name another folder")
        self._remove = run.on_result(self._write)

    @property
    def frames(self) -> int:
        """Frames handed to the disk so far."""
        return self._recorder.frames if self._recorder else 0

    def _write(self, result: LiveResult) -> None:
        """On the tracker's thread; a full disk ends the recording, and the session reports it."""
        if self._recorder is None:
            sensor = self._run.sensor
            scale = min(max(sensor.depth_scale, 100.0), 65_000.0)
            self._recorder = FrameRecorder(RecordingWriter(self.folder, result.frame.camera, sensor.fps, scale))
        self._recorder.write(result.frame)

    def close(self) -> str:
        """Finish the files; returns what was written. Raises :class:`RecordingError` when the disk is full."""
        self._remove()
        if self._recorder is None:
            return f"{self.folder}: nothing was recorded"
        self._recorder.close()
        refused = self._recorder.refused
        lost = f", {refused} lost because the disk is too slow" if refused else ""
        return f"{self.folder}: {self._recorder.frames} frames recorded{lost}"
