"""Render the frames of the bench's synthetic performer into memory before any clock starts."""

from __future__ import annotations

import dataclasses
import sys

import numpy as np
from tqdm import tqdm

from ..geometry.frame import RgbdFrame
from ..model.actor import Actor
from ..neutral.capture import build_actor
from ..synthetic.sensor import SyntheticSensor

#: A development seed, because the bench says nothing about accuracy.
SEED = 7


def rendering_bar(numbers):
    """Yield the numbers, with a bar on stderr while their frames are rendered."""
    return tqdm(numbers, desc="rendering", unit="frame", leave=False, disable=None, file=sys.stderr)


def bench_scene(frames: int, noise: str = "structured-light", progress=lambda frames: frames):
    """Make the actor and the list of frames of one performance of ``frames`` frames, with the embedded mesh.

    The rig has the performer's exact neutral and the transferred generic expressions, so that no scan is needed. The
    performer's folds and asymmetries lie outside the rig, and are learned.
    """
    sensor = SyntheticSensor(SEED, noise, neutral_frames=0, frames=frames, repeats=1, colour=False)
    performer = sensor.performer
    actor: Actor = build_actor(performer.model, performer.neutral)
    return actor, [_compact(sensor.read(index)) for index in progress(range(frames))]


def _compact(frame: RgbdFrame) -> RgbdFrame:
    return dataclasses.replace(frame, depth=np.ascontiguousarray(frame.depth, np.float32), colour=None)
