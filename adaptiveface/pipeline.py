"""Run the whole method: read frames, find their features, track them, and collect one result per frame.

This is where sensors, detector, capture and tracking meet; none of them knows the others. Broken frames are skipped and
counted, they never reach the tracker.
"""

from __future__ import annotations

import dataclasses
import logging
import math
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from tqdm import tqdm

from .errors import FrameError, TrackingError
from .geometry.frame import Features2D, RgbdFrame
from .geometry.mesh import surface_points
from .insides.gaze import GazeTrack
from .landmarks import FeatureDetector, Upright
from .model.actor import Actor
from .model.face_model import FaceModel, embedded_face_model
from .neutral.capture import capture_actor
from .neutral.colour import capture_colour
from .neutral.plausible import SizeWatch
from .neutral.take import NeutralTake, face_found, neutral_of
from .parameters import Parameters
from .result import Result, ResultBuilder
from .result.rows import discard, unfinished_folder
from .runtime.blas import one_blas_thread
from .sensors import FrameSource
from .sensors.numbered import Abilities
from .sensors.orientation import turned
from .tracking.colour_offset import ColourOffset
from .tracking.colour_tracker import make_tracker
from .tracking.types import TrackedFrame

#: A neutral scan takes at most this many frames, spread evenly over the source: more take memory and bring little.
MAX_NEUTRAL_FRAMES = 150
_log = logging.getLogger(__name__)
OnFrame = Callable[[TrackedFrame, RgbdFrame], None]


class TrackingInterrupted(KeyboardInterrupt):
    """Ctrl-C during :func:`track_source`; ``result`` holds the frames tracked until then."""

    def __init__(self, result: Result) -> None:
        super().__init__(f"interrupted after {len(result)} frames")
        self.result = result


class FrameReader:
    """Reads the frames of a source with their 2D features, and keeps count of the broken ones.

    A context manager. ``detector`` is made on first need when None, and closed at the end. ``skipped``: index -> reason of
    every frame that could not be used; ``reads``: how many were asked for. ``quarters``: by how much frames without
    features are turned anticlockwise, so that the detector sees them upright.
    """

    def __init__(self, source: FrameSource, detector: FeatureDetector | None = None) -> None:
        self.source, self.detector, self._abilities = source, detector, Abilities.of(source)
        self._own_detector: FeatureDetector | None = None
        self._upright: Upright | None = None
        self.skipped: dict[int, str] = {}
        self.reads = 0

    def __enter__(self) -> FrameReader:
        return self

    def __exit__(self, *_) -> None:
        if self._own_detector is not None:
            self._own_detector.close()

    def read(self, index: int) -> RgbdFrame | None:
        """Frame ``index`` with features where a face is seen; None (and an entry in ``skipped``) for a broken frame."""
        self.reads += 1
        try:
            frame = self.source.read(index)
        except FrameError as error:
            self.skipped[index] = str(error)
            return None
        if frame.features is not None or self._abilities.has_features:
            return frame
        if frame.colour is None:
            raise TrackingError(f"{self.source.name}: neither colour images nor features.csv, so no face can be found")
        if self.detector is None:
            self.detector = self._own_detector = FeatureDetector()
        if self._upright is None:
            self._upright = Upright(self.detector, self.source.name)
        return self._upright.detect(frame)

    def again(self, index: int, features: Features2D) -> RgbdFrame:
        """Frame ``index``, which was read before, with the ``features`` that it had."""
        return dataclasses.replace(turned(self.source.read(index), self.quarters), features=features)

    @property
    def quarters(self) -> int:
        """Quarters of a turn anticlockwise, 0 where the features come with the frames."""
        return 0 if self._upright is None else self._upright.quarters

    def timestamp(self, index: int) -> float:
        """Seconds at which frame ``index`` was due, for one that cannot be read."""
        timestamps = self._abilities.timestamps
        return float(timestamps[index]) if timestamps is not None else index / self._abilities.fps

    def fail(self, message: str) -> TrackingError:
        """An error that says ``message`` and, where frames were skipped, how many and the first reason."""
        if self.skipped:
            message += f"; {len(self.skipped)} broken frames, the first: {next(iter(self.skipped.values()))}"
        return TrackingError(f"{self.source.name}: {message}")


