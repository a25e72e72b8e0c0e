"""Choose which frames of a recording or a video are tracked, and which ones make the neutral face."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..errors import AdaptiveFaceError
from ..geometry.frame import RgbdFrame
from ..geometry.mesh import surface_points
from ..geometry.source import Abilities
from ..model import face_model
from ..neutral.choice import doubts, judge
from ..neutral.coverage import choose_by_coverage
from ..neutral.take import face_found
from ..pipeline import FrameReader
from ..sensors import FrameSource

DEGRADED = "without depth, degraded: pose and expression come from the 2D features, and nothing is learned"

#: The consequence of a doubtful neutral, which follows the reason for the doubt.
DOUBTFUL = "{} Every expression is measured from this face, so that its own expression is missing from all of them."
#: Says how the head of a video is made.
PROPORTIONS = "The head has the person's proportions only. They come from all of these frames, with any expression."
#: How to name the frames of the neutral face.
NAMED = "load_session(..., neutral_frames=range(100, 140))"


@dataclass(frozen=True)
class Take:
    """The frames of a source that a session uses.

    Attributes
    ----------
    neutral, frames : list of RgbdFrame
        Of the neutral face and of the performance, with features.
    note : str
        What is tracked, and why not more.
    """

    neutral: list[RgbdFrame]
    frames: list[RgbdFrame]
    note: str


def read_take(source: FrameSource, neutral_frames: int | Sequence[int], count: int, first: int = 0) -> Take:
    """Read what a session needs of a recording.

    Parameters
    ----------
    source : FrameSource
        A recording or a video.
    neutral_frames : int or sequence of int
        The number of frames that :func:`~adaptiveface.neutral.coverage.choose_by_coverage` chooses, or the numbers of
        the frames.
    count : int
        Number of frames of performance. If the take is too short for both, the neutral frames are tracked as well.
    first : int
        Number of the first frame to use.

    Returns
    -------
    Take
        The frames, and a note about them.

    Raises
    ------
    AdaptiveFaceError
        No frame can be used, none of the named ones shows a face, or ``neutral_frames`` is a number below 1.
    """
    leading, names = (neutral_frames, range(0)) if isinstance(neutral_frames, int) else (0, neutral_frames)
    if isinstance(neutral_frames, int) and leading < 1:
        raise AdaptiveFaceError(f"neutral_frames = {leading}: at least 1 frame of {source.name} must show the face at rest")
    named: list[RgbdFrame] = []
    found: list[RgbdFrame] = []
    with FrameReader(source) as reader:
        for index in sorted({k for k in names if 0 <= k < len(source)}):
            named += [frame for frame in [reader.read(index)] if frame is not None and face_found(frame)]
        for index in range(max(first, 0), len(source)):
            if len(found) >= leading + count:
                break
            found += [frame for frame in [reader.read(index)] if frame is not None]
        skipped = dict(reader.skipped)
    if not found:
        why = f"; {len(skipped)} broken frames, the first: {next(iter(skipped.values()))}" if skipped else ""
        raise AdaptiveFaceError(f"{source.name}: none of the frames from {first} on can be used; it has {len(source)}{why}")
    if not leading and not named:
        raise AdaptiveFaceError(f"{source.name}: no face is seen in the {numbers(names)}, named as the neutral")
    neutral, said = _named(named) if named else _chosen(found, leading)
    taken = {frame.index for frame in neutral}
    leads = bool(leading) and {f.index for f in found[: len(taken)]} == taken and len(found) >= len(taken) + count
    frames = (found[len(taken) :] if leads else found)[:count]
    return Take(neutral, frames, _note(source, neutral, frames, skipped, said))


def _chosen(found: list[RgbdFrame], count: int) -> tuple[list[RgbdFrame], str]:
    """The neutral frames and a note about them. Without any face, they are the first frames."""
    faces = [frame for frame in found if face_found(frame)]
    choice = choose_by_coverage(faces, _feature_points(), count)
    said = DOUBTFUL.format(_sentence(choice.note)) if choice.doubtful else _sentence(choice.note)
    return [faces[k] for k in choice.picked] or found[:count], said and f"{said} {NAMED} names others."


def _named(frames: list[RgbdFrame]) -> tuple[list[RgbdFrame], str]:
    """The named frames, and a note about what is doubtful about them."""
    points = _feature_points()
    trouble = doubts([judge(frame, points) for frame in frames])
    return frames, trouble and DOUBTFUL.format(f"The neutral frames are doubtful: of {len(frames)}, {trouble}.")


def _feature_points() -> np.ndarray:
    """The model's features, (40, 3) mm."""
    model = face_model.embedded_face_model()
    return surface_points(model.mean, model.feature_triangles, model.feature_weights)


def _sentence(words: str) -> str:
    return words and f"{words[0].upper()}{words[1:]}."


def _note(source: FrameSource, neutral: list[RgbdFrame], frames: list[RgbdFrame], skipped: dict[int, str], said: str) -> str:
    """Say how many frames are tracked and why not more, what the neutral is, and what is doubtful about it, on a line each."""
    what = f"all {len(source)} frames are tracked"
    if len(frames) < len(source):
        what = f"{len(frames)} of {len(source)} frames are tracked, {numbers([frame.index for frame in frames])}"
        what += "; load_session(..., frames=300) takes more" if frames[-1].index + 1 < len(source) else ""
    if skipped:
        what += f"; {len(skipped)} cannot be used, the first: {next(iter(skipped.values()))}"
    unseen = sum(not face_found(frame) for frame in frames)
    if unseen:
        what += f"; {unseen} of them show no face"
    tracked = f"{source.name}: {what}."
    if Abilities.of(source).colour_only:
        return "\n".join([f"{source.name}: {DEGRADED}.", tracked, PROPORTIONS])
    inside = {frame.index for frame in neutral} & {frame.index for frame in frames}
    face = f"The neutral face: {numbers([frame.index for frame in neutral])}"
    face += ", which are tracked as well." if inside else "."
    return "\n".join(line for line in (tracked, face, said) if line)


def numbers(indices: Sequence[int]) -> str:
    """Write frame numbers in words: "frames 3 to 7", "frame 3", "5 frames from 3 to 40"."""
    low, high = min(indices, default=0), max(indices, default=0)
    if low == high:
        return f"frame {low}"
    return f"frames {low} to {high}" if high - low + 1 == len(indices) else f"{len(indices)} frames from {low} to {high}"
