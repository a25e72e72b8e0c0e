"""Judge, repair and convert the times of frames, for every reader and every writer.

A reader passes the times of its file or device to :func:`frame_times`. A writer asks for times that rise from 0
(:func:`increasing`), for the rate (:func:`frame_rate`), or for the frame that a film shows at each moment
(:func:`film_frames`, :func:`gif_frames`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ..errors import FileFormatError

#: Rates at which cameras and programs work, frames per second. NTSC's are 1000/1001 of a whole number.
STANDARD_RATES = tuple(
    sorted(
        (5.0, 10.0, 12.0, 12.5, 15.0, 20.0, 24.0, 25.0, 30.0, 48.0, 50.0, 60.0, 90.0, 100.0, 120.0, 240.0)
        + tuple(1000 * n / 1001 for n in (24, 30, 48, 60, 120, 240))
    )
)
#: Largest relative distance at which a measured rate counts as a standard one. The times themselves do not change.
RATE_TOLERANCE = 0.005
#: Rate of a take whose times do not tell it, frames per second.
DEFAULT_RATE = 30.0
#: Times that lie nearer together than this are the same, s.
SAME = 1e-6
#: Longest film that is written, s.
MAX_FILM_SECONDS = 6 * 3600.0

#: Units in which files give times: name, and length in seconds.
_UNITS = (("milliseconds", 1e-3), ("microseconds", 1e-6), ("steps of 100 ns", 1e-7), ("nanoseconds", 1e-9))
#: Largest factors between the median step and 1 / fps, for times in seconds and for times in another unit.
_FAR, _UNIT_FAR = 12.0, 3.0
#: Costs of explaining the times of a take: of a wrong value, a pause, a clock that starts again, and at most of an uneven step.
_WRONG, _PAUSE, _RESTART, _UNEVEN = 1.0, 2.5, 4.0, 0.5
#: Largest number of wrong values in a row. After more of them, the clock counts as another one.
_WINDOW = 12


@dataclass(frozen=True)
class FrameTimes:
    """Strictly increasing times ``seconds`` (F,) float64, with a line in ``notes`` for everything that was changed."""

    seconds: np.ndarray
    notes: tuple[str, ...] = ()


def frame_times(
    known: Mapping[int, float], count: int, fps: float = DEFAULT_RATE, name: str = "times", strict: bool = True
) -> FrameTimes:
    """Find the times of ``count`` frames, given what a file says about some of them.

    Parameters
    ----------
    known : mapping of int to float
        Time of each known frame (0-based). NaN and infinity count as unknown.
    count : int
        Number of frames.
    fps : float
        Nominal frames per second. They distinguish seconds from other units, and continue the times before the first known
        frame and after the last one.
    name : str
        Name of the file or sensor, for the notes and the error.
    strict : bool
        Whether to refuse a median step that fits no unit. Otherwise the times are taken to be in seconds.

    Returns
    -------
    FrameTimes
        Milliseconds, microseconds, units of 100 ns, nanoseconds and frame numbers are converted to seconds. Single values
        that repeat, fall back or lie far off are replaced according to their neighbours. A clock that starts again continues
        from where it was. Good values and real pauses do not change.

    Raises
    ------
    FileFormatError
        The median step is far from 1 / ``fps`` in every unit.
    """
    nominal = np.arange(count) / fps
    index = np.array(sorted(i for i, value in known.items() if 0 <= i < count and np.isfinite(value)), int)
    values = np.array([known[i] for i in index], float)
    if len(index) == 0:
        return FrameTimes(nominal)
    if len(index) == 1:
        return FrameTimes(nominal + values[0] - nominal[index[0]])
    values, notes = _in_seconds(index, values, fps, name, strict)
    index, values, repairs = _repaired(index, values, name)
    if len(index) < 2:
        return FrameTimes(nominal, (*notes, *repairs))
    delay = np.interp(np.arange(count), index, values - index / fps)
    return FrameTimes(nominal + delay, (*notes, *repairs))


def clean_times(timestamps: np.ndarray, name: str = "times") -> FrameTimes:
    """Repair the times (F,) of a finished take, whose nominal rate is no longer known. This never raises an error."""
    times = np.asarray(timestamps, float)
    steps = np.diff(times)
    rising = steps[np.isfinite(steps) & (steps > SAME)]
    unit = next((u for n, u in _UNITS if len(rising) and _near(np.median(rising) * u * DEFAULT_RATE, _UNIT_FAR)), 1.0)
    rate = 1.0 / (unit * float(np.median(rising))) if len(rising) else DEFAULT_RATE
    return frame_times(dict(enumerate(times)), len(times), rate, name, strict=False)


def increasing(timestamps: np.ndarray) -> np.ndarray:
    """Return the times (F,) of a take from 0 on, strictly increasing, s. They are repaired as by :func:`frame_times`."""
    times = clean_times(timestamps).seconds
    return times - times[:1]


def frame_rate(timestamps: np.ndarray) -> float:
    """Find the frames per second of increasing times (F,) s: a standard rate if one is near, or 30 if they do not tell."""
    steps = np.diff(np.asarray(timestamps, float))
    steps = steps[steps > SAME]
    if len(steps) == 0:
        return DEFAULT_RATE
    middle = float(np.median(steps))
    usual = steps[(steps > 0.5 * middle) & (steps < 1.5 * middle)]  # their mean has more digits than any one of them
    return standard_rate(1.0 / float(np.mean(usual)))


def standard_rate(rate: float, tolerance: float = RATE_TOLERANCE) -> float:
    """Return the standard rate nearest to ``rate`` frames per second if it is near enough, and ``rate`` otherwise."""
    nearest = min(STANDARD_RATES, key=lambda standard: abs(standard - rate))
    return nearest if abs(nearest - rate) <= tolerance * rate else rate


def time_codes(timestamps: np.ndarray, rate: float) -> np.ndarray:
    """Return the (F,) frame codes of times (F,) s at ``rate`` per second. They are whole if the times fit within rounding."""
    codes = np.asarray(timestamps, float) * rate
    whole = np.rint(codes)
    return np.where(np.abs(codes - whole) < 0.02, whole, codes)


def duration(timestamps: np.ndarray) -> float:
    """Return how long a take of increasing times (F,) lasts, s. Its last frame lasts as long as most frames do."""
    times = np.asarray(timestamps, float)
    return float(times[-1] - times[0] + 1.0 / frame_rate(times)) if len(times) else 0.0


def film_frames(timestamps: np.ndarray, rate: float | None = None) -> tuple[float, np.ndarray]:
    """Choose what a film of constant rate shows.

    A frame is repeated until the next one is due, so that the film lasts as long as the take.

    Parameters
    ----------
    timestamps : (F,) array
        Increasing times of the take, s.
    rate : float, optional
        Frames per second. By default, this is the take's own rate, or a higher standard rate if frames would be left out.

    Returns
    -------
    rate : float
        Frames per second of the film.
    frames : (n,) array
        Number of the frame that each picture shows.

    Raises
    ------
    FileFormatError
        The take is longer than ``MAX_FILM_SECONDS``.
    """
    times = np.asarray(timestamps, float)
    if duration(times) > MAX_FILM_SECONDS:
        limit = f"a film at most {MAX_FILM_SECONDS:.0f} s; correct its timestamps"
        raise FileFormatError(f"the take lasts {duration(times):.0f} s by its times, {limit}")
    times = times - times[:1]
    rate = rate or _film_rate(times)
    count = max(1, round(duration(times) * rate)) if len(times) else 0
    due = np.floor(times * rate + 0.5 + 1e-6)
    return rate, np.maximum(np.searchsorted(due, np.arange(count), side="right") - 1, 0)


def gif_frames(timestamps: np.ndarray, rate: float = 15.0) -> tuple[np.ndarray, np.ndarray]:
    """Choose the frames (n,) of increasing times (F,) s that a GIF shows, at most ``rate`` per second, and for how long, ms.

    GIF counts hundredths of a second. The moments are rounded, and not the steps, so that rounding errors do not add up.
    """
    own = frame_rate(timestamps)
    rate, shown = film_frames(timestamps, min(rate, own))
    starts = np.flatnonzero(np.diff(shown, prepend=-1))
    bounds = np.rint(np.append(starts, len(shown)) * 100.0 / rate).astype(int)
    return shown[starts], 10 * np.diff(bounds)


def _film_rate(times: np.ndarray) -> float:
    """Return the take's own rate, or the rate of a part that is clearly faster, up to 60 per second."""
    own = standard_rate(frame_rate(times), 0.03)
    span = min(8, len(times) - 1)  # over this many frames, jitter does not matter
    if span < 1:
        return own
    fast = 1.0 / max(float(np.percentile((times[span:] - times[:-span]) / span, 10)), SAME)
    return own if fast < 1.25 * own else max(own, standard_rate(min(fast, 60.0), 0.03))