def capture_from(
    source: FrameSource,
    parameters: Parameters | None = None,
    neutral_frames: int | range | None = None,
    detector: FeatureDetector | None = None,
    progress: bool = False,
    model: FaceModel | None = None,
    on_take: Callable[[NeutralTake], None] | None = None,
) -> Actor:
    """Capture the neutral face that a source shows (section 3).

    Parameters
    ----------
    source : FrameSource
        Without depth (``colour_only``), the result is the average head with the person's proportions. It is then fitted to
        frames from all over the source, none of which need be neutral, unless ``neutral_frames`` is a range.
    parameters : Parameters, optional
        Our defaults without.
    neutral_frames : int, range or None
        A number: so many of the leading frames that show a face. If these are turned away or moving, calmer ones near the
        beginning take their place (:mod:`~adaptiveface.neutral.choice`), and a note says so. A range: these very frames.
        None: all frames, or ``MAX_NEUTRAL_FRAMES`` that are spread evenly.
    detector : FeatureDetector, optional
        Finds 2D features where the source brings none; made on first need.
    progress : bool
        Show bars on stderr.
    model : FaceModel, optional
        The embedded one by default.
    on_take : callable, optional
        Is told which frames were taken.

    Returns
    -------
    Actor
        The personal rig.

    Raises
    ------
    TrackingError
        No face was found; its kind :class:`~adaptiveface.neutral.plausible.ImplausibleFaceError` where the head is no
        person's.
    """
    model, parameters = model or embedded_face_model(), parameters or Parameters()
    known = Abilities.of(source)
    anywhere = known.colour_only and not known.has_features and not isinstance(neutral_frames, range)
    if anywhere:
        neutral_frames = range(0, len(source), max(1, math.ceil(len(source) / MAX_NEUTRAL_FRAMES)))
    count = neutral_frames if isinstance(neutral_frames, int) else None
    reading = {"total": count, "desc": "reading the neutral", "unit": "frame", "leave": False}
    points = surface_points(model.mean, model.feature_triangles, model.feature_weights)
    with FrameReader(source, detector) as reader, _bar(progress, **reading) as bar:
        take = neutral_of(reader, neutral_frames, points, MAX_NEUTRAL_FRAMES, bar.update)
    if not take.frames and reader.skipped and len(reader.skipped) == reader.reads:
        raise reader.fail("no frame can be used")
    if not any(map(face_found, take.frames)):
        raise reader.fail(f"no face found in any of {reader.reads} frames")
    if known.colour_only:
        actor = _capture_colour(source, take.frames, model, parameters)
    else:
        with one_blas_thread(), _capture_bar(progress) as report:
            actor = capture_actor(take.frames, model, parameters, report, source)
    if anywhere:
        take = dataclasses.replace(take, note="")  # they may do what they like
    if take.note:
        _log.warning("%s: %s", source.name, take.note)
    if on_take is not None:
        on_take(take)
    return actor


def _capture_colour(source, frames: list[RgbdFrame], model: FaceModel | None, parameters: Parameters) -> Actor:
    """The actor of a source without depth. A focal length that was a guess, and cannot be, is set right in the source."""
    guessed = Abilities.of(source).guessed_camera
    with one_blas_thread():
        capture = capture_colour(frames, model, parameters, guessed)
    if guessed:
        source.camera = source.camera.zoomed(capture.focal)
    return capture.actor


