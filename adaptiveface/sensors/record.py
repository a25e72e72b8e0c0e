"""Run ``record`` and ``convert``: write the raw frames of a sensor in the layout of a recording.

A pool of threads compresses pictures while the next frame arrives. Images appear whole or not at all, and the tables get a row
before its images are written. The folder is therefore a readable recording at any moment. If the process is killed, it ends
with the last frame whose images are complete.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

from ..errors import AdaptiveFaceError, EndOfRecording, FileFormatError, RecordingError, SensorError
from ..files import check_new_folder, reason
from ..runtime.interrupt import CtrlC
from .live import LiveFrame, LiveSensor
from .recording import RecordingWriter

#: Threads that compress images, and the frames that may wait for them (about 2 MB each).
WRITERS, BACKLOG = 2, 90
#: A recording ends after this long without a frame, s.
PATIENCE_SECONDS = 5.0
#: Broken frames whose reasons are printed.
REASONS = 5


@dataclass(frozen=True)
class RecordingSummary:
    """What was recorded.

    Attributes
    ----------
    path : Path
        The folder.
    frames : int
        Number of frames that were written.
    dropped : int
        Number of frames that the sensor lost, or that were lost on the way.
    refused : int
        Number of frames that were left out because the disk was too slow.
    seconds : float
        Duration, s.
    broken : tuple of str
        For a recording that was converted, the reason of each frame that could not be read.
    moving_lens : bool
        Whether intrinsics.csv holds a camera for every frame.
    """

    path: Path
    frames: int
    dropped: int
    refused: int
    seconds: float
    broken: tuple[str, ...] = ()
    moving_lens: bool = False

    def __str__(self) -> str:
        text = f"{self.path}: {self.frames} frames in {self.seconds:.1f} s, {self.dropped} dropped by the sensor"
        text += f", {self.refused} lost because the disk is too slow" if self.refused else ""
        lines = [text]
        if self.moving_lens:
            lines.append("  the camera differs from frame to frame: intrinsics.csv keeps that of each frame")
        if self.broken:
            lines.append(f"  {len(self.broken)} of the {self.frames + len(self.broken)} frames are broken and left out:")
            lines += [f"    {reason}" for reason in self.broken[:REASONS]]
            lines += [f"    ... and {len(self.broken) - REASONS} more"] if len(self.broken) > REASONS else []
        return "\n".join(lines)


class FrameRecorder:
    """Writes frames with a pool of threads.

    If the disk is full, :meth:`write` and :meth:`close` raise :class:`RecordingError`. The frames that were written before stay
    readable.

    Parameters
    ----------
    writer : RecordingWriter
        The recording.
    lossless : bool
        Whether :meth:`write` waits when the backlog is full. Otherwise, it refuses the frame.
    """

    def __init__(self, writer: RecordingWriter, lossless: bool = False) -> None:
        self.writer, self.lossless = writer, lossless
        self.frames = self.refused = 0
        self._pool = ThreadPoolExecutor(WRITERS, thread_name_prefix="recording")
        self._waiting: deque[Future] = deque()

    def write(self, frame: LiveFrame) -> bool:
        """Queue a frame. Returns False if it was refused."""
        while self._waiting and (self._waiting[0].done() or (self.lossless and len(self._waiting) >= BACKLOG)):
            self._finish_one()
        if len(self._waiting) >= BACKLOG:
            self.refused += 1
            return False
        with self._explained():
            number = self.writer.reserve(frame)
        self._waiting.append(self._pool.submit(self.writer.write_images, number, frame))
        return True

    def close(self) -> None:
        """Write the queued frames. Calling it again does nothing."""
        try:
            while self._waiting:
                self._finish_one()
        finally:
            self._pool.shutdown(cancel_futures=True)
            self.writer.close()

    def _finish_one(self) -> None:
        with self._explained():
            self._waiting.popleft().result()
        self.frames += 1

    def _explained(self) -> _Explained:
        return _Explained(self)


class _Explained:
    """Turns an OSError into the package's error, and drops the frames that are still queued."""

    def __init__(self, recorder: FrameRecorder) -> None:
        self._recorder = recorder

    def __enter__(self) -> None:
        pass

    def __exit__(self, kind, error, trace) -> None:
        cause = error if isinstance(error, OSError) else error.__cause__ if isinstance(error, AdaptiveFaceError) else None
        if not isinstance(cause, OSError):
            return
        recorder = self._recorder
        while recorder._waiting:
            future = recorder._waiting.popleft()
            recorder.frames += not future.cancel() and future.exception() is None
        raise RecordingError(
            f"{recorder.writer.path}: {reason(cause)} after {recorder.frames} frames, which are kept; free some space or "
            "name another folder"
        ) from error


