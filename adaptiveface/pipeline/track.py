"""Track every frame of a source (sections 4 to 6)."""

from __future__ import annotations

import logging
import os
from collections.abc import Callable
from pathlib import Path

from ..errors import TrackingError
from ..geometry.frame import RgbdFrame
from ..geometry.source import Abilities
from ..insides.gaze import GazeTrack
from ..landmarks import FeatureDetector
from ..model.actor import Actor
from ..neutral.plausible import SizeWatch
from ..parameters import Parameters
from ..result import Result, ResultBuilder
from ..result.rows import discard, unfinished_folder
from ..runtime.threads import one_thread
from ..sensors import FrameSource
from ..tracking.colour_offset import ColourOffset
from ..tracking.colour_tracker import make_tracker
from ..tracking.types import TrackedFrame
from .progress import progress_bar
from .reader import FrameReader, reading

_log = logging.getLogger(__name__)
OnFrame = Callable[[TrackedFrame, RgbdFrame], None]


class TrackingInterrupted(KeyboardInterrupt):
    """Ctrl-C was pressed during :func:`track_source`. ``result`` holds the frames so far."""

    def __init__(self, result: Result) -> None:
        super().__init__(f"interrupted after {len(result)} frames")
        self.result = result


def track_source(
    source: FrameSource | FrameReader,
    actor: Actor,
    parameters: Parameters | None = None,
    progress: bool = False,
    keep_stages: bool = False,
    on_frame: OnFrame | None = None,
    detector: FeatureDetector | None = None,
    folder: Path | None = None,
) -> Result:
    """Track every frame of a source (sections 4 to 6).

    Broken frames are skipped and counted (``Result.skipped`` and ``Result.reasons``). A source with ``colour_only`` is
    tracked by its features alone, which is a degraded mode.

    Parameters
    ----------
    source : FrameSource or FrameReader
        Where the frames come from. A reader that remembers the frames of the capture does not read them again.
    actor : Actor
        The rig of the person.
    parameters : Parameters, optional
        Our defaults without.
    progress : bool
        Whether to show a bar on stderr.
    keep_stages : bool
        Whether to keep v1, v2 and v3 besides the final mesh.
    on_frame : callable, optional
        Called with the tracked frame and the source's frame after every frame.
    detector : FeatureDetector, optional
        Finds 2D features if the source brings none; made when it is needed. A ``FrameReader`` has its own.
    folder : pathlib.Path, optional
        Where the rows are stored as files instead of in memory; see :func:`track_to_file`.

    Returns
    -------
    Result
        One entry per frame.

    Raises
    ------
    TrackingError
        No frame can be used, the face is never found, or it is far larger or smaller than the actor's.
    TrackingInterrupted
        Ctrl-C was pressed; the error holds the result so far.
    """
    with reading(source, detector) as reader:
        reader.rewind()
        count = len(reader.source)
        run = _Run(reader, actor, parameters or Parameters(), keep_stages, folder)
        try:
            with one_thread(), progress_bar(progress, total=count, desc="tracking", unit="frame") as bar:
                for index in range(count):
                    bar.update()
                    run.take(index, on_frame)
        except KeyboardInterrupt as interruption:
            raise TrackingInterrupted(run.result()) from interruption
        return run.judged()


class _Run:
    """A source that is being tracked: the tracker, and what else watches the frames."""

    def __init__(
        self, reader: FrameReader, actor: Actor, parameters: Parameters, keep_stages: bool, folder: Path | None
    ) -> None:
        self.reader, self.abilities = reader, Abilities.of(reader.source)
        colour_only, count = self.abilities.colour_only, len(reader.source)
        self.tracker, self.size = make_tracker(actor, parameters, colour_only), SizeWatch(reader.source, actor)
        self.builder = ResultBuilder(actor, parameters, count, keep_stages, colour_only, folder)
        self.gaze, self.offset = GazeTrack(actor), ColourOffset(actor)

    def take(self, index: int, on_frame: OnFrame | None) -> None:
        """Read and track the next frame."""
        frame = self.reader.read(index)
        if frame is None:
            self.builder.skip(self.reader.timestamp(index), self.reader.skipped[index])
            self.gaze.add(None)
            return
        self.size.see(frame)
        tracked = self.tracker.track(frame)
        self.reader.spare(self.tracker.detect_every)
        self.builder.add(tracked)
        self.gaze.see(tracked, frame)
        if not self.abilities.colour_only:
            self.offset.add(tracked, frame)
        if on_frame is not None:
            on_frame(tracked, frame)

    def result(self) -> Result:
        """The frames so far."""
        self.builder.turned, self.builder.mirrored = self.reader.quarters, self.abilities.mirrored
        return self.gaze.onto(self.builder.finish(self.tracker.model.correctives, self.tracker.expressions))

    def judged(self) -> Result:
        """Return the finished result. Raises :class:`TrackingError` if it is useless, and warns about doubts."""
        count, name = len(self.reader.source), self.reader.source.name
        if len(self.reader.skipped) == count:
            raise self.reader.fail("no frame can be used")
        self.size.judge()
        result = self.result()
        if not result.tracked.any():
            raise self.reader.fail(f"the face was found in none of {count} frames")
        if note := self.offset.note(name):
            _log.warning("%s", note)
        return result


def track_to_file(
    source: FrameSource | FrameReader, actor: Actor, path: str | os.PathLike, parameters: Parameters | None = None, **options
) -> Result:
    """Run :func:`track_source` and save its result as ``path`` (an ``.npz``), in bounded memory for sources of any length.

    Meanwhile the frames are in the folder ``NAME.unfinished`` beside ``path``, which
    :meth:`~adaptiveface.result.Result.load` can read. The folder is removed when the result is saved, or if it is empty. It
    remains if the process is killed, the disk is full, or anything else goes wrong. ``options`` and errors are those of
    :func:`track_source`.
    """
    folder = unfinished_folder(path)
    try:
        track_source(source, actor, parameters, folder=folder, **options).save(path)
    except TrackingError:
        discard(folder)
        raise
    result = Result.load(path)  # nothing uses the files in the folder any more
    discard(folder)
    return result
