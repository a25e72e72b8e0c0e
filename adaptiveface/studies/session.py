"""Load what every notebook starts with: a short performance in memory and the personal rig of its performer.

``load_session("synthetic")`` renders a synthetic performer once, and keeps the frames and the rig in the user's cache folder.
``load_session("path/to/a/recording")`` takes a recording or a video instead, and ``actor="actor.npz"`` takes a saved head.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TypeVar

import numpy as np

from ..caches import cache_folder
from ..errors import AdaptiveFaceError, FileFormatError
from ..evaluation import GroundTruth, neutral_alignment
from ..files.npz import write_npz
from ..files.records import arrays
from ..geometry.camera import Camera
from ..geometry.frame import RgbdFrame
from ..geometry.mesh import transform_points
from ..geometry.source import Abilities, NumberedFrames
from ..model.actor import Actor
from ..parameters import Parameters
from ..pipeline import capture_source, one_thread
from ..sensors import open_source
from ..tracking.base import Tracker
from ..tracking.colour_tracker import make_tracker
from ..tracking.types import TrackedFrame
from .recorded import read_take
from .rendered import LESSON, RenderedPerformance, StoredFrames

T = TypeVar("T")

#: Environment variable for fewer frames in test runs.
FAST = "ADAPTIVEFACE_NOTEBOOK_FAST"
#: Number of frames of the lesson's performance.
LESSON_FRAMES = 300
#: Changes with the synthetic sensor and with this file's layout, so that an old cache is not used.
CACHE_VERSION = 2
#: Mean distance from the performer's face at which a head belongs to another person, mm. Captured heads lie within 0.5 mm.
ANOTHER = 1.5


def fast() -> bool:
    """Whether the notebooks run in their short form (``ADAPTIVEFACE_NOTEBOOK_FAST=1``)."""
    return os.environ.get(FAST, "") not in ("", "0")


@dataclass
class Session(NumberedFrames):
    """A short performance, with what is known about it.

    A session is itself a frame source (``camera``, ``name``, ``len``, ``read``), in which the neutral frames come first.

    Attributes
    ----------
    name : str
        Of the source.
    camera : Camera
        Of the frames.
    neutral, frames : sequence of RgbdFrame
        Frames of the neutral face and of the performance, with features.
    truth : GroundTruth or None
        Of all frames.
    has_features : bool
        Whether the frames bring features.
    fps : float
        Frames per second.
    colour_only : bool
        Whether the source is a video without depth.
    guessed_camera : bool
        Whether the focal length is unknown until the actor is captured.
    """

    name: str
    camera: Camera
    neutral: Sequence[RgbdFrame]
    frames: Sequence[RgbdFrame]
    truth: GroundTruth | None = None
    has_features: bool = True
    fps: float = 30.0
    colour_only: bool = False
    guessed_camera: bool = False
    _actor: Actor | None = field(default=None, repr=False)
    _actor_file: Path | None = field(default=None, repr=False)

    def __len__(self) -> int:
        return len(self.neutral) + len(self.frames)

    def read(self, index: int) -> RgbdFrame:
        """Return frame ``index``, counted from 0, with the neutral frames first. Raises IndexError after the last one."""
        return self.neutral[index] if index < len(self.neutral) else self.frames[index - len(self.neutral)]

    @property
    def actor(self) -> Actor:
        """The rig, which is captured once from the neutral frames (section 3). Later sessions take it from the cache."""
        if self._actor is None:
            self._actor = None if self._actor_file is None else _cached(self._actor_file, Actor.load)
        if self._actor is None:
            self._actor = self._captured()
            if self._actor_file is not None:
                with _not_cached():
                    self._actor.save(self._actor_file)
        return self._actor

    def _captured(self) -> Actor:
        if not self.colour_only:
            return capture_source(self, Parameters(), neutral_frames=range(len(self.neutral)))
        actor = capture_source(self, Parameters())  # only the proportions, from frames with any expression
        if self.guessed_camera:  # the capture has found the focal length
            self.neutral, self.frames = ([replace(f, camera=self.camera) for f in some] for some in (self.neutral, self.frames))
        return actor

    def make_tracker(self, actor: Actor, parameters: Parameters) -> Tracker:
        """Make the tracker for these frames. For a video, it is the one without depth."""
        return make_tracker(actor, parameters, self.colour_only)

    def tracked(self, parameters: Parameters | None = None) -> Iterator[TrackedFrame]:
        """Track the performance with a new tracker and yield the result of every frame; our defaults without ``parameters``."""
        tracker = self.make_tracker(self.actor, parameters or Parameters())
        with one_thread():
            for frame in self.frames:
                yield tracker.track(frame)


def load_session(
    source: str | os.PathLike = "synthetic",
    neutral_frames: int | Sequence[int] = 16,
    frames: int | None = None,
    first: int = 0,
    cache: str | os.PathLike | None = None,
    actor: Actor | str | os.PathLike | None = None,
    needs_depth: bool = False,
) -> Session:
    """Load the performance of a notebook. For a recording, a note about its frames is printed first.

    Parameters
    ----------
    source : str or path-like
        "synthetic", "synthetic:SEED[:NOISE][:skin=SKIN]...", "lesson" (:mod:`..synthetic.lesson`), a recording or a video.
    neutral_frames : int or sequence of int
        Number of frames that make the rig, with the face at rest. In a recording, calm frames are chosen that show the face
        from as many sides as possible. A sequence, such as ``range(100, 140)``, names the frames.
    frames : int, optional
        Number of frames of performance, by default 100, or 300 for the lesson, or 24 if :func:`fast`. They follow the neutral
        frames. A short take is tracked as a whole.
    first : int
        Number of the first frame of a recording to use.
    cache : path-like, optional
        Folder for synthetic performances; the user's cache folder by default.
    actor : Actor or path-like, optional
        A known head or its file, for example from the live notebook. Nothing is captured then.
    needs_depth : bool
        Whether to refuse a video.

    Returns
    -------
    Session
        The performance.

    Raises
    ------
    AdaptiveFaceError
        The source or the actor cannot be used.
    """
    source, known = os.fspath(source), actor if actor is None or isinstance(actor, Actor) else Actor.load(actor)
    count = frames or (24 if fast() else LESSON_FRAMES if source == LESSON else 100)
    if source in ("synthetic", LESSON) or source.startswith("synthetic:"):
        if not isinstance(neutral_frames, int):
            raise AdaptiveFaceError(f"{source}: its first frames are the neutral ones; neutral_frames says how many")
        session = _synthetic(source, neutral_frames, count, Path(cache) if cache else cache_folder())
    else:
        session = _recorded(source, neutral_frames, count, first, known, needs_depth)
    if known is not None:
        session._actor, session._actor_file = known, None
        print(f"The head is {actor if known is not actor else 'the given one'}{_another(session, known)}.")
    return session


def _recorded(
    source: str, neutral_frames: int | Sequence[int], count: int, first: int, actor: Actor | None, needs_depth: bool
) -> Session:
    opened = open_source(source)
    known = Abilities.of(opened)
    if known.colour_only and needs_depth:
        raise AdaptiveFaceError(f"{source}: has no depth, which this notebook is about; 00, 02 and 09 work without")
    take = read_take(opened, neutral_frames, count, first)
    print(take.note)
    camera = take.frames[0].camera
    session = Session(opened.name, camera, take.neutral, take.frames, has_features=not known.colour_only, fps=known.fps)
    session.colour_only, session.guessed_camera = known.colour_only, known.guessed_camera
    if session.colour_only and actor is None:
        _ = session.actor  # this also finds the frames' focal length
    return session


def _another(session: Session, actor: Actor) -> str:
    """A note about a head that is not the performer's; "" if nothing is known about that."""
    truth = session.truth
    if truth is None or truth.neutral.shape != actor.neutral.shape:
        return ""
    placed = transform_points(neutral_alignment(actor.neutral, truth.neutral, actor.frontal), actor.neutral)
    distance = float(np.linalg.norm(placed - truth.neutral, axis=1)[actor.frontal].mean())
    if distance < ANOTHER:
        return ""
    return (
        f": another person's, whose face lies {distance:.1f} mm from the performer's. Set SOURCE to that person's recording; "
        'the live notebook\'s synthetic performer is "synthetic:0"'
    )


