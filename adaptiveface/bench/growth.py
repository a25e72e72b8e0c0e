"""Measure how every stage grows with the mesh and with K, S and A: ``adaptiveface bench --vertices 5000,10000,20000``."""

from __future__ import annotations

import gc
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ..geometry.frame import RgbdFrame
from ..model.actor import Actor
from ..parameters import Parameters
from ..runtime.threads import one_thread
from ..synthetic.performer import Performer
from ..tracking.base import stage_clock
from ..tracking.tracker import FaceTracker
from ..tracking.types import STAGE_NAMES, SampleState
from . import peers
from .run import machine_load
from .scene import SEED, bench_scene, rendering_bar
from .sizes import actor_of_size

#: Number of frames of the performance, and of frames that a tracker processes in a row. The trackers take turns, so that other
#: work of the machine affects all of them, and each of them mostly finds the caches as its own last frame left them.
FRAMES, TURN = 60, 20
#: Largest number of times that the performance is tracked before the clock starts, until the sample buffer is full.
WARM_UP = 40
#: Values of the other parameters for which growth is shown on the embedded mesh, and the comparisons that depend on them.
OTHERS: Mapping[str, tuple[tuple[int, ...], tuple[Callable, ...]]] = {
    "adaptive_pca.K": ((6, 12, 24), (peers.incremental_pca,)),
    "adaptive_pca.S": ((100, 200, 400), ()),
    "blendshapes.A": ((6, 12, 23), (peers.bounded_solve, peers.blendshape_fit)),
}
ALL_PEERS = (
    peers.rigid_icp,
    peers.bounded_solve,
    peers.blendshape_fit,
    peers.prefactored_solve,
    peers.incremental_pca,
)


@dataclass(frozen=True)
class Growth:
    """Median CPU times of one stage or peer at the ``sizes`` (S,), ms. A missing time is NaN."""

    name: str
    sizes: np.ndarray
    ms: np.ndarray

    @property
    def power(self) -> float:
        """The exponent p of n^p, by least squares on the logarithms."""
        return float(np.polyfit(np.log(self.sizes), np.log(self.ms), 1)[0])

    @property
    def steep(self) -> bool:
        """Whether the time grows faster than n log n from the first size to the last."""
        n = self.sizes * np.log(self.sizes)
        return bool(self.ms[-1] / self.ms[0] > n[-1] / n[0])


def stage_growth(trackers: Sequence[FaceTracker], sizes: Sequence[int], frames: Sequence[RgbdFrame]) -> list[Growth]:
    """Measure the median CPU time of every stage over the learned frames, for trackers that differ in one size."""
    for tracker in trackers:
        for _ in range(WARM_UP):
            for frame in frames:
                tracker.track(frame)
            if tracker.model.count == tracker.parameters.adaptive_pca.S:
                break
    rows: list[list[dict[str, float]]] = [[] for _ in trackers]
    gc.disable()
    try:
        with stage_clock(peers.cpu_clock):
            for first in range(0, len(frames), TURN):
                for tracker, mine in zip(trackers, rows, strict=True):
                    tracked = [tracker.track(frame) for frame in frames[first : first + TURN]]
                    mine += [frame.stage_ms for frame in tracked if frame.sample_state is SampleState.LEARNED]
    finally:
        gc.enable()
    n = np.asarray(sizes, float)
    grown = [Growth(s, n, np.array([np.median([ms[s] for ms in mine]) for mine in rows])) for s in STAGE_NAMES]
    total = np.array([np.median([sum(ms.values()) for ms in mine]) for mine in rows])
    return [*grown, Growth("sum of stages", n, total)]


