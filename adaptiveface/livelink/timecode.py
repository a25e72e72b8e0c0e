"""Convert timecodes of hours, minutes, seconds and frames, with thousandths of a frame, to seconds and back."""

from __future__ import annotations

import re

import numpy as np

#: Frames that Live Link Face counts per second by default.
TIMECODE_FPS = 60
_RATES = (24, 25, 30, 48, 50, 60, 120, 240)
_FORM = re.compile(r"(\d{1,4}):(\d{1,2}):(\d{1,2})(?:[:;](\d{1,3}(?:\.\d*)?)|(\.\d+))?")
_DAY = 86_400.0


def timecode(seconds: float) -> str:
    """Return ``HH:MM:SS:FF.mmm`` with frames of 1/60 s and thousandths of a frame."""
    thousandths = round(seconds * TIMECODE_FPS * 1000)
    frames, thousandth = divmod(thousandths, 1000)
    total, frame = divmod(frames, TIMECODE_FPS)
    return f"{total // 3600:02d}:{total // 60 % 60:02d}:{total % 60:02d}:{frame:02d}.{thousandth:03d}"


def parse(text: str) -> tuple[float, float | None]:
    """Read a timecode.

    Returns
    -------
    tuple
        Whole seconds and frames of ``HH:MM:SS:FF.mmm``, or seconds and None of ``HH:MM:SS.mmm``.

    Raises
    ------
    ValueError
        The text has neither form.
    """
    match = _FORM.fullmatch(text.strip())
    if match is None:
        raise ValueError(text)
    hours, minutes, seconds, frames, fraction = match.groups()
    whole = int(hours) * 3600 + int(minutes) * 60 + int(seconds)
    return (whole + float(fraction or 0), None) if frames is None else (float(whole), float(frames))


def to_seconds(parts: list[tuple[float, float | None]]) -> np.ndarray:
    """Return the (F,) seconds of timecodes from :func:`parse`. In a take that crosses midnight, they continue beyond 24 hours.

    Timecodes do not contain the frame rate, which is assumed to be 60. If a take with 20 rows per second or more never counts
    that far, the rate is the next usual one above the largest frame number.
    """
    whole = np.array([second for second, _ in parts], float)
    frames = np.array([frame or 0.0 for _, frame in parts], float)
    rate = TIMECODE_FPS
    passed = len(np.unique(whole)) - 2  # whole seconds for which the take has every frame
    if (passed > 0 and len(parts) >= 20 * (passed + 2)) or frames.max(initial=0) >= TIMECODE_FPS:
        rate = next((rate for rate in _RATES if frames.max(initial=0) < rate), _RATES[-1])
    seconds = whole + frames / rate
    return seconds + _DAY * np.cumsum(np.diff(seconds, prepend=seconds[:1]) < -_DAY / 2)