def _near(ratio: float, factor: float) -> bool:
    return 1.0 / factor <= ratio <= factor


def _in_seconds(index, values, fps: float, name: str, strict: bool) -> tuple[np.ndarray, list[str]]:
    first = np.append(True, np.diff(values) != 0)  # a coarse clock repeats its times
    steps = np.diff(values[first]) / np.diff(index[first])
    rising = steps[steps > 0]
    if len(rising) == 0:
        return values, []
    step = float(np.median(rising))
    if fps >= 2.5 and len(rising) > 2 and (np.rint(values) == values).all() and step == 1.0:
        return values / fps, [f"{name}: counts frames (0, 1, 2, ...); taken as {fps:g} a second"]
    if _near(step * fps, _FAR):
        return values, []
    for unit, seconds in _UNITS:
        if _near(step * seconds * fps, _UNIT_FAR):
            text = f"{name}: a median step of {step:g} at {fps:g} frames a second: {unit}, converted to seconds"
            return values * seconds, [text]
    if strict:
        raise FileFormatError(
            f"{name}: a median step of {step:g} s does not fit {fps:g} frames a second ({1 / fps:.4g} s); "
            "write the times in seconds, or correct fps"
        )
    return values, []


def _repaired(index, values, name: str) -> tuple[np.ndarray, np.ndarray, list[str]]:
    """Return the frames whose times can be used, these times, and notes about the others."""
    if (np.diff(values) > SAME).all() and not _pauses(index, values).any():
        return index, values, []
    first = np.append(True, np.abs(np.diff(values)) > SAME)  # the first of a run of equal times
    steps = np.diff(values[first]) / np.diff(index[first])
    if not (steps > 0).any():
        return index[:0], values[:0], [f"{name}: the times do not rise; those of the frame rate are used"]
    step = float(np.median(steps[steps > 0]))
    kept = np.flatnonzero(first)[_best_chain(index[first], values[first], step)]
    out, restarts = values[kept].copy(), []
    for k in range(1, len(kept)):
        if values[kept[k]] - values[kept[k - 1]] <= SAME:
            out[k:] += out[k - 1] + step * (index[kept[k]] - index[kept[k - 1]]) - out[k]
            restarts.append(kept[k])
    wrong = np.setdiff1d(np.arange(len(index)), kept)
    if len(np.setdiff1d(np.flatnonzero(first), kept)) + len(restarts) > 0.5 * first.sum():
        return index[:0], values[:0], [f"{name}: the times are in no order; those of the frame rate are used"]
    notes = [
        f"{name}: the clock starts again at frame {index[k]} ({values[k]:.6g} s after {values[k - 1]:.6g} s); the times "
        "go on from there"
        for k in restarts[:3]
    ]
    if len(wrong):
        shown = ", ".join(f"frame {index[k]} ({values[k]:.6g} s)" for k in wrong[:3]) + (", ..." if len(wrong) > 3 else "")
        subject = "1 time does" if len(wrong) == 1 else f"{len(wrong)} times do"
        notes.append(f"{name}: {subject} not fit their neighbours and took theirs instead: {shown}")
    return index[kept], out, notes


