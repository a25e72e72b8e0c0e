"""Open sources with numbered frames by name."""

from __future__ import annotations

import shlex
from pathlib import Path

from ..errors import FileFormatError, ParameterError
from ..geometry.source import FrameSource
from ..synthetic.look import CHOICES, PERFORMER, parse_performer
from .file_player import plays
from .orientation import OrientedSource, split_mirrored
from .playback import NOISES
from .recording import Recording
from .video_file import VIDEO_SUFFIXES, VideoFile, is_video

_POSSIBLE = (
    "possible sources: a recording folder (with intrinsic.json, depth/, color/), a Record3D file (.r3d), "
    f"'synthetic' or 'synthetic:{PERFORMER}[@take.csv]' (NOISE: {', '.join(NOISES)}; SKIN: {', '.join(CHOICES['skin'])}; "
    f"LIGHT: {', '.join(CHOICES['light'])}; CAMERA: {', '.join(CHOICES['camera'])}; a Live Link Face CSV to perform), "
    f"a video, colour only ({', '.join(VIDEO_SUFFIXES)}); with ',mirrored' at the end pictures are flipped"
)


def open_source(text: str, field_of_view: float | None = None) -> FrameSource:
    """Open a source of numbered frames by name.

    Parameters
    ----------
    text : str
        The folder of a recording, an ``.r3d`` file, a video, or ``synthetic[:SEED[:NOISE]...][@take.csv]``.
        :mod:`adaptiveface.synthetic.look` lists the names of skins, lights and cameras. If the text ends in ``,mirrored``,
        the frames are flipped. This is for recordings that show a mirror image, as selfie videos do.
    field_of_view : float, optional
        Angle of a video across its longer side, degrees. :class:`.video_file.VideoFile` describes the default.

    Returns
    -------
    FrameSource
        The source. Those of this package are :class:`~adaptiveface.geometry.source.NumberedFrames`.

    Raises
    ------
    FileFormatError, ParameterError
        The source cannot be opened. The message lists the possible sources.
    """
    text, flipped = split_mirrored(text)
    source = _open(text, field_of_view)
    return OrientedSource(source, mirrored=True) if flipped else source


def _open(text: str, field_of_view: float | None) -> FrameSource:
    if field_of_view is not None and not is_video(text) and Path(text).exists():
        raise ParameterError(f"{text}: a field of view can be given for a video only; this source has its calibration")
    if Path(text).name == "intrinsic.json" and Path(text).is_file():  # the one file of a recording that a person may pick
        return Recording(Path(text).parent)
    if Path(text).is_dir():
        return Recording(text)
    if text == "synthetic" or text.startswith("synthetic:"):
        return _synthetic(text)
    if text.lower().endswith(".r3d") and Path(text).is_file():
        from .record3d import R3dRecording

        return R3dRecording(text)
    if plays(Path(text)):
        folder = Path(text).with_suffix("")
        convert = shlex.join(["adaptiveface", "convert", text, "--out", str(folder)])
        raise FileFormatError(f"{text}: plays from start to end only; first: {convert}; then use {folder}")
    if text.lower().endswith(".csv") and Path(text).is_file():
        export = shlex.join(["adaptiveface", "export", text, "--character", "hag"])
        raise FileFormatError(f"{text}: a take of curves has no pictures to track; it drives characters: {export}")
    if is_video(text):
        return VideoFile(text, field_of_view)
    if Path(text).exists():
        raise FileFormatError(f"{text}: not a folder; {_POSSIBLE}")
    raise FileFormatError(f"{text}: no such recording; {_POSSIBLE}")


def _synthetic(text: str) -> FrameSource:
    from ..synthetic.sensor import SyntheticSensor
    from ..synthetic.take import read_take

    performer, at, take = text.partition(":")[2].partition("@")
    try:
        seed, noise, look = parse_performer(performer)
    except ParameterError as error:
        raise ParameterError(f"{error}; {_POSSIBLE}") from None
    if at and not take:
        raise ParameterError(f"{text}: the name of a Live Link Face CSV is expected after the @; {_POSSIBLE}")
    return SyntheticSensor(seed or 0, noise or NOISES[0], take=read_take(take) if at else None, look=look)
