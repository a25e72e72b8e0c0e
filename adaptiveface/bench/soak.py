"""Run the live chain at full speed to see whether memory, threads or files grow: ``adaptiveface bench --soak MINUTES``."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass

import numpy as np
from scipy import stats

from ..errors import MissingExtraError
from ..live import FeatureFeed, LiveSession
from ..parameters import Parameters
from .live import FastDriver, TimedDetector, live_scene

#: Length of the warm-up as a share of the measured time, and its largest value, s. In this time buffers fill, and the C
#: allocator finds its working size. Sampled over 45 minutes, the allocator asked for its last 40 KiB between the third and
#: the fifteenth minute in ever rarer steps, while the bytes in use and Python's blocks stayed constant, and for nothing later.
WARM_UP_SHARE, WARM_UP_MOST = 0.5, 900.0
#: Number of blocks to whose means the line is fitted.
BLOCKS = 100


@dataclass(frozen=True)
class Trend:
    """A line through samples: ``slope`` per minute, with the half width ``margin`` of its 95 % confidence interval."""

    slope: float
    margin: float

    @property
    def zero(self) -> bool:
        """Whether the interval contains zero."""
        return abs(self.slope) <= self.margin


def trend(seconds: np.ndarray, values: np.ndarray, blocks: int = BLOCKS) -> Trend:
    """Fit a line to the block means of ``values`` (n,) at ``seconds`` (n,) by generalised least squares, per minute.

    Allocators take memory in steps and keep it, so that neighbouring means are not independent. Plain regression finds a
    "significant" slope in most series that only wander (Nelson & Kang 1984, "Pitfalls in the use of time as an explanatory
    variable in regression"). With a single step in 25 minutes, it did so in 88 % of 400 simulated runs. The errors are
    therefore assumed to be autoregressive, and to be a random walk if their coefficient is within n^-1/2 of one. The interval
    then holds for steady memory and for wandering memory (Perron & Yabu 2009, "Estimating deterministic trends with an
    integrated or stationary noise component"). A leak, which takes a little again and again, is still found.
    """
    groups = [g for g in np.array_split(np.arange(len(values)), min(blocks, len(values))) if len(g)]
    t = np.array([seconds[g].mean() for g in groups]) / 60.0
    y = np.array([values[g].mean() for g in groups])
    r = _autoregression(y - np.polyval(np.polyfit(t, y, 1), t))

    def quasi_difference(series: np.ndarray) -> np.ndarray:
        """Return (n,) what each value of a series (n,) adds to the share ``r`` of the value before it."""
        return np.concatenate([[np.sqrt(1 - r**2) * series[0]], series[1:] - r * series[:-1]])

    columns = [t] if r == 1 else [np.ones(len(t)), t]  # the start of a random walk says nothing
    design, target = np.column_stack([quasi_difference(column) for column in columns]), quasi_difference(y)
    fit = np.linalg.lstsq(design, target, rcond=None)[0]
    freedom = len(t) - 2
    variance = float(np.sum((target - design @ fit) ** 2)) / freedom * np.linalg.inv(design.T @ design)[-1, -1]
    return Trend(float(fit[-1]), float(stats.t.ppf(0.975, freedom) * np.sqrt(variance)))


def _autoregression(residuals: np.ndarray) -> float:
    """Estimate the first-order coefficient of a line's residuals (n,) without its bias -(2 + 4 r) / n. Near one, it is 1."""
    power, n = float(residuals[:-1] @ residuals[:-1]), len(residuals)
    r = float(residuals[1:] @ residuals[:-1]) / power if power else 0.0
    r += (2 + 4 * r) / n
    return 1.0 if np.sqrt(n) * (1 - r) <= 1 else max(r, -0.99)


@dataclass(frozen=True)
class SoakFigures:
    """Figures from :func:`soak` for the ``minutes`` after the ``warm_up`` seconds.

    ``memory`` is the trend of the process's own memory, KiB per minute. ``frames`` includes the warm-up. Pairs are the lowest
    and the highest value. ``resident_mib`` also counts the pages of program files, which the kernel maps and drops as it
    likes. It was seen to change by 3 MiB within 20 s while nothing of ours changed.
    """

    minutes: float
    warm_up: float
    frames: int
    fps: float
    lost: int
    memory: Trend
    memory_mib: tuple[float, float]
    resident_mib: tuple[float, float]
    threads: tuple[int, int]
    handles: tuple[int, int]

    @property
    def passed(self) -> bool:
        """Whether memory has no trend and the counts are constant."""
        return self.memory.zero and len(set(self.threads)) == len(set(self.handles)) == 1

    def table(self) -> str:
        """Format the figures for people."""
        low, high = self.memory_mib
        verdict = "zero within its error" if self.memory.zero else "NOT zero"
        return (
            f"{self.minutes:.1f} minutes, after {self.warm_up:.0f} s of warming up, at {self.fps:.1f} frames a second "
            f"({self.frames} frames in all, {self.lost} without a face)\n"
            f"memory {low:.1f} to {high:.1f} MiB, slope {self.memory.slope:+.1f} +- {self.memory.margin:.1f} KiB a minute "
            f"(95 %): {verdict}\n"
            f"with the pages of program files {self.resident_mib[0]:.1f} to {self.resident_mib[1]:.1f} MiB; "
            f"threads {_range(self.threads)}, file handles {_range(self.handles)}"
        )


def _range(counts: tuple[int, int]) -> str:
    return f"constant at {counts[0]}" if counts[0] == counts[1] else f"CHANGE from {counts[0]} to {counts[1]}"


def soak(
    minutes: float,
    make_detector=TimedDetector,
    frames: int = 70,
    every: float = 1.0,
    tick: Callable[[float], None] = lambda s: None,
) -> tuple[SoakFigures, np.ndarray]:
    """Run the chain at full speed, and judge memory, threads and handles in the last ``minutes``.

    Parameters
    ----------
    minutes : float
        Length of the judged time, after the warm-up.
    make_detector : callable
        Makes the feature detector.
    frames : int
        Number of rendered frames, which are played again and again.
    every : float
        Time between two samples, s.
    tick : callable
        ``tick(elapsed)`` is called with every sample.

    Returns
    -------
    figures : SoakFigures
    samples : (n, 5) array
        Seconds, own bytes, resident bytes, threads and file handles.

    Raises
    ------
    MissingExtraError
        psutil is not installed.
    """
    sample, count, taken = _sampler(), [0, 0], 0
    # The array is complete before the first sample, because a growing list would itself be a trend.
    rows = np.full((int(_total_seconds(minutes) / every) + 2, 5), np.nan)
    actor, sensor = live_scene(FastDriver, frames)
    detector = make_detector()

    def note(result) -> None:
        """Count all frames, and those without a face."""
        count[0] += 1
        count[1] += not result.tracked.tracked

    with sensor, FeatureFeed(sensor, detector) as feed, LiveSession(feed, actor, Parameters(), [note]) as session:
        session.latest(timeout=60.0)
        start = time.perf_counter()
        while (now := time.perf_counter() - start) < _total_seconds(minutes):
            rows[taken] = now, *sample()
            taken += 1
            if hasattr(detector, "ms"):
                detector.ms.clear()
            session.latest()  # raises what went wrong
            tick(now)
            time.sleep(every)
    return _figures(rows[:taken], minutes, count), rows[:taken]


def _total_seconds(minutes: float) -> float:
    """Return the seconds of the whole run with its warm-up."""
    return 60 * minutes + min(WARM_UP_SHARE * 60 * minutes, WARM_UP_MOST)


def _figures(rows: np.ndarray, minutes: float, count: list[int]) -> SoakFigures:
    total = _total_seconds(minutes)
    warm_up = total - 60 * minutes
    t, memory, resident, threads, handles = rows[rows[:, 0] >= warm_up].T

    def mib(values: np.ndarray) -> tuple[float, float]:
        """Return the lowest and the highest of bytes (n,) in MiB."""
        return round(values.min() / 2**20, 2), round(values.max() / 2**20, 2)

    return SoakFigures(
        minutes,
        warm_up,
        count[0],
        count[0] / total,
        count[1],
        trend(t, memory / 1024),
        mib(memory),
        mib(resident),
        (int(threads.min()), int(threads.max())),
        (int(handles.min()), int(handles.max())),
    )


def _sampler() -> Callable[[], tuple[int, int, int, int]]:
    try:
        import psutil
    except ImportError:
        raise MissingExtraError("watching memory needs psutil: pip install 'adaptiveface[bench]'") from None
    process = psutil.Process()
    handles = getattr(process, "num_fds", None) or process.num_handles

    def sample() -> tuple[int, int, int, int]:
        """Return own bytes, resident bytes, threads and file handles."""
        info = process.memory_info()
        # On Linux, memory that is resident and not shared was allocated by the process. Elsewhere, the "unique set" counts.
        own = info.rss - info.shared if hasattr(info, "shared") else process.memory_full_info().uss
        return own, info.rss, process.num_threads(), handles()

    return sample


def run_soak(minutes: float, as_json: bool = False) -> int:
    """Run ``adaptiveface bench --soak MINUTES``, and return 0 if nothing grows in MINUTES after the warm-up, else 1."""
    from tqdm import tqdm

    with tqdm(total=round(_total_seconds(minutes)), desc="soak", unit="s", leave=False, disable=None) as bar:
        figures, _ = soak(minutes, tick=lambda elapsed: bar.update(round(elapsed) - bar.n))
    print(json.dumps(asdict(figures)) if as_json else figures.table())
    return 0 if figures.passed else 1