def _pauses(index, values) -> np.ndarray:
    """Return an (n - 1,) mask of the steps that are far too long."""
    gaps, elapsed = np.diff(index), np.diff(values)
    step = float(np.median(elapsed / gaps))
    return elapsed - gaps * step > max(5.0, 30.0 * step)


def _best_chain(index, values, step: float) -> np.ndarray:
    """Find the values that explain the take at the lowest cost, by a shortest path over the kept values."""
    n = len(values)
    cost, before = _WRONG * np.arange(n, dtype=float), np.full(n, -1)
    for j in range(1, n):
        i = np.arange(max(0, j - _WINDOW), j)
        gaps, elapsed = index[j] - index[i], values[j] - values[i]
        uneven = np.minimum(0.05 * np.abs(np.log(np.maximum(elapsed, SAME) / (gaps * step))), _UNEVEN)
        link = np.where(elapsed - gaps * step > max(5.0, 30.0 * step), _PAUSE, uneven)
        total = cost[i] + _WRONG * (j - 1 - i) + np.where(elapsed <= SAME, _RESTART, link)
        best = int(np.argmin(total))
        if total[best] < cost[j]:
            cost[j], before[j] = total[best], i[best]
    chain = [int(np.argmin(cost + _WRONG * (n - 1 - np.arange(n))))]
    while before[chain[-1]] >= 0:
        chain.append(int(before[chain[-1]]))
    return np.array(chain[::-1])
