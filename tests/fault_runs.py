"""Seeded faults of a sensor, through sensor thread, feature thread and tracker thread; what the tracked face does.

    python tests/fault_runs.py --runs 100
    python tests/fault_runs.py --kill | --disk | --hostile

The last three are about files: writers that signals end at random moments, writers on full and on read-only disks, inputs that
mean harm (fault_writers.py, fault_hostile.py).

Every run plays a clean performance, then a fault that the seed draws, then the clean performance again. The sensor waits
for its reader, so that a run does not depend on the machine's speed; waiting times are counted in polls of the driver.
"""

from __future__ import annotations

import argparse
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from live_faults import (
    STALL,
    ScriptedDriver,
    empty_room,
    half_size,
    hand_over_mouth,
    raw,
    second_face,
    without_depth,
)

from adaptiveface.errors import AdaptiveFaceError, SensorDisconnectedError
from adaptiveface.geometry.frame import RgbdFrame
from adaptiveface.live import FeatureFeed, LiveSession
from adaptiveface.model.actor import Actor
from adaptiveface.pipeline import capture_source
from adaptiveface.sensors import live as live_module
from adaptiveface.sensors.live import LiveSensor
from adaptiveface.sensors.playback import forth_and_back
from adaptiveface.synthetic.sensor import SyntheticSensor
from adaptiveface.tracking.tracker import FaceTracker
from adaptiveface.tracking.types import TrackedFrame

RELOCK = 15  # frames within which the face must be found again
START = 12  # of the performance: the neutral is over
LIMIT = 300.0  # s that one run may take before it counts as hanging
#: A pose this near to that of the undisturbed run is the same head, mm and degrees.
NEAR_MM, NEAR_DEGREES = 5.0, 3.0


@dataclass(frozen=True)
class Script:
    """``steps`` for the driver; ``scenes``: which scene every frame shows that should come out; ``bad``: first and last
    + 1 of the frames that may teach nothing; ``back``: the first frame from which the face is to be found again."""

    steps: list
    scenes: list[int]
    bad: tuple[int, int]
    back: int


@dataclass
class Outcome:
    """``problem``: what went wrong, or ""; ``relock``: frames from the face's return until it is tracked again, that one
    included; ``lost``: frames that are not tracked; ``off`` mm: rms of the last mesh to that of the undisturbed run."""

    problem: str = ""
    relock: int = 0
    lost: int = 0
    off: float = 0.0


@dataclass
class Stage:
    """The performer's frames, their rig, and what the undisturbed run makes of every scene."""

    frames: list[RgbdFrame]
    actor: Actor
    clean: dict[int, TrackedFrame] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self._fresh = FaceTracker(self.actor)

    def scene(self, number: int) -> RgbdFrame:
        """Frame ``number`` of an endless performance, forth and back."""
        return self.frames[forth_and_back(START + number, len(self.frames))]

    def tracker(self) -> FaceTracker:
        """As new, without factorising again."""
        tracker = self._fresh.copy()
        tracker.reset()
        return tracker


def make_stage(seed: int = 5) -> Stage:
    """A performer whose 36 frames of expressions go forth and back; tracked undisturbed once."""
    sensor = SyntheticSensor(seed, neutral_frames=12, frames=36, repeats=1, colour=False)
    stage = Stage(list(sensor), capture_source(sensor, neutral_frames=12))
    tracker = stage.tracker()
    for number in range(2 * len(stage.frames) + 60):
        stage.clean[number] = tracker.track(stage.scene(number))
    return stage


# ---- the faults: each draws one script from a generator ------------------------------------------------------------
def _changed(change: Callable[[RgbdFrame, np.random.Generator], RgbdFrame], harmless: bool = False):
    """A stretch of changed frames; ``harmless``: the face is still seen, so that they may teach."""

    def script(stage: Stage, rng: np.random.Generator) -> Script:
        first, length = int(rng.integers(14, 24)), int(rng.integers(1, 25))
        count = first + length + RELOCK
        frames = [stage.scene(i) for i in range(count)]
        frames[first : first + length] = [change(frame, rng) for frame in frames[first : first + length]]
        bad = (first, first if harmless else first + length)
        return Script([raw(f, i) for i, f in enumerate(frames)], list(range(count)), bad, first + length)

    return script


