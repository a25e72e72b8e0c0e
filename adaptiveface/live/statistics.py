"""Collect the statistics of a live session: rate, latency, lost frames, and the current message."""

from __future__ import annotations

import time
from collections import deque
from dataclasses import dataclass

import numpy as np

from ..tracking.held_out import BAD
from ..tracking.types import TrackedFrame
from .feed import FeatureFeed

#: Rates and latencies are measured over the last few seconds.
WINDOW_SECONDS = 5.0


@dataclass(frozen=True)
class LiveStatistics:
    """Rates and times of the last seconds, and counts since the start.

    Attributes
    ----------
    fps : float
        Tracked results per second.
    latency_ms_p50, latency_ms_p95 : float
        Time from a frame's arrival to its mesh, ms.
    detect_ms, track_ms : float
        Median times of detection and tracking, ms.
    dropped_sensor, dropped_features, dropped_tracker : int
        Numbers of frames that the device lost, that came while the detector was busy, and while the tracker was busy.
    tracked, lost : int
        Numbers of results with and without a face.
    message : str
        The current problem, or "".
    held_out : float
        Error of landmarks that no fit used, in their worst region, % of the distance between the eyes. NaN if it is unknown.
    """

    fps: float = 0.0
    latency_ms_p50: float = 0.0
    latency_ms_p95: float = 0.0
    detect_ms: float = 0.0
    track_ms: float = 0.0
    dropped_sensor: int = 0
    dropped_features: int = 0
    dropped_tracker: int = 0
    tracked: int = 0
    lost: int = 0
    message: str = ""
    held_out: float = float("nan")

    def __str__(self) -> str:
        dropped = f"{self.dropped_sensor} + {self.dropped_features} + {self.dropped_tracker}"
        text = (
            f"{self.fps:4.1f} frames/s, latency {self.latency_ms_p50:.0f} ms (95 %: {self.latency_ms_p95:.0f}), "
            f"detect {self.detect_ms:.0f}, track {self.track_ms:.0f} ms, dropped by sensor + detector + tracker {dropped}"
        )
        if np.isfinite(self.held_out):
            text += f", worst region off by {self.held_out:.1f} %"
        if self.held_out > BAD:
            text = f"the face does not fit what is seen (off by {self.held_out:.0f} % of the eyes' distance); {text}"
        return f"{text}; {self.message}" if self.message else text


class Meter:
    """Collects what the statistics need. The tracker's thread writes, and any thread may read.

    Parameters
    ----------
    feed : FeatureFeed
        The feed whose lost frames are counted from now on.
    """

    def __init__(self, feed: FeatureFeed) -> None:
        self.message, self._feed, self._before = "", feed, _dropped(feed)
        self._tracked = self._lost = 0
        self._start = self._last = time.perf_counter()
        self._recent: deque[tuple[float, ...]] = deque(maxlen=1000)  # time, latency ms, track ms, fit %

    @property
    def silence(self) -> float:
        """Seconds since the last result, or since the start."""
        return time.perf_counter() - self._last

    def add(self, latency_ms: float, tracked: TrackedFrame) -> None:
        """Count a result."""
        self._last = time.perf_counter()
        fit = float(tracked.held_out.max()) if len(tracked.held_out) else np.nan
        self._recent.append((self._last, latency_ms, sum(tracked.stage_ms.values()), fit))
        self._tracked += tracked.tracked
        self._lost += not tracked.tracked
        self.message = tracked.reason

    def statistics(self) -> LiveStatistics:
        """Return the current statistics."""
        now = time.perf_counter()
        recent = np.array([row for row in tuple(self._recent) if row[0] > now - WINDOW_SECONDS]).reshape(-1, 4)
        span = min(max(now - self._start, 1e-3), WINDOW_SECONDS)
        p50, p95 = np.percentile(recent[:, 1], [50, 95]) if len(recent) else (0.0, 0.0)
        sensor, features, tracker = (n - before for n, before in zip(_dropped(self._feed), self._before, strict=True))
        return LiveStatistics(
            fps=len(recent) / span,
            latency_ms_p50=float(p50),
            latency_ms_p95=float(p95),
            detect_ms=self._feed.detect_ms,
            track_ms=float(np.median(recent[:, 2])) if len(recent) else 0.0,
            dropped_sensor=sensor,
            dropped_features=features,
            dropped_tracker=tracker,
            tracked=self._tracked,
            lost=self._lost,
            message=self.message,
            held_out=float(np.nanmedian(recent[:, 3])) if np.isfinite(recent[:, 3]).any() else np.nan,
        )


def _dropped(feed: FeatureFeed) -> tuple[int, int, int]:
    """Return the numbers of frames that were lost so far by the device, the busy detector, and the busy tracker."""
    return feed.sensor.lost_by_device, feed.sensor.superseded, feed.dropped
