"""``adaptiveface bench --soak MINUTES``: the live chain at full speed; does memory grow, are threads or files left?"""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass

import numpy as np
from scipy import stats

from ..errors import MissingExtraError
from ..live import FeatureFeed, LiveSession
from .live import FastDriver, TimedDetector, live_scene

#: The first part of the run is left out: buffers fill, the allocator finds its working size. At most so many seconds.
WARM_UP_SHARE, WARM_UP_MOST = 0.25, 300.0
#: Neighbouring samples are not independent: the line is fitted to the means of so many blocks.
BLOCKS = 20


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
    """Least-squares line through the block means of ``values`` (n,) at ``seconds`` (n,); per minute."""
    groups = [g for g in np.array_split(np.arange(len(values)), min(blocks, len(values))) if len(g)]
    t = np.array([seconds[g].mean() for g in groups]) / 60.0
    y = np.array([values[g].mean() for g in groups])
    fit = stats.linregress(t, y)
    return Trend(float(fit.slope), float(stats.t.ppf(0.975, len(t) - 2) * fit.stderr))


@dataclass(frozen=True)
class SoakFigures:
    """What :func:`soak` found. ``memory`` KiB a minute after the warm-up; counts as (lowest, highest) after it."""

    minutes: float
    warm_up: float
    frames: int
    fps: float
    lost: int
    memory: Trend
    memory_mib: tuple[float, float]
    threads: tuple[int, int]
    handles: tuple[int, int]

    @property
    def passed(self) -> bool:
        """No trend in memory, constant counts."""
        return self.memory.zero and len(set(self.threads)) == len(set(self.handles)) == 1

    def table(self) -> str:
        """For people."""
        low, high = self.memory_mib
        verdict = "zero within its error" if self.memory.zero else "NOT zero"
        return (
            f"{self.minutes:.1f} minutes at {self.fps:.1f} frames a second ({self.frames} frames, {self.lost} without a "
            f"face), the first {self.warm_up:.0f} s left out\n"
            f"memory {low:.1f} to {high:.1f} MiB, slope {self.memory.slope:+.1f} +- {self.memory.margin:.1f} KiB a minute "
            f"(95 %): {verdict}\n"
            f"threads {_range(self.threads)}, file handles {_range(self.handles)}"
        )


def _range(counts: tuple[int, int]) -> str:
    return f"constant at {counts[0]}" if counts[0] == counts[1] else f"CHANGE from {counts[0]} to {counts[1]}"


def soak(minutes: float, make_detector=TimedDetector, frames: int = 70, every: float = 1.0,
         tick: Callable[[float], None] = lambda s: None) -> tuple[SoakFigures, np.ndarray]:  # fmt: skip
    """Run the chain at full speed for ``minutes`` and sample memory, threads and file handles ``every`` so many seconds.

    Returns the figures and the samples (n, 4): seconds, resident bytes, threads, file handles. Raises
    :class:`MissingExtraError` without psutil.
    """
    sample, count, taken = _sampler(), [0, 0], 0
    # All in memory before the first sample: a list that grew by one row a second would be the trend that is found.
    rows = np.full((int(60 * minutes / every) + 2, 4), np.nan)
    actor, sensor = live_scene(FastDriver, frames)
    detector = make_detector()

    def note(result) -> None:
        count[0] += 1
        count[1] += not result.tracked.tracked

    with sensor, FeatureFeed(sensor, detector) as feed, LiveSession(feed, actor, on_result=[note]) as session:
        session.latest(timeout=60.0)
        start = time.perf_counter()
        while (now := time.perf_counter() - start) < 60 * minutes:
            rows[taken] = now, *sample()
            taken += 1
            if hasattr(detector, "ms"):
                detector.ms.clear()
            session.latest()  # raises what went wrong
            tick(now)
            time.sleep(every)
    return _figures(rows[:taken], minutes, count), rows[:taken]


def _figures(rows: np.ndarray, minutes: float, count: list[int]) -> SoakFigures:
    warm_up = min(WARM_UP_SHARE * 60 * minutes, WARM_UP_MOST)
    t, memory, threads, handles = rows[rows[:, 0] >= warm_up].T
    line = trend(t, memory / 1024)
    return SoakFigures(
        minutes, warm_up, count[0], count[0] / (60 * minutes), count[1],
        line, (round(memory.min() / 2**20, 2), round(memory.max() / 2**20, 2)),
        (int(threads.min()), int(threads.max())), (int(handles.min()), int(handles.max())),
    )  # fmt: skip


def _sampler() -> Callable[[], tuple[int, int, int]]:
    try:
        import psutil
    except ImportError:
        raise MissingExtraError("watching memory needs psutil: pip install 'adaptiveface[bench]'") from None
    process = psutil.Process()
    handles = getattr(process, "num_fds", None) or process.num_handles
    return lambda: (process.memory_info().rss, process.num_threads(), handles())


def run_soak(minutes: float, as_json: bool = False) -> int:
    """``adaptiveface bench --soak MINUTES``: 0 when nothing grows, else 1."""
    from tqdm import tqdm

    with tqdm(total=round(60 * minutes), desc="soak", unit="s", leave=False, disable=None) as bar:
        figures, _ = soak(minutes, tick=lambda elapsed: bar.update(round(elapsed) - bar.n))
    print(json.dumps(asdict(figures)) if as_json else figures.table())
    return 0 if figures.passed else 1
