"""Encode and decode the datagrams that Live Link Face sends to Unreal: one per frame, over UDP, to port 11111.

A datagram of version 6 is big-endian. It holds, in this order,

* the version (1 byte);
* the names of device and subject, each as a length (4 bytes) and UTF-8 text;
* the frame number (int32), the part of a frame (float32), and the rate as numerator and denominator (int32 each);
* the number of values (1 byte), which is 61, and the values (float32). A frame without a face ends before the number.

The values are those of the CSV, but left comes before right for the jaw and the mouth, as in Unreal's ``EARFaceBlendShape``.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

import numpy as np

from .convention import ARKIT_NAMES, ROTATIONS

VERSION, PORT = 6, 11111
_COUNT = len(ARKIT_NAMES) + len(ROTATIONS)
#: Lengths of the longest datagram and the longest name that are read, bytes.
MAX_BYTES, MAX_NAME = 2048, 512
_TIME = struct.Struct(">ifii")
_SWAPPED = {"jawRight": "jawLeft", "jawLeft": "jawRight", "mouthRight": "mouthLeft", "mouthLeft": "mouthRight"}
#: (61,) position of every value of a datagram in the CSV's order. The permutation is its own inverse.
_ORDER = np.array([ARKIT_NAMES.index(_SWAPPED.get(name, name)) for name in ARKIT_NAMES] + list(range(len(ARKIT_NAMES), _COUNT)))


@dataclass(frozen=True)
class LiveLinkFrame:
    """One frame of a stream.

    ``time`` is in seconds since midnight, and ``tracked`` tells whether there was a face. ``curves`` (52,), ``head`` (3,) and
    ``eyes`` (6,) are as in a :class:`~adaptiveface.livelink.LiveLinkTake`.
    """

    time: float
    tracked: bool
    curves: np.ndarray
    head: np.ndarray
    eyes: np.ndarray
    subject: str = "adaptiveface"
    device: str = "adaptiveface"


def encode(frame: LiveLinkFrame, fps: int = 60) -> bytes:
    """Encode a frame as a datagram.

    Parameters
    ----------
    frame : LiveLinkFrame
        The frame to encode.
    fps : int
        Frames per second. The time is written in whole and partial frames of 1 / ``fps`` s.

    Returns
    -------
    bytes
        The datagram.
    """
    number = int(frame.time * fps)
    out = struct.pack(">B", VERSION)
    for text in (frame.device, frame.subject):
        raw = text.encode()[:MAX_NAME]
        out += struct.pack(">i", len(raw)) + raw
    out += _TIME.pack(number, frame.time * fps - number, fps, 1)
    if not frame.tracked:
        return out
    values = np.concatenate([frame.curves, frame.head, frame.eyes])[_ORDER]
    return out + struct.pack(">B", _COUNT) + values.astype(">f4").tobytes()


def decode(data: bytes) -> LiveLinkFrame:
    """Decode a datagram.

    Parameters
    ----------
    data : bytes
        The datagram.

    Returns
    -------
    LiveLinkFrame

    Raises
    ------
    ValueError
        The datagram is not from Live Link Face. The message gives the reason.
    """
    if len(data) > MAX_BYTES:
        raise ValueError(f"{len(data)} bytes are too many")
    try:
        if data[0] != VERSION:
            raise ValueError(f"version {data[0]} of the protocol; Live Link Face sends {VERSION}")
        device, at = _text(data, 1)
        subject, at = _text(data, at)
        number, part, numerator, denominator = _TIME.unpack_from(data, at)
    except (IndexError, struct.error):
        raise ValueError("ends within its header") from None
    at += _TIME.size
    if numerator <= 0 or denominator <= 0 or not np.isfinite(part):
        raise ValueError("a frame rate or time that is none")
    time = (number + part) * denominator / numerator
    if len(data) <= at + 1:
        return LiveLinkFrame(time, False, np.zeros(len(ARKIT_NAMES)), np.zeros(3), np.zeros(6), subject, device)
    if data[at] != _COUNT or len(data) < at + 1 + 4 * _COUNT:
        raise ValueError(f"{data[at]} values in {len(data) - at - 1} bytes instead of {_COUNT}")
    values = np.frombuffer(data, ">f4", _COUNT, at + 1).astype(float)
    if not np.isfinite(values).all():
        raise ValueError("values that are not finite")
    values = np.clip(values, -10.0, 10.0)[_ORDER]
    curves, head, eyes = np.split(values, [len(ARKIT_NAMES), len(ARKIT_NAMES) + 3])
    return LiveLinkFrame(time, True, curves, head, eyes, subject, device)


def _text(data: bytes, at: int) -> tuple[str, int]:
    (length,) = struct.unpack_from(">i", data, at)
    if not 0 <= length <= MAX_NAME or at + 4 + length > len(data):
        raise ValueError(f"a name of {length} bytes")
    raw = data[at + 4 : at + 4 + length]
    text = raw.decode("utf-8", "replace").rstrip("\0")
    return "".join(c for c in text if c.isprintable()), at + 4 + length
