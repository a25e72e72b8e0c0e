"""Tell recordings of Azure Kinect in Matroska files (.mkv) from plain videos.

Both have the same suffix. Only Azure's recorder writes tags K4A_... and attaches calibration.json. Only headers are read: the
walk goes from element to element and skips the pictures (RFC 8794, RFC 9559).
"""

from __future__ import annotations

from pathlib import Path
from typing import BinaryIO

from ..errors import FileFormatError
from ..files import open_regular

#: Identifiers of the elements that are opened or searched.
_EBML, _SEGMENT = 0x1A45DFA3, 0x18538067
_TAGS, _TRACKS, _ATTACHMENTS = 0x1254C367, 0x1654AE6B, 0x1941A469
#: Marks of Azure Kinect's recorder in tags, track names and attachments.
_MARKS = (b"K4A_", b"calibration.json")
#: Most bytes of one element that are searched, and most elements walked over (an hour has some thousand clusters).
_MAX_SEARCHED, _MAX_ELEMENTS = 4 << 20, 200_000


def is_plain_video(path: Path) -> bool:
    """Return whether a file is a Matroska video without the marks of Azure Kinect's recorder."""
    try:
        with open_regular(path, 1 << 62) as stream:
            return _is_matroska(stream) and not _has_marks(stream, path.stat().st_size)
    except (OSError, FileFormatError):
        return False


def _is_matroska(stream: BinaryIO) -> bool:
    """Return whether a segment follows the header. If so, the stream is left at its first element."""
    header = _element(stream)
    if header is None or header[0] != _EBML or header[1] is None:
        return False
    stream.seek(header[1], 1)
    segment = _element(stream)
    return segment is not None and segment[0] == _SEGMENT


def _has_marks(stream: BinaryIO, length: int) -> bool:
    for _ in range(_MAX_ELEMENTS):
        element = _element(stream)
        identifier, size = element or (0, None)
        if size is None:  # the end, or a cluster of unknown size as in a file that is cut off
            return False
        end = stream.tell() + size
        if identifier in (_TAGS, _TRACKS, _ATTACHMENTS):
            content = stream.read(min(size, _MAX_SEARCHED))
            if any(mark in content for mark in _MARKS):
                return True
        if end >= length:
            return False
        stream.seek(end)
    return False


def _element(stream: BinaryIO) -> tuple[int, int | None] | None:
    """Return identifier and size of the element that begins here, or None if there is none. An unknown size is None."""
    identifier, _ = _number(stream, most=4, keep_marker=True)
    size, width = _number(stream, most=8, keep_marker=False)
    if identifier is None or size is None:
        return None
    return identifier, None if size == (1 << (7 * width)) - 1 else size


def _number(stream: BinaryIO, most: int, keep_marker: bool) -> tuple[int | None, int]:
    """Return a number whose first bits tell its width in bytes, and that width; (None, 0) if there is none."""
    first = stream.read(1)
    if not first or not first[0]:
        return None, 0
    width = 9 - first[0].bit_length()
    rest = stream.read(width - 1)
    if width > most or len(rest) < width - 1:
        return None, 0
    value = first[0] if keep_marker else first[0] & ((1 << (8 - width)) - 1)
    return int.from_bytes(bytes([value]) + rest, "big"), width
