"""The run loop: frames from a source, features from the source or the detector, one tracked result per frame.

This is where sensors, detector, capture and tracking meet; none of them knows the others. Broken frames are skipped and
counted, they never reach the tracker.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from tqdm import tqdm

from .actor import Actor
from .blas import one_blas_thread
from .errors import FrameError, TrackingError
from .face_model import FaceModel
from .frame import RgbdFrame
from .landmarks import FeatureDetector, Upright
from .neutral.capture import capture_actor
from .neutral.colour import capture_colour_actor
from .parameters import Parameters
from .result import Result, ResultBuilder
from .rows import discard, unfinished_folder
from .sensors import FrameSource
from .tracking.colour_tracker import make_tracker
from .tracking.types import TrackedFrame

#: A face counts as found in a frame from this many valid features on.
MIN_FEATURES = 6
#: A neutral scan takes at most this many frames, spread evenly over the source: more take memory and bring little.
MAX_NEUTRAL_FRAMES = 150

OnFrame = Callable[[TrackedFrame, RgbdFrame], None]


class TrackingInterrupted(KeyboardInterrupt):
    """Ctrl-C during :func:`track_source`; ``result`` holds the frames tracked until then."""

    def __init__(self, result: Result) -> None:
        super().__init__(f"interrupted after {len(result)} frames")
        self.result = result


class FrameReader:
    """Reads the frames of a source with their 2D features, and keeps count of the broken ones.

    A context manager. ``detector`` is made on first need when None, and closed at the end. ``skipped``: index -> reason of
    every frame that could not be used. ``quarters``: by how much frames without features are turned anticlockwise, so that
    the detector sees them upright.
    """

    def __init__(self, source: FrameSource, detector: FeatureDetector | None = None) -> None:
        self.source, self.detector = source, detector
        self._own_detector: FeatureDetector | None = None
        self._upright: Upright | None = None
        self.skipped: dict[int, str] = {}

    def __enter__(self) -> FrameReader:
        return self

    def __exit__(self, *_) -> None:
        if self._own_detector is not None:
            self._own_detector.close()

    def read(self, index: int) -> RgbdFrame | None:
        """Frame ``index`` with features where a face is seen; None (and an entry in ``skipped``) for a broken frame."""
        try:
            frame = self.source.read(index)
        except FrameError as error:
            self.skipped[index] = str(error)
            return None
        if frame.features is not None or getattr(self.source, "has_features", False):
            return frame
        if frame.colour is None:
            raise TrackingError(f"{self.source.name}: neither colour images nor features.csv, so no face can be found")
        if self.detector is None:
            self.detector = self._own_detector = FeatureDetector()
        if self._upright is None:
            self._upright = Upright(self.detector, self.source.name)
        return self._upright.detect(frame)

    @property
    def quarters(self) -> int:
        """Quarters of a turn anticlockwise, 0 where the features come with the frames."""
        return 0 if self._upright is None else self._upright.quarters

    def timestamp(self, index: int) -> float:
        """Seconds at which frame ``index`` was due, for one that cannot be read."""
        timestamps = getattr(self.source, "timestamps", None)
        return float(timestamps[index]) if timestamps is not None else index / getattr(self.source, "fps", 30.0)

    def fail(self, message: str) -> TrackingError:
        """An error that says ``message`` and, where frames were skipped, how many and the first reason."""
        if self.skipped:
            message += f"; {len(self.skipped)} broken frames, the first: {next(iter(self.skipped.values()))}"
        return TrackingError(f"{self.source.name}: {message}")


def face_found(frame: RgbdFrame) -> bool:
    """Whether enough 2D features are seen to say that there is a face."""
    return frame.features is not None and int(frame.features.valid.sum()) >= MIN_FEATURES


def capture_from(
    source: FrameSource,
    parameters: Parameters | None = None,
    neutral_frames: int | None = None,
    detector: FeatureDetector | None = None,
    progress: bool = False,
    model: FaceModel | None = None,
) -> Actor:
    """Capture the neutral face shown by ``source`` (paper, section 3).

    ``neutral_frames``: the leading frames in which a face is found; None: all frames, at most ``MAX_NEUTRAL_FRAMES`` of
    them, spread evenly. From a source without depth (``colour_only``) comes the average head with the person's
    proportions (``neutral/colour.py``). ``model``: the embedded one by default. ``progress`` shows bars on stderr. Raises
    :class:`TrackingError` when no face is found.
    """
    frames = []
    stride = 1 if neutral_frames else max(1, math.ceil(len(source) / MAX_NEUTRAL_FRAMES))
    reading = {"total": neutral_frames, "desc": "reading the neutral", "unit": "frame", "leave": False}
    with FrameReader(source, detector) as reader, _bar(progress, **reading) as bar:
        for index in range(0, len(source), stride):
            frame = reader.read(index)
            if frame is not None and (neutral_frames is None or face_found(frame)):
                frames.append(frame)
                bar.update()
            if len(frames) == neutral_frames:
                break
    if not frames and len(reader.skipped) == len(range(0, len(source), stride)):
        raise reader.fail("no frame can be used")
    if not any(map(face_found, frames)):
        raise reader.fail(f"no face found in any of {len(source)} frames")
    if getattr(source, "colour_only", False):
        return capture_colour_actor(frames, model, parameters or Parameters())
    with one_blas_thread(), _capture_bar(progress) as report:
        return capture_actor(frames, model, parameters or Parameters(), report)


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
    """Track every frame of ``source`` with the rig ``actor`` (paper, sections 4 to 6).

    ``keep_stages`` keeps v1, v2, v3 besides the final mesh; ``on_frame(tracked, frame)`` sees every frame once it is
    done; ``progress`` shows a bar on stderr. Broken frames are skipped and counted (``Result.skipped``, with
    ``Result.reasons``). A source that says ``colour_only`` is tracked by its features alone, degraded. ``folder``: keep
    the frames in files there instead of in memory, see :func:`track_to_file`. Raises :class:`TrackingError` when no
    frame can be used or the face is never found, :class:`TrackingInterrupted` (with the result so far) on Ctrl-C.
    """
    parameters = parameters or Parameters()
    colour_only = getattr(source, "colour_only", False)
    tracker = make_tracker(actor, parameters, colour_only)
    builder = ResultBuilder(actor, parameters, len(source), keep_stages, colour_only, folder)
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
                    continue
                tracked = tracker.track(frame)
                builder.add(tracked)
                if on_frame is not None:
                    on_frame(tracked, frame)
    except KeyboardInterrupt as interruption:
        builder.turned, builder.mirrored = reader.quarters, getattr(source, "mirrored", False)
        raise TrackingInterrupted(builder.finish(tracker.model.correctives)) from interruption
    if len(reader.skipped) == len(source):
        raise reader.fail("no frame can be used")
    builder.turned, builder.mirrored = reader.quarters, getattr(source, "mirrored", False)
    result = builder.finish(tracker.model.correctives)
    if not result.tracked.any():
        raise reader.fail(f"the face was found in none of {len(source)} frames")
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
