"""Measure the whole live chain on the synthetic sensor, with MediaPipe as in live tracking: ``adaptiveface bench --live``.

The sensor plays rendered frames at 30 per second. The detector searches their pictures although they bring features, so that
sensor, detector and tracker share the machine as they do with a camera. It searches every second one while tracking is
certain, as :meth:`.Parameters.live` says.
"""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace

import numpy as np

from ..errors import TrackingError
from ..geometry.frame import Features2D, RgbdFrame
from ..landmarks import FeatureDetector
from ..live import FeatureFeed, LiveResult, LiveSession
from ..model.actor import Actor
from ..neutral.appearance import gather_appearance
from ..neutral.capture import build_actor
from ..parameters import RefinementParameters
from ..sensors.live import LiveSensor
from ..sensors.playback import EXPRESSION_FRAMES, NEUTRAL_FRAMES, SyntheticDriver
from ..synthetic.sensor import SyntheticSensor
from .scene import SEED

#: Time before anything is counted, s, in which kernels are loaded, the detector finds the face and the sample buffer fills.
WARM_UP_SECONDS = 5.0


class TimedDetector(FeatureDetector):
    """The detector of live capture, which here keeps the time of every detection in ``ms``."""

    def __init__(self) -> None:
        super().__init__(video=True)
        self.ms: list[float] = []

    def detect(self, frame: RgbdFrame) -> Features2D | None:
        """Find the features as :meth:`FeatureDetector.detect` does."""
        start = time.perf_counter()
        features = super().detect(frame)
        self.ms.append((time.perf_counter() - start) * 1e3)
        return features


class FastDriver(SyntheticDriver):
    """The synthetic sensor at a rate that the tracker cannot follow, so that every thread is always busy."""

    fps = 120.0


def live_scene(make_driver=SyntheticDriver, frames: int = EXPRESSION_FRAMES) -> tuple[Actor, LiveSensor]:
    """Make the rig of the bench's performer and a live sensor that shows this performer.

    All frames are rendered before the function returns. The rig knows its appearance, as after a neutral scan, so that its
    features are refined.
    """
    source = SyntheticSensor(SEED, "structured-light", min(NEUTRAL_FRAMES, frames), frames, repeats=1)
    rendered: dict = {}
    sensor = LiveSensor(lambda: make_driver(source, rendered), open_timeout=600.0)
    actor = build_actor(source.performer.model, source.performer.neutral)
    views = ((source.read(index), source.ground_truth(index).head_pose) for index in range(0, source.neutral_frames, 4))
    return replace(actor, appearance=gather_appearance(actor, views, RefinementParameters())), sensor


@dataclass(frozen=True)
class LiveFigures:
    """Figures from :func:`measure_live`. Times are in ms, and ``*_p50`` and ``*_p95`` are percentiles over all frames."""

    seconds: float
    frames: int
    fps: float
    lost: int
    latency_p50: float
    latency_p95: float
    latency_max: float
    searched: float
    detect_p50: float
    detect_p95: float
    track_p50: float
    track_p95: float
    dropped_sensor: int
    dropped_features: int
    dropped_tracker: int
    own_cores: float
    load: float
    cores: int

    def table(self) -> str:
        """Format the figures for people."""
        busy = ": BUSY, the figures are inflated" if self.load > self.cores + 0.5 else ""
        rows = [
            ("frame arrival to mesh, ms", f"{self.latency_p50:.1f}", f"{self.latency_p95:.1f}"),
            (f"MediaPipe, ms ({self.searched:.0%} of frames)", f"{self.detect_p50:.1f}", f"{self.detect_p95:.1f}"),
            ("tracking, ms", f"{self.track_p50:.1f}", f"{self.track_p95:.1f}"),
        ]
        lines = [f"{'':<32}{'median':>9}{'95 %':>9}", *(f"{name:<32}{a:>9}{b:>9}" for name, a, b in rows)]
        dropped = f"sensor {self.dropped_sensor}, detector {self.dropped_features}, tracker {self.dropped_tracker}"
        return "\n".join(
            [
                f"{self.frames} frames in {self.seconds:.1f} s: {self.fps:.1f} a second, {self.lost} without a face; "
                f"longest latency {self.latency_max:.0f} ms",
                f"dropped: {dropped}",
                *lines,
                f"this process kept {self.own_cores:.2f} cores busy; load {self.load:.1f} on {self.cores} cores{busy}",
            ]
        )


def measure_live(seconds: float, warm_up: float = WARM_UP_SECONDS, tick: Callable[[float], None] = lambda s: None):
    """Run the chain for ``seconds`` after ``warm_up`` seconds, and return :class:`LiveFigures`.

    ``tick(elapsed)`` is called about once per second.
    """
    detector, results = TimedDetector(), []
    actor, sensor = live_scene()

    def keep(result: LiveResult) -> None:
        """Keep latency and tracking time, ms, and whether the face was tracked."""
        results.append((result.latency_ms, sum(result.tracked.stage_ms.values()), result.tracked.tracked))

    with sensor, FeatureFeed(sensor, detector) as feed, LiveSession(feed, actor, on_result=[keep]) as session:
        _wait(session, warm_up, lambda s: None)
        before, n_detected, n_results, cpu = session.statistics, len(detector.ms), len(results), time.process_time()
        elapsed = _wait(session, seconds, tick)
        after, cpu = session.statistics, time.process_time() - cpu
        detect, rows = np.array(detector.ms[n_detected:]), np.array(results[n_results:], float)
    if not len(rows) or not len(detect):
        raise TrackingError(f"no frame was tracked within {seconds:g} s")
    latency, track = rows[:, 0], rows[:, 1]
    return LiveFigures(
        seconds=round(elapsed, 2),
        frames=len(rows),
        fps=round(len(rows) / elapsed, 2),
        lost=int((rows[:, 2] == 0).sum()),
        latency_p50=_percentile(latency, 50),
        latency_p95=_percentile(latency, 95),
        latency_max=_percentile(latency, 100),
        searched=round(len(detect) / len(rows), 3),
        detect_p50=_percentile(detect, 50),
        detect_p95=_percentile(detect, 95),
        track_p50=_percentile(track, 50),
        track_p95=_percentile(track, 95),
        dropped_sensor=after.dropped_sensor - before.dropped_sensor,
        dropped_features=after.dropped_features - before.dropped_features,
        dropped_tracker=after.dropped_tracker - before.dropped_tracker,
        own_cores=round(cpu / elapsed, 3),
        load=round(os.getloadavg()[0], 2) if hasattr(os, "getloadavg") else 0.0,
        cores=os.cpu_count() or 1,
    )


def _percentile(values: np.ndarray, level: int) -> float:
    return round(float(np.percentile(values, level)), 2)


def _wait(session: LiveSession, seconds: float, tick: Callable[[float], None]) -> float:
    """Sleep for ``seconds`` while the session runs, and return the time that passed. Raises the session's error."""
    start = time.perf_counter()
    while (elapsed := time.perf_counter() - start) < seconds and session.running:
        time.sleep(min(1.0, seconds - elapsed))
        session.latest()
        tick(time.perf_counter() - start)
    return time.perf_counter() - start


def run_live(seconds: float, as_json: bool = False) -> int:
    """Run ``adaptiveface bench --live``: measure, print, and return the exit status."""
    from tqdm import tqdm

    with tqdm(total=round(seconds), desc="live", unit="s", leave=False, disable=None) as bar:
        figures = measure_live(seconds, tick=lambda elapsed: bar.update(round(elapsed) - bar.n))
    print(json.dumps(asdict(figures)) if as_json else figures.table())
    return 0
