"""Read the video stream of a file with PyAV: which frames are shown, when, and their pictures in order.

OpenCV reports a single rate and the number of frames in the index, although edit lists and damage may leave fewer. FFmpeg's
demuxer knows better: its packets tell when each frame is shown, and which frames the edit list leaves out.
"""

from __future__ import annotations

from collections.abc import Generator, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np

from ..errors import FileFormatError, MissingExtraError
from ..geometry.camera import MAX_PIXELS
from ..runtime.timing import DEFAULT_RATE, frame_rate, standard_rate

#: The last frames are decoded to find the end of a file, unless there are more than this and nothing is missing.
MAX_TAIL = 600
#: Files that name other files or addresses (a playlist under a video's name) are refused.
_FORMATS = "mov,mp4,m4a,3gp,3g2,mj2,avi,matroska,webm,asf,mpegts,mpeg,mpegvideo,flv,ogg"
_ONLY = {"protocol_whitelist": "file", "format_whitelist": _FORMATS}
#: FFmpeg's own limit. It also applies while the streams are examined, and when the size changes within a film.
_LIMITS = {"max_pixels": str(MAX_PIXELS)}


@lru_cache(maxsize=1)
def av_module():
    """Return PyAV. Raises :class:`MissingExtraError` if it is not installed.

    No log level may be set, because its decoding threads may then wait for ever for Python's lock.
    """
    try:
        import av
    except ImportError as error:
        hint = 'pip install "adaptiveface[landmarks]" (or: pip install av)'
        raise MissingExtraError(f"reading a video needs PyAV: {hint} ({error})") from None
    return av


@dataclass(frozen=True)
class VideoIndex:
    """The frames of a video that play.

    Attributes
    ----------
    seconds : (F,)
        Time of each frame after the first one, s.
    stamps : (F,) int64 or None
        Time of each frame in the stream's unit, if the stream has times.
    fps : float
        Frames per second.
    stated : int
        Number of frames that the file promises. It is larger than F if the file is cut off.
    """

    seconds: np.ndarray
    stamps: np.ndarray | None
    fps: float
    stated: int


@contextmanager
def _opened(path: Path) -> Iterator[tuple]:
    """Open a file. Yields the container and its picture stream, and turns FFmpeg's errors into :class:`FileFormatError`."""
    av = av_module()
    try:
        with av.open(str(path), options=_ONLY | _LIMITS, metadata_errors="replace") as container:
            stream = next((s for s in container.streams.video if not _is_cover(s)), None)
            if stream is None:
                raise FileFormatError(f"{path}: not a video that can be decoded, or one without pictures")
            if stream.codec_context is None or not 0 < stream.width * stream.height <= MAX_PIXELS:
                large = f"pictures of more than {MAX_PIXELS} pixels"
                raise FileFormatError(f"{path}: a stream that cannot be decoded, or {large}, which are not read")
            stream.codec_context.options = _LIMITS
            stream.thread_type = "AUTO"
            yield container, stream
    except (av.error.FFmpegError, UnicodeError) as error:
        reason = (error.strerror if isinstance(error, av.error.FFmpegError) else "") or str(error)
        raise FileFormatError(f"{path}: not a video that can be decoded, or one without pictures ({reason})") from None


def _is_cover(stream) -> bool:
    return bool(stream.disposition & av_module().stream.Disposition.attached_pic)


def read_index(path: Path) -> VideoIndex:
    """Find the frames of a video that play.

    Parameters
    ----------
    path : Path
        The file.

    Returns
    -------
    VideoIndex
        The frames.

    Raises
    ------
    FileFormatError
        The file is not a video that can be decoded.
    """
    with _opened(path) as (container, stream):
        rate, stated = float(stream.average_rate or stream.guessed_rate or 0), int(stream.frames)
        rate = standard_rate(rate) if 0.1 <= rate <= 1000 else DEFAULT_RATE
        shown, keys, listed = _packets(container, stream)
        if shown is None:  # an AVI has no times but a constant rate
            return VideoIndex(np.arange(_count(container, stream)) / rate, None, rate, stated)
        promised = len(shown) + max(0, stated - listed)
        tail = int((shown >= keys[-1]).sum()) if len(keys) else len(shown)
        if stated != listed or tail <= MAX_TAIL:
            shown = shown[shown <= _last_decodable(container, stream, keys)]
        seconds = (shown - shown[:1]) * float(stream.time_base)
    return VideoIndex(seconds, shown, frame_rate(seconds) if len(seconds) > 1 else rate, promised)


def _packets(container, stream) -> tuple[np.ndarray | None, np.ndarray, int]:
    """Return the sorted stamps of the frames that play and of the key frames, and the number of packets."""
    shown, keys, listed = [], [], 0
    timed = "avi" not in container.format.name.split(",")
    for packet in _demuxed(container, stream):
        listed += 1
        timed = timed and packet.pts is not None
        if timed and packet.is_keyframe:
            keys.append(packet.pts)
        if timed and not packet.is_discard:
            shown.append(packet.pts)
    stamps = np.unique(np.array(shown, np.int64)) if timed and shown else None
    return stamps, np.array(sorted(keys), np.int64), listed


def _demuxed(container, stream) -> Iterator:
    """Yield the packets with content, up to the end or to the place where the file is cut off."""
    packets = container.demux(stream)
    while True:
        try:
            packet = next(packets)
        except (StopIteration, av_module().error.FFmpegError):
            return
        if packet.size:
            yield packet


def _last_decodable(container, stream, keys: np.ndarray) -> int:
    """Return the stamp of the last frame that can be decoded. A file that is cut off lists frames behind it."""
    for key in keys[::-1][:3]:
        container.seek(int(key), stream=stream, backward=True)
        last = max(_sound(container, stream), default=None)
        if last is not None:
            return last
    container.seek(0)
    return max(_sound(container, stream), default=-(1 << 62))


def _sound(container, stream) -> Iterator[int]:
    """Yield the stamps of the frames from here on that can be decoded without damage."""
    return (f.pts for f in _decoded(container, stream) if f.pts is not None and not f.is_corrupt)


def _count(container, stream) -> int:
    container.seek(0)
    return sum(1 for _ in _decoded(container, stream))


def _decoded(container, stream) -> Iterator:
    """Yield the frames in the order in which they are shown. Damaged packets are skipped."""
    error = av_module().error.FFmpegError
    for packet in _demuxed(container, stream):
        try:
            yield from packet.decode()
        except error:
            continue
    try:
        yield from stream.decode(None)
    except error:
        return


def pictures(path: Path) -> Generator[tuple[int | None, np.ndarray], None, None]:
    """Decode a video.

    Parameters
    ----------
    path : Path
        The file.

    Yields
    ------
    stamp : int or None
        Time of a frame in the stream's unit.
    picture : (H, W, 3) uint8
        The frame's RGB picture, turned by the rotation that the file states.
    """
    with _opened(path) as (container, stream):
        for frame in _decoded(container, stream):
            if not frame.is_corrupt:
                picture = np.rot90(frame.to_ndarray(format="rgb24"), round(frame.rotation / 90))
                yield frame.pts, np.ascontiguousarray(picture)