def _gap(steps_between: Callable[[np.random.Generator], list], restart: bool):
    """Nothing for a while, then the performance as it is by then; ``restart``: the device counts from 0 again."""

    def script(stage: Stage, rng: np.random.Generator) -> Script:
        first, away = int(rng.integers(14, 24)), 60 if not restart else int(rng.integers(10, 100))
        scenes = [*range(first), *range(first + away, first + away + RELOCK)]
        numbers = [*range(first), *range(RELOCK)] if restart else scenes
        steps = [raw(stage.scene(s), n) for s, n in zip(scenes, numbers, strict=True)]
        steps[first:first] = steps_between(rng)
        return Script(steps, scenes, (first, first), first)

    return script


def _dropped(stage: Stage, rng: np.random.Generator) -> Script:
    kept = np.flatnonzero(rng.random(70) >= 0.3)
    return Script([raw(stage.scene(i), int(i)) for i in kept], list(map(int, kept)), (0, 0), 0)


def _disordered(stage: Stage, rng: np.random.Generator) -> Script:
    clean, steps = [raw(stage.scene(i), i) for i in range(40)], []
    for i, step in enumerate(clean):
        steps.append(step)
        while rng.random() < 0.4:
            steps.append(clean[i - int(rng.integers(0, min(i, 5) + 1))])  # once more, or one from before
    return Script(steps, list(range(40)), (0, 0), 0)


def _aside(frame: RgbdFrame, rng: np.random.Generator) -> RgbdFrame:
    return second_face(frame, int(rng.choice([-1, 1]) * rng.integers(200, 300)), float(rng.uniform(-80, 80)))


FAULTS: dict[str, Callable[[Stage, np.random.Generator], Script]] = {
    "unplugged and replugged": _gap(lambda rng: [SensorDisconnectedError("scripted: unplugged")], restart=True),
    "2 s stall": _gap(lambda rng: [STALL] * 20, restart=False),
    "30 % random drops": _dropped,
    "duplicated, out of order": _disordered,
    "all-zero depth": _changed(lambda frame, rng: without_depth(frame, 0.0)),
    "NaN depth": _changed(lambda frame, rng: without_depth(frame, np.nan)),
    "resolution change": _changed(lambda frame, rng: half_size(frame), harmless=True),
    "hand over the mouth": _changed(hand_over_mouth),
    "second face": _changed(_aside, harmless=True),
    "leaving and re-entering": _changed(lambda frame, rng: empty_room(frame)),
}


# ---- one run -------------------------------------------------------------------------------------------------------
class _Session(LiveSession):
    """Takes its first tracker from the stage, which has it ready."""

    def __init__(self, stage: Stage, feed: FeatureFeed, **options) -> None:
        self._stage = stage
        super().__init__(feed, stage.actor, **options)

    def _make_tracker(self, actor: Actor) -> FaceTracker:
        return self._stage.tracker()


def run(stage: Stage, fault: str, seed: int) -> Outcome:
    """Play the fault that ``seed`` draws and judge it."""
    script = FAULTS[fault](stage, np.random.default_rng([seed, list(FAULTS).index(fault)]))
    results: list[tuple[TrackedFrame, tuple]] = []
    threads = threading.active_count()

    def keep(result) -> None:
        results.append((result.tracked, learned(session)))

    try:
        with LiveSensor(lambda: ScriptedDriver(script.steps)) as sensor, FeatureFeed(sensor) as feed:
            ready = threading.Event()
            with _Session(stage, feed, on_result=[lambda result: ready.wait(), keep]) as session:
                ready.set()
                deadline = time.monotonic() + LIMIT
                while session.running and time.monotonic() < deadline:
                    session.latest(timeout=0.5, after=len(script.scenes))
                if session.running:
                    return Outcome(f"hangs after frame {len(results)}")
    except (AdaptiveFaceError, ArithmeticError, ValueError) as error:
        return Outcome(f"{type(error).__name__}: {error}")
    if threading.active_count() > threads:
        return Outcome("a thread is left")
    return judge(stage, script, results)


def learned(session: LiveSession) -> tuple:
    """What the model knows: correctives, samples in the buffer, updates."""
    model = session.model
    return model.correctives.copy(), model.count, model.updates


