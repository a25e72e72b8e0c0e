"""A performer in colour, and the exact actor with the neutral frames that its look is gathered from."""

from __future__ import annotations

import numpy as np

from adaptiveface.geometry.frame import RgbdFrame
from adaptiveface.model.actor import Actor
from adaptiveface.neutral.capture import build_actor
from adaptiveface.synthetic.sensor import SyntheticSensor

Views = list[tuple[RgbdFrame, np.ndarray]]


def coloured_performer(neutral: int = 12, frames: int = 60, noise: float = 0.0) -> SyntheticSensor:
    """Performer 7 with ``neutral`` frames at rest, then ``frames`` of performance, and ``noise`` px of its features."""
    return SyntheticSensor(7, "truedepth", neutral, frames, repeats=1, feature_noise=noise)


def actor_and_views(sensor: SyntheticSensor, step: int = 3) -> tuple[Actor, Views]:
    """The actor with the true neutral, and every ``step``-th neutral frame with its true pose (4, 4), head to camera."""
    numbers = range(0, sensor.neutral_frames, step)
    views = [(sensor.read(index), sensor.ground_truth(index).head_pose) for index in numbers]
    return build_actor(sensor.performer.model, sensor.performer.neutral), views
