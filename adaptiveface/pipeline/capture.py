"""Capture the rig of the person whom a source shows (section 3)."""

from __future__ import annotations

import dataclasses
import logging
import math
from collections.abc import Callable

from ..geometry.frame import RgbdFrame
from ..geometry.mesh import surface_points
from ..geometry.source import Abilities
from ..landmarks import FeatureDetector
from ..model.actor import Actor
from ..model.face_model import FaceModel, embedded_face_model
from ..neutral.capture import capture_actor
from ..neutral.colour import capture_colour
from ..neutral.take import NeutralTake, face_found, neutral_of
from ..parameters import Parameters
from ..runtime.threads import one_thread
from ..sensors import FrameSource
from .progress import capture_bar, progress_bar
from .reader import FrameReader, reading

#: Largest number of frames of a neutral scan, spread evenly over the source. More take memory and add little.
MAX_NEUTRAL_FRAMES = 150
_log = logging.getLogger(__name__)


def capture_source(
    source: FrameSource | FrameReader,
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
    source : FrameSource or FrameReader
        Without depth (``colour_only``), the result is the average head with the person's proportions. It is then fitted to
        frames from all over the source, which need not be neutral, unless ``neutral_frames`` is a range.
    parameters : Parameters, optional
        Our defaults without.
    neutral_frames : int, range or None
        Number of leading frames that show a face. If these are turned away or moving, calmer frames near the beginning are
        used instead (:mod:`~adaptiveface.neutral.choice`), and a note says so. A range names the frames. None means all
        frames, or ``MAX_NEUTRAL_FRAMES`` frames that are spread evenly.
    detector : FeatureDetector, optional
        Finds 2D features if the source brings none; made when it is needed. A ``FrameReader`` has its own.
    progress : bool
        Whether to show bars on stderr.
    model : FaceModel, optional
        The embedded one by default.
    on_take : callable, optional
        Called with the frames that were taken.

    Returns
    -------
    Actor
        The personal rig.

    Raises
    ------
    TrackingError
        No face was found. The subclass :class:`~adaptiveface.neutral.plausible.ImplausibleFaceError` says that the head cannot
        be a person's.
    """
    model, parameters = model or embedded_face_model(), parameters or Parameters()
    with reading(source, detector) as reader:
        known = Abilities.of(reader.source)
        anywhere = known.colour_only and not known.has_features and not isinstance(neutral_frames, range)
        if anywhere:
            length = len(reader.source)
            neutral_frames = range(0, length, max(1, math.ceil(length / MAX_NEUTRAL_FRAMES)))
        take = _read_neutral(reader, neutral_frames, model, progress)
        capture = _capture_colour if known.colour_only else _capture_depth
        actor = capture(reader, take.frames, model, parameters, progress)
    if anywhere:
        take = dataclasses.replace(take, note="")  # these frames may have any expression
    if take.note:
        _log.warning("%s: %s", reader.source.name, take.note)
    if on_take is not None:
        on_take(take)
    return actor


def _read_neutral(reader: FrameReader, wanted: int | range | None, model: FaceModel, progress: bool) -> NeutralTake:
    """The neutral frames, of which at least one shows a face."""
    points = surface_points(model.mean, model.feature_triangles, model.feature_weights)
    count = wanted if isinstance(wanted, int) else None
    with progress_bar(progress, total=count, desc="reading the neutral", unit="frame", leave=False) as bar:
        take = neutral_of(reader, wanted, points, MAX_NEUTRAL_FRAMES, bar.update)
    if not take.frames and reader.skipped and len(reader.skipped) == reader.reads:
        raise reader.fail("no frame can be used")
    if not any(map(face_found, take.frames)):
        raise reader.fail(f"no face found in any of {reader.reads} frames")
    return take


def _capture_depth(
    reader: FrameReader, frames: list[RgbdFrame], model: FaceModel, parameters: Parameters, progress: bool
) -> Actor:
    with one_thread(), capture_bar(progress) as report:
        return capture_actor(frames, model, parameters, report, reader.source)


def _capture_colour(reader: FrameReader, frames: list[RgbdFrame], model: FaceModel, parameters: Parameters, _: bool) -> Actor:
    """Capture the actor of a source without depth. A guessed focal length that is impossible is corrected in the source."""
    guessed = Abilities.of(reader.source).guessed_camera
    with one_thread():
        capture = capture_colour(frames, model, parameters, guessed)
    if guessed:
        reader.source.camera = reader.source.camera.zoomed(capture.focal)
        reader.camera_changed()
    return capture.actor
