"""``adaptiveface bench --colour``: what the pictures cost, with the features refined by them, without and with dense skin."""

from __future__ import annotations

import gc
from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from ..geometry.frame import RgbdFrame
from ..model.actor import Actor
from ..neutral.appearance import gather_appearance
from ..neutral.capture import build_actor
from ..neutral.skin import gather_skin
from ..parameters import Parameters
from ..runtime.threads import one_thread
from ..synthetic.sensor import SyntheticSensor
from ..tracking.base import stage_clock
from ..tracking.tracker import FaceTracker
from ..tracking.types import STAGE_NAMES
from .growth import TURN
from .peers import cpu_clock
from .run import machine_load
from .scene import SEED, rendering_bar

#: Frames of the performance, whose pictures take some 2 MB each, and those of the neutral that the skin is gathered from.
FRAMES, NEUTRAL_FRAMES = 150, 20
#: Error of the features, px, as a detector has it.
FEATURE_NOISE = 1.0


def colour_scene(frames: int) -> tuple[Actor, list[RgbdFrame]]:
    """Render one performance with pictures, and make the rig that knows how the performer's skin looks.

    Parameters
    ----------
    frames : int
        Length of the performance.

    Returns
    -------
    actor : Actor
        With the exact neutral, and with the appearance and the skin that the neutral frames show.
    frames : list of RgbdFrame
        The performance.
    """
    sensor = SyntheticSensor(SEED, "truedepth", NEUTRAL_FRAMES, frames, repeats=1, feature_noise=FEATURE_NOISE)
    actor, parameters = build_actor(sensor.performer.model, sensor.performer.neutral), Parameters()
    views = [(sensor.read(index), sensor.ground_truth(index).head_pose) for index in range(0, NEUTRAL_FRAMES, 2)]
    actor = replace(
        actor,
        appearance=gather_appearance(actor, views, parameters.refinement),
        skin=gather_skin(actor, views, parameters.skin),
    )
    numbers: Iterable[int] = rendering_bar(range(NEUTRAL_FRAMES, len(sensor)))
    return actor, [sensor.read(index) for index in numbers]


def time_in_turns(trackers: Sequence[FaceTracker], frames: Sequence[RgbdFrame]) -> list[np.ndarray]:
    """Track the frames twice with every tracker, in turns, so that what else the machine does meets all of them alike.

    Parameters
    ----------
    trackers : sequence of FaceTracker
        The trackers.
    frames : sequence of RgbdFrame
        F frames.

    Returns
    -------
    list of (F, S)
        Processor time of the second pass, one array for each tracker and a column for each of ``STAGE_NAMES``, ms.
    """
    rows: list[list[list[float]]] = [[] for _ in trackers]
    gc.disable()
    try:
        with stage_clock(cpu_clock):
            for _ in range(2):
                for first in range(0, len(frames), TURN):
                    for tracker, mine in zip(trackers, rows, strict=True):
                        for frame in frames[first : first + TURN]:
                            ms = tracker.track(frame).stage_ms
                            mine.append([ms[name] for name in STAGE_NAMES])
    finally:
        gc.enable()
    return [np.array(mine[len(frames) :]) for mine in rows]


def colour_table(without: np.ndarray, with_skin: np.ndarray) -> str:
    """Median and 95th percentile of every stage and of their sum, from two arrays (F, S) of ms, beside each other."""
    lines = [f"{'ms per frame':<20}{'without':>9}{'95 %':>9}{'with skin':>11}{'95 %':>9}{'ratio':>8}"]
    for k, name in enumerate((*STAGE_NAMES, "sum of stages")):
        columns = [ms.sum(axis=1) if k == len(STAGE_NAMES) else ms[:, k] for ms in (without, with_skin)]
        (plain, plain95), (skin, skin95) = (np.percentile(column, [50, 95]) for column in columns)
        ratio = f"{skin / plain:>7.2f}x" if plain >= 0.005 else f"{'-':>8}"
        lines.append(f"{name:<20}{plain:>9.2f}{plain95:>9.2f}{skin:>11.2f}{skin95:>9.2f}{ratio}")
    return "\n".join(lines)


def run_colour(frames: int | None = None) -> int:
    """``adaptiveface bench --colour``: print the table; returns the exit status."""
    with one_thread():
        actor, scene = colour_scene(frames or FRAMES)
        sets = [Parameters().replace(skin__on=on) for on in (False, True)]
        without, with_skin = time_in_turns([FaceTracker(actor, parameters) for parameters in sets], scene)
    print(
        f"{len(actor.neutral)} vertices, {len(without)} frames with pictures, learning on; features refined by the pictures, "
        f"the detector's own time left out; processor time, one thread{machine_load()}\n"
    )
    print(colour_table(without, with_skin))
    return 0