def _synthetic(source: str, neutral_frames: int, count: int, cache: Path | None) -> Session:
    """Render or load a performance of ``count`` frames, whose second half repeats the first one."""
    if cache is None:
        return _session(source, RenderedPerformance.render(source, neutral_frames, count), neutral_frames, None)
    asset = Path(__file__).resolve().parents[1] / "assets" / "face_model.npz"
    key = f"{CACHE_VERSION}|{source}|{neutral_frames}|{count}|{hashlib.sha256(asset.read_bytes()).hexdigest()}"
    stem = cache / f"performance-{hashlib.sha256(key.encode()).hexdigest()[:16]}"
    data_file, actor_file = stem.with_suffix(".npz"), stem.with_suffix(".actor.npz")

    data = _cached(data_file, RenderedPerformance.load)
    if data is None:
        data = RenderedPerformance.render(source, neutral_frames, count)
        with _not_cached():
            cache.mkdir(parents=True, exist_ok=True)
            write_npz(data_file, arrays(data), shared=True)
            actor_file.unlink(missing_ok=True)
            data = _cached(data_file, RenderedPerformance.load) or data
    return _session(source, data, neutral_frames, actor_file)


def _cached(path: Path, load: Callable[[Path], T]) -> T | None:
    """Load a file of the cache with ``load``, or return None if there is none. A damaged file is removed."""
    if not path.exists():
        return None
    try:
        return load(path)
    except (FileFormatError, OSError) as error:
        print(f"{path}: damaged, made again ({' '.join(str(error).removeprefix(f'{path}: ').split())[:80]})")
        with suppress(OSError):
            path.unlink()
        return None


@contextmanager
def _not_cached() -> Iterator[None]:
    """Continue without a cache if it cannot be written."""
    try:
        yield
    except (OSError, AdaptiveFaceError) as error:
        print(f"not kept for the next time: {error}")


def _session(source: str, data: RenderedPerformance, neutral_frames: int, actor_file: Path | None) -> Session:
    frames, name = StoredFrames(data), f"synthetic performer ({source})"
    neutral, performed = frames[:neutral_frames], frames[neutral_frames:]
    return Session(name, data.camera, neutral, performed, data.truth, _actor_file=actor_file)