def record_sensor(
    sensor: LiveSensor,
    folder: Path,
    seconds: float | None = None,
    frames: int | None = None,
    on_frame: Callable[[LiveFrame], None] | None = None,
) -> RecordingSummary:
    """Record a sensor until a limit is reached, or until the recording that it plays ends.

    Ctrl-C ends the recording of a live sensor. It interrupts the conversion of a file, and the first part stays. A second
    Ctrl-C does not wait for the current frame. After an error, the frames that were recorded before stay, too.

    Parameters
    ----------
    sensor : LiveSensor
        The sensor.
    folder : Path
        The folder to create.
    seconds : float, optional
        Longest duration, s.
    frames : int, optional
        Largest number of frames.
    on_frame : callable, optional
        A function that is called with every frame.

    Returns
    -------
    RecordingSummary
        What was recorded.

    Raises
    ------
    RecordingError
        The disk is full.
    SensorError
        The sensor has failed, or it has no depth.
    FileFormatError
        The folder already holds a recording.
    """
    check_has_depth(sensor)
    sensor.buffer(BACKLOG)
    timeout = PATIENCE_SECONDS if sensor.live else None
    first = sensor.read(timeout)
    depth_scale = min(max(sensor.depth_scale, 100.0), 100_000.0)
    recorder = FrameRecorder(RecordingWriter(folder, first.camera, sensor.fps, depth_scale), not sensor.live)
    start, frame, count = time.perf_counter(), first, 0
    with CtrlC() as ctrl_c:
        try:
            while True:
                count += recorder.write(frame)
                if on_frame is not None:
                    on_frame(frame)
                over = seconds is not None and time.perf_counter() - start >= seconds
                if over or count == frames or ctrl_c.pressed:
                    break
                frame = sensor.read(timeout)
        except EndOfRecording:
            pass
        finally:
            recorder.close()
        if not sensor.live:
            ctrl_c.check()  # an incomplete conversion is a failure
    writer, took = recorder.writer, time.perf_counter() - start
    lost = sensor.dropped - first.dropped
    broken, moving = tuple(sensor.broken), writer.moving_lens
    return RecordingSummary(writer.path, recorder.frames, lost, recorder.refused, took, broken, moving)


def run_record(args) -> int:
    """Run ``record SOURCE --out DIR [--seconds N]``. Returns the exit status."""
    from .catalogue import open_sensor

    check_new_folder(args.out, [args.source])
    with open_sensor(args.source) as sensor:
        print(f"{sensor.name}: recording" + (f" for {args.seconds} s" if args.seconds else "; Ctrl-C ends it"))
        print(record_sensor(sensor, args.out, args.seconds))
    return 0


def run_convert(args) -> int:
    """Run ``convert FILE --out DIR``. Returns the exit status."""
    from .catalogue import open_sensor

    check_new_folder(args.out, [args.file])
    if not args.file.exists():
        raise FileFormatError(f"{args.file}: no such file")
    with open_sensor(str(args.file)) as sensor:
        if sensor.live:
            raise AdaptiveFaceError(f"{args.file}: is a live sensor; use 'adaptiveface record'")
        print(record_sensor(sensor, args.out))
    return 0


def check_has_depth(sensor: LiveSensor) -> None:
    """Raise :class:`SensorError` for a sensor without depth, which cannot be recorded."""
    if sensor.colour_only:
        raise SensorError(
            f"{sensor.name}: no depth, and a recording is made of depth; record a video with any camera program, "
            "adaptiveface track reads it"
        )