def peer_growth(recordings: Sequence[peers.Recorded], sizes: Sequence[int], comparisons: Sequence[Callable]) -> list[Growth]:
    """Measure our CPU times and the peers' on the same inputs, for every comparison."""
    n, out = np.asarray(sizes, float), []
    for compare in comparisons:
        found = [compare(recorded, 20) for recorded in recordings]
        out.append(Growth(found[0].stage, n, np.array([entry.ours_ms for entry in found])))
        theirs = np.array([np.nan if entry.peer_ms is None else entry.peer_ms for entry in found])
        missing = f": {peers.INSTALL}" if np.isnan(theirs).any() else ""
        out.append(Growth(f"  {found[0].peer}{missing}", n, theirs))
    return out


def growth_table(title: str, growths: Sequence[Growth]) -> str:
    """Format one line per stage or peer, with the ms at each size and the exponent of its growth."""
    sizes = growths[0].sizes
    steepest = Growth("n log n", sizes, sizes * np.log(sizes)).power
    lines = [f"{title:<50}" + "".join(f"{size:>9.0f}" for size in sizes) + f"{'n^':>7}   (n log n: {steepest:.2f})"]
    for entry in growths:
        numbers = "".join(f"{'-' if np.isnan(ms) else format(ms, '.3f'):>9}" for ms in entry.ms)
        known = not np.isnan(entry.ms).any()
        power = f"{entry.power:>7.2f}" if known else f"{'-':>7}"
        lines.append(f"{entry.name:<50}{numbers}{power}{'   steeper' if known and entry.steep else ''}")
    return "\n".join(lines)


def vertex_growth(vertices: Sequence[int], frames: int, progress: Callable = lambda numbers: numbers) -> str:
    """Make the table over meshes with these numbers of vertices, and below it the stages beside peers on the same inputs."""
    performer = Performer(SEED)
    _, scene = bench_scene(frames, progress=progress)
    actors = [actor_of_size(performer, count) for count in vertices]
    frontal = [int(actor.frontal.sum()) for actor in actors]
    stages = stage_growth([FaceTracker(actor) for actor in actors], frontal, scene)
    compared = peer_growth([_recorded(actor, scene) for actor in actors], frontal, ALL_PEERS)
    named = ", ".join(f"{n} of {len(actor.neutral)}" for n, actor in zip(frontal, actors, strict=True))
    tables = (growth_table("frontal vertices; CPU ms", stages), growth_table("same inputs, CPU ms", compared))
    return f"frontal vertices: {named}\n\n" + "\n\n".join(tables)


def parameter_growth(name: str, frames: int, progress: Callable = lambda numbers: numbers) -> str:
    """Make the tables over the values of one of :data:`OTHERS`, on the embedded mesh."""
    values, comparisons = OTHERS[name]
    actor, scene = bench_scene(frames, progress=progress)
    sets = [Parameters().replace(**{name: value}) for value in values]
    tables = [growth_table(f"{name}; CPU ms", stage_growth([FaceTracker(actor, p) for p in sets], values, scene))]
    if comparisons:
        recordings = [_recorded(actor, scene, p) for p in sets]
        tables.append(growth_table("same inputs, CPU ms", peer_growth(recordings, values, comparisons)))
    return "\n\n".join(tables)


def _recorded(actor: Actor, scene: list[RgbdFrame], parameters: Parameters | None = None) -> peers.Recorded:
    """Record the inputs of the stages once the sample buffer is almost full."""
    size = (parameters or Parameters()).adaptive_pca.S
    return peers.record(actor, scene * (1 + size // len(scene)), min(30, len(scene)), parameters)


def run_growth(vertices: Sequence[int], frames: int | None = None) -> int:
    """Run ``adaptiveface bench --vertices``: print the tables and return the exit status 0."""

    count = frames or FRAMES
    peers.load_peers()
    with one_thread():
        print(f"{count} frames, learning on, full sample buffers; one thread{machine_load()}\n")
        print(vertex_growth(vertices, count, rendering_bar), flush=True)
        for name in OTHERS:
            print(f"\n{parameter_growth(name, count, rendering_bar)}", flush=True)
    return 0