def track_source(
    source: FrameSource,
    actor: Actor,
    parameters: Parameters | None = None,
    progress: bool = False,
    keep_stages: bool = False,
    on_frame: OnFrame | None = None,
    detector: FeatureDetector | None = None,
    folder: Path | None = None,
) -> Result:
    """Track every frame of a source (sections 4 to 6).

    Broken frames are skipped and counted (``Result.skipped`` and ``Result.reasons``). A source that says ``colour_only`` is
    tracked by its features alone, a degraded mode.

    Parameters
    ----------
    source : FrameSource
        Where the frames come from.
    actor : Actor
        The rig of the person.
    parameters : Parameters, optional
        Our defaults without.
    progress : bool
        Show a bar on stderr.
    keep_stages : bool
        Keep v1, v2 and v3 besides the final mesh.
    on_frame : callable, optional
        Called with the tracked frame and the source's frame once a frame is done.
    detector : FeatureDetector, optional
        Finds 2D features where the source brings none; made on first need.
    folder : pathlib.Path, optional
        Keep the rows in files there instead of in memory; see :func:`track_to_file`.

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
    parameters = parameters or Parameters()
    colour_only = Abilities.of(source).colour_only
    tracker, watch = make_tracker(actor, parameters, colour_only), SizeWatch(source, actor)
    builder = ResultBuilder(actor, parameters, len(source), keep_stages, colour_only, folder)
    offset, gaze = ColourOffset(actor), GazeTrack(actor)
    try:
        with (
            FrameReader(source, detector) as reader,
            one_blas_thread(),
            _bar(progress, total=len(source), desc="tracking", unit="frame") as bar,
        ):
            for index in range(len(source)):
                bar.update()
                frame = reader.read(index)
                if frame is None:
                    builder.skip(reader.timestamp(index), reader.skipped[index])
                    gaze.add(None)
                    continue
                watch.see(frame)
                tracked = tracker.track(frame)
                builder.add(tracked)
                gaze.see(tracked, frame)
                if not colour_only:
                    offset.add(tracked, frame)
                if on_frame is not None:
                    on_frame(tracked, frame)
    except KeyboardInterrupt as interruption:
        builder.turned, builder.mirrored = reader.quarters, Abilities.of(source).mirrored
        raise TrackingInterrupted(gaze.onto(builder.finish(tracker.model.correctives))) from interruption
    if len(reader.skipped) == len(source):
        raise reader.fail("no frame can be used")
    watch.judge()
    builder.turned, builder.mirrored = reader.quarters, Abilities.of(source).mirrored
    result = gaze.onto(builder.finish(tracker.model.correctives))
    if not result.tracked.any():
        raise reader.fail(f"the face was found in none of {len(source)} frames")
    if note := offset.note(source.name):
        _log.warning("%s", note)
    return result


def track_to_file(
    source: FrameSource, actor: Actor, path: str | os.PathLike, parameters: Parameters | None = None, **options
) -> Result:
    """:func:`track_source`, saved as ``path`` (an ``.npz``), in bounded memory however long the source is.

    While it runs the frames are in the folder ``NAME.unfinished`` beside ``path``, which
    :meth:`~adaptiveface.result.Result.load` reads. It goes when the result is saved, or when there is nothing in it; it
    stays when the process is killed, the disk is full, or anything else goes wrong. ``options`` of :func:`track_source`,
    which says what is raised.
    """
    folder = unfinished_folder(path)
    try:
        track_source(source, actor, parameters, folder=folder, **options).save(path)
    except TrackingError:
        discard(folder)
        raise
    result = Result.load(path)  # from here on nothing holds the files in the folder
    discard(folder)
    return result


def _bar(progress: bool, **options) -> tqdm:
    """A progress bar on stderr where that is a terminal; log files stay readable."""
    return tqdm(disable=None if progress else True, **options)


@contextmanager
def _capture_bar(progress: bool) -> Iterator[Callable[[str, float], None]]:
    """A bar for ``capture_actor``: one round of 100 % per step."""
    with _bar(progress, total=100, unit="%", leave=False) as bar:

        def report(step: str, share: float) -> None:
            """Move the bar to the share of this step."""
            bar.set_description(step.replace("_", " "), refresh=False)
            bar.n = int(np.clip(round(100 * share), 0, 100))
            bar.refresh()

        yield report
