"""Make what the figures show: synthetic performers, their captured actors, and trackers that see the same frames."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ..evaluation.metrics import TrueSurface, true_motion
from ..geometry.frame import RgbdFrame
from ..model.actor import Actor
from ..neutral.capture import capture_actor
from ..parameters import Parameters
from ..synthetic.sensor import SyntheticSensor
from ..tracking.adaptive_pca import AdaptiveModel
from ..tracking.tracker import FaceTracker
from ..tracking.types import TrackedFrame

#: The two sets that every figure compares.
PARAMETER_SETS: Mapping[str, Parameters] = {"paper()": Parameters.paper(), "our defaults": Parameters()}
NEUTRAL_FRAMES = 20

#: The six basic emotions as activations of the embedded model's expressions, equal on both sides. They follow the action
#: units that Ekman and Friesen give for the prototypes.
EMOTIONS: Mapping[str, Mapping[str, float]] = {
    "anger": {"browDown": 0.9, "eyeSquint": 0.5, "noseSneer": 0.35, "mouthPress": 0.7, "mouthRollUpper": 0.3},
    "disgust": {"noseSneer": 0.9, "mouthUpperUp": 0.6, "browDown": 0.4, "cheekSquint": 0.4, "mouthFrown": 0.4},
    "fear": {
        **{"browInnerUp": 0.7, "browOuterUp": 0.4, "browDown": 0.3},
        **{"eyeWide": 0.8, "mouthStretch": 0.7, "jawOpen": 0.25},
    },
    "joy": {"cheekSquint": 0.7, "mouthSmile": 0.9, "mouthDimple": 0.3, "jawOpen": 0.15},
    "sadness": {"browInnerUp": 0.9, "browDown": 0.3, "mouthFrown": 0.8, "mouthShrugLower": 0.5, "eyeSquint": 0.2},
    "surprise": {"browInnerUp": 0.8, "browOuterUp": 0.9, "eyeWide": 0.7, "jawOpen": 0.55},
}


@dataclass(frozen=True)
class Take:
    """A performer in front of a sensor, without colour, and the ``actor`` captured from the leading neutral frames."""

    sensor: SyntheticSensor
    actor: Actor

    @classmethod
    def of(cls, sensor: SyntheticSensor) -> Take:
        """Capture the actor of a sensor."""
        return cls(sensor, capture_actor([sensor.read(index) for index in range(sensor.neutral_frames)]))

    @classmethod
    def performed(cls, seed: int, noise: str, frames: int, repeats: int) -> Take:
        """Make a take of the performer's own performance of ``frames`` frames, ``repeats`` times."""
        return cls.of(SyntheticSensor(seed, noise, NEUTRAL_FRAMES, frames, repeats, colour=False))

    @property
    def scored(self) -> np.ndarray:
        """Which vertices are frontal and visible to a depth camera, (N,) bool."""
        return self.actor.frontal & self.actor.depth_valid

    def distance(self, result: TrackedFrame, stage: str = "v4") -> np.ndarray:
        """Distances (N,) of a stage's mesh from the true surface, mm; NaN for vertices that are not :attr:`scored`."""
        truth = self.sensor.ground_truth(result.index).vertices
        out = np.full(len(truth), np.nan)
        points = result.in_camera(getattr(result, stage))[self.scored]
        out[self.scored] = TrueSurface(truth, self.actor.triangles).distance(points)
        return out

    def liveliest(self, count: int, apart: int = 12) -> list[int]:
        """Frames of the first performance with the largest true motion, in order, at least ``apart`` frames from each other."""
        first = self.sensor.neutral_frames
        means = []
        for index in range(first, first + self.sensor.frames):
            truth = self.sensor.ground_truth(index)
            moved = true_motion(truth.vertices, truth.head_pose, self.sensor.performer.neutral)[self.scored]
            means.append(np.linalg.norm(moved, axis=1).mean())
        motion = np.array(means)
        chosen: list[int] = []
        while len(chosen) < count and np.isfinite(motion).any() and motion.max() > 0:
            best = int(motion.argmax())
            chosen.append(first + best)
            motion[max(best - apart + 1, 0) : best + apart] = -1.0
        return sorted(chosen)


class Tracked(NamedTuple):
    """One frame of one tracker: the ``name`` of its parameters, its ``result``, and the ``model`` before that frame."""

    name: str
    result: TrackedFrame
    model: AdaptiveModel


def track(
    take: Take, sets: Mapping[str, Parameters] = PARAMETER_SETS, frames: Iterable[RgbdFrame] | None = None
) -> Iterator[Tracked]:
    """Track every frame with every parameter set and yield the results one by one. Nothing is kept."""
    trackers = {name: FaceTracker(take.actor, parameters) for name, parameters in sets.items()}
    for frame in take.sensor if frames is None else frames:
        for name, tracker in trackers.items():
            before = tracker.model.copy()
            yield Tracked(name, tracker.track(frame), before)


def emotional(seed: int, noise: str, frames: int) -> tuple[Take, dict[str, range]]:
    """Make a take of the six emotions, ``frames`` frames each, performed twice; also say when each is held the second time."""
    sensor = SyntheticSensor(seed, noise, NEUTRAL_FRAMES, frames * len(EMOTIONS), 2, colour=False)
    names = sensor.performer.expression_names
    rise = np.arange(frames) / (frames - 1)
    envelope = np.clip(1.6 * np.sin(np.pi * rise), 0.0, 1.0)
    held, script = {}, np.zeros((frames * len(EMOTIONS), len(names)))
    top = np.flatnonzero(envelope >= 1.0)
    for number, (emotion, units) in enumerate(EMOTIONS.items()):
        start = number * frames
        levels = [
            next((v for unit, v in units.items() if name in (unit, unit + "Left", unit + "Right")), 0.0) for name in names
        ]
        script[start : start + frames] = envelope[:, None] * levels
        first = sensor.neutral_frames + sensor.frames + start
        held[emotion] = range(first + int(top[0]), first + int(top[-1]) + 1)
    sensor.script = script
    return Take.of(sensor), held