def judge(stage: Stage, script: Script, results: list) -> Outcome:
    if len(results) != len(script.scenes):
        return Outcome(f"{len(results)} results of {len(script.scenes)} frames")
    tracked = [result for result, _ in results]
    broken = [result.reason for result in tracked if "cannot be tracked" in result.reason]
    if broken:
        return Outcome(broken[0])
    found = [same_head(a, stage.clean[s]) for a, s in zip(tracked, script.scenes, strict=True)]
    back = found[script.back :]
    if script.back == 0:  # the face was never away: the longest stretch without it
        relock = 1 + max(map(len, "".join("x" if ok else " " for ok in found).replace("x", "\n").split("\n")))
    else:
        relock = back.index(True) + 1 if True in back else len(back) + 1
    outcome = Outcome(relock=relock, lost=sum(not result.tracked for result in tracked))
    last, clean = tracked[-1], stage.clean[script.scenes[-1]]
    frontal = stage.actor.frontal
    outcome.off = float(np.sqrt(((last.vertices - clean.vertices)[frontal] ** 2).sum(axis=1).mean()))
    if relock > RELOCK:
        outcome.problem = f"not found again within {RELOCK} frames"
    first, end = script.bad
    if end > first and not same_learned(results[first - 1][1], results[end - 1][1]):
        states = {result.sample_state.name for result in tracked[first:end]}
        outcome.problem = f"the bad frames taught something ({', '.join(sorted(states))})"
    return outcome


def same_head(a: TrackedFrame, b: TrackedFrame) -> bool:
    """Whether both are tracked, at the same place."""
    turn = a.head_pose[:3, :3].T @ b.head_pose[:3, :3]
    angle = np.degrees(np.arccos(np.clip((np.trace(turn) - 1) / 2, -1, 1)))
    near = np.linalg.norm(a.head_pose[:3, 3] - b.head_pose[:3, 3]) < NEAR_MM
    return bool(a.tracked and b.tracked and near and angle < NEAR_DEGREES)


def same_learned(a: tuple, b: tuple) -> bool:
    return a[1:] == b[1:] and np.array_equal(a[0], b[0])


def run_files(args: argparse.Namespace) -> int:
    """The trials of files that were asked for; the exit status."""
    bad = 0
    faults = (("INT", "TERM", "KILL") if args.kill else ()) + (("disk", "read-only") if args.disk else ())
    if faults:
        import fault_writers

        runs = min(args.runs, 20)
        bad += fault_writers.table(faults, runs) + fault_writers.recordings(faults, runs)
    if args.hostile:
        import fault_hostile

        bad += fault_hostile.table()
    return 1 if bad else 0


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=100)
    parser.add_argument("--fault", choices=tuple(FAULTS), action="append")
    parser.add_argument("--kill", action="store_true", help="writers, ended by SIGINT, SIGTERM and SIGKILL")
    parser.add_argument("--disk", action="store_true", help="writers on full and on read-only disks")
    parser.add_argument("--hostile", action="store_true", help="inputs that mean harm")
    args = parser.parse_args()
    if args.kill or args.disk or args.hostile:
        return run_files(args)
    live_module.RECONNECT_SECONDS = 0.01
    stage, failures = make_stage(), 0
    print(f"{'fault':<28}{'runs':>5}{'good':>6}{'relocked after':>24}{'mesh off, mm':>22}")
    for fault in args.fault or FAULTS:
        outcomes = [run(stage, fault, seed) for seed in range(args.runs)]
        bad = [(seed, o.problem) for seed, o in enumerate(outcomes) if o.problem]
        failures += len(bad)
        relock, off = [o.relock for o in outcomes], [o.off for o in outcomes]
        print(
            f"{fault:<28}{len(outcomes):>5}{len(outcomes) - len(bad):>6}"
            f"{f'{np.median(relock):.0f}, at most {max(relock)} frames':>24}"
            f"{f'{np.median(off):.2f}, at most {max(off):.2f}':>22}",
            flush=True,
        )
        for seed, problem in bad[:5]:
            print(f"    seed {seed}: {problem}", flush=True)
    return 1 if failures else 0


if __name__ == "__main__":
    sys.exit(main())
