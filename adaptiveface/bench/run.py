"""Measure the tracker's time per stage beside the paper's figures and beside peers: ``adaptiveface bench``."""

from __future__ import annotations

import gc
import os
from dataclasses import dataclass
from time import perf_counter

import numpy as np

from ..geometry.frame import RgbdFrame
from ..model.actor import Actor
from ..parameters import Parameters
from ..runtime.threads import one_thread
from ..tracking.tracker import FaceTracker
from ..tracking.types import STAGE_NAMES
from .bandwidth import traffic_line
from .paper import PAPER_MS, PAPER_SUM_MS
from .peers import INSTALL, Comparison, compare_all, cpu_clock, load_peers, record
from .scene import bench_scene, rendering_bar

FRAMES = 300
#: Number of frames whose stage inputs are kept for the peers.
RECORDED = 60


@dataclass(frozen=True)
class Timings:
    """Times of F frames.

    Attributes
    ----------
    stage_ms : (F, S) array
        Elapsed time of each stage of ``STAGE_NAMES``, ms.
    whole_ms, cpu_ms : (F,) arrays
        Elapsed and CPU time of the whole ``track`` call, ms.
    learned : int
        Number of PCA updates in these frames.
    n_vertices, n_frontal : int
        Number of vertices, and of those in the frontal region.
    """

    stage_ms: np.ndarray
    whole_ms: np.ndarray
    cpu_ms: np.ndarray
    learned: int
    n_vertices: int
    n_frontal: int


def time_stages(actor: Actor, frames: list[RgbdFrame], parameters: Parameters | None = None) -> Timings:
    """Track ``frames`` twice with learning on, and keep the times of the second pass.

    The first pass compiles or loads the kernels. It also fills the sample buffer, because an update costs more with a fuller
    buffer.
    """
    tracker = FaceTracker(actor, parameters)
    for frame in frames:
        tracker.track(frame)
    before, rows, spent = tracker.model.updates, [], []
    gc.disable()  # a collection inside a stage would be counted as the stage's time
    try:
        for frame in frames:
            start = perf_counter(), cpu_clock()
            ms = tracker.track(frame).stage_ms
            end = perf_counter(), cpu_clock()
            spent.append(np.subtract(end, start) * 1e3)
            rows.append([ms[name] for name in STAGE_NAMES])
    finally:
        gc.enable()
    learned = tracker.model.updates - before
    whole, cpu = np.array(spent).T
    return Timings(np.array(rows), whole, cpu, learned, len(actor.neutral), int(actor.frontal.sum()))


def stage_table(timings: Timings) -> str:
    """Format median, 95th and 99th percentile of every stage, of their sum and of the whole frame beside the paper's, ms."""
    rows = [(name, timings.stage_ms[:, k], PAPER_MS.get(name)) for k, name in enumerate(STAGE_NAMES)]
    rows.append(("sum of stages", timings.stage_ms.sum(axis=1), PAPER_SUM_MS))
    rows += [("whole frame", timings.whole_ms, None), ("CPU time of it", timings.cpu_ms, None)]
    lines = [f"{'ms per frame':<20}{'median':>9}{'95 %':>9}{'99 %':>9}{'paper':>9}{'of it':>9}"]
    for name, values, paper in rows:
        median, p95, p99 = np.percentile(values, [50, 95, 99])
        beside = f"{paper:>9.1f}{median / paper:>9.0%}" if paper else f"{'-':>9}{'-':>9}"
        lines.append(f"{name:<20}{median:>9.2f}{p95:>9.2f}{p99:>9.2f}{beside}")
    return "\n".join(lines)


def peer_table(comparisons: list[Comparison]) -> str:
    """Format the median CPU ms of every stage and of its peer on the same inputs."""
    lines = [f"{'same inputs, CPU ms':<20}{'ours':>9}{'peer':>9}{'ratio':>9}   peer"]
    for entry in comparisons:
        if entry.peer_ms is None:
            lines.append(f"{entry.stage:<20}{entry.ours_ms:>9.2f}{'-':>9}{'-':>9}   {entry.peer}: {INSTALL}")
            continue
        note = f" ({entry.agreement})" if entry.agreement else ""
        ratio = f"{entry.peer_ms / entry.ours_ms:.1f}x"
        lines.append(f"{entry.stage:<20}{entry.ours_ms:>9.2f}{entry.peer_ms:>9.2f}{ratio:>9}   {entry.peer}{note}")
    return "\n".join(lines)


def verdict(timings: Timings, comparisons: list[Comparison]) -> str:
    """Say whether the two claims hold: a third of the paper's sum, and every stage faster than its peer."""
    median = float(np.median(timings.stage_ms.sum(axis=1)))
    limit = PAPER_SUM_MS / 3
    lines = [
        f"sum of stages {median:.2f} ms, {'within' if median <= limit else 'ABOVE'} a third of the paper's ({limit:.2f} ms)"
    ]
    slower = [entry for entry in comparisons if entry.peer_ms is not None and entry.peer_ms <= entry.ours_ms]
    compared = sum(entry.peer_ms is not None for entry in comparisons)
    lines.append(
        f"slower than its peer: {', '.join(entry.stage for entry in slower)}"
        if slower
        else f"faster than its peer in {compared} of {compared} comparisons"
    )
    return "\n".join(lines)


def machine_load() -> str:
    """Say how busy the machine is, because other programs' work shows in the figures."""
    busy, cores = os.getloadavg()[0] if hasattr(os, "getloadavg") else 0.0, os.cpu_count() or 1
    return f"; load {busy:.1f} on {cores} cores" + (": BUSY, the figures are inflated" if busy > cores else "")


def main(args=None) -> int:
    """Run everything and print the tables. ``args`` is the command line's namespace, whose ``frames`` is used if present."""
    frames = getattr(args, "frames", None) or FRAMES

    load_peers()
    with one_thread():
        actor, scene = bench_scene(frames, progress=rendering_bar)
        timings = time_stages(actor, scene)
        recorded = record(actor, scene, min(RECORDED, frames // 2))
        comparisons = compare_all(recorded)
        pca = next(entry for entry in comparisons if entry.stage == "adaptive_pca")
        traffic = traffic_line(recorded.tracker.model, pca.ours_ms)
    print(
        f"{timings.n_vertices} vertices, {timings.n_frontal} of them frontal; {len(timings.stage_ms)} frames, learning "
        f"on ({timings.learned} of them learned); one thread{machine_load()}"
    )
    print(f"\n{stage_table(timings)}\n\n{peer_table(comparisons)}\n\n{verdict(timings, comparisons)}\n{traffic}")
    return 0
