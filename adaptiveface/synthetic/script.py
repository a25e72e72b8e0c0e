"""The performance: which expressions when, and how the head moves. Deterministic in the seed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..geometry.mesh import rotation_vector_matrix
from .fields import soft_step

# Gestures as expression units and strengths; a name without Left/Right stands for both sides. The six basic emotions
# follow the action units of Ekman & Friesen's EMFACS.
EMOTIONS = {
    "happiness": {"mouthSmile": 0.8, "cheekSquint": 0.7, "eyeSquint": 0.3, "mouthDimple": 0.2},
    "sadness": {"browInnerUp": 0.9, "browDown": 0.3, "mouthFrown": 0.8, "mouthShrugLower": 0.4, "eyeSquint": 0.2},
    "surprise": {"browInnerUp": 0.9, "browOuterUp": 0.9, "eyeWide": 0.9, "jawOpen": 0.5},
    "fear": {
        "browInnerUp": 0.8,
        "browOuterUp": 0.4,
        "browDown": 0.4,
        "eyeWide": 0.8,
        "mouthStretch": 0.8,
        "jawOpen": 0.2,
    },
    "anger": {"browDown": 1.0, "eyeSquint": 0.6, "mouthPress": 0.7, "noseSneer": 0.3, "jawForward": 0.2},
    "disgust": {"noseSneer": 0.9, "mouthUpperUp": 0.6, "mouthFrown": 0.4, "browDown": 0.4, "mouthLowerDown": 0.2},
}
GESTURES = {
    "brows up": {"browInnerUp": 0.8, "browOuterUp": 1.0},
    "one brow": {"browOuterUpLeft": 0.9, "browDownRight": 0.6},
    "smile left": {"mouthSmileLeft": 0.8, "cheekSquintLeft": 0.6, "eyeSquintLeft": 0.3},
    "smile right": {"mouthSmileRight": 0.8, "cheekSquintRight": 0.6, "eyeSquintRight": 0.3},
    "open smile": {"mouthSmile": 0.7, "jawOpen": 0.4, "cheekSquint": 0.5, "mouthUpperUp": 0.3},
    "jaw left": {"jawLeft": 0.9, "jawOpen": 0.15},
    "jaw right": {"jawRight": 0.9, "jawOpen": 0.15},
    "jaw wide": {"jawOpen": 0.85, "browOuterUp": 0.3},
    "pucker": {"mouthPucker": 0.95},
    "cheek puff": {"cheekPuff": 0.9, "mouthPucker": 0.2},
    "mouth aside": {"mouthLeft": 0.7, "mouthPucker": 0.3},
    "chin": {"mouthShrugLower": 0.8, "mouthShrugUpper": 0.4},
}
VISEMES = {
    "aa": {"jawOpen": 0.45, "mouthLowerDown": 0.2},
    "oo": {"mouthPucker": 0.7, "jawOpen": 0.12},
    "ee": {"mouthStretch": 0.5, "mouthSmile": 0.25, "jawOpen": 0.1},
    "mm": {"mouthPress": 0.5, "mouthRollLower": 0.3},
    "ff": {"mouthRollLower": 0.5, "mouthUpperUp": 0.3, "jawOpen": 0.06},
    "oh": {"mouthFunnel": 0.6, "jawOpen": 0.3},
    "th": {"mouthLowerDown": 0.4, "jawOpen": 0.15},
    "sh": {"mouthFunnel": 0.7, "mouthPucker": 0.3},
}


@dataclass(frozen=True)
class Event:
    """One gesture: soft onset, hold, soft release; times in frames; ``units`` (E,) activations at the hold."""

    start: float
    onset: float
    hold: float
    release: float
    units: np.ndarray

    def level(self, frames: np.ndarray) -> np.ndarray:
        """(F,) in [0, 1]."""
        rise = soft_step((frames - self.start) / self.onset)
        return rise * (1 - soft_step((frames - self.start - self.onset - self.hold) / self.release))


def unit_vector(gesture: dict[str, float], names: tuple[str, ...]) -> np.ndarray:
    """Return the (E,) activations of a gesture. Units that the model does not have are left out."""
    out = np.zeros(len(names))
    for unit, strength in gesture.items():
        for name in (unit, f"{unit}Left", f"{unit}Right"):
            if name in names:
                out[names.index(name)] = strength
    return out


def performance(seed: int, names: tuple[str, ...], frames: int = 300) -> np.ndarray:
    """(frames, E) activations in [0, 1] of one performance at 30 frames per second; neutral at both ends.

    The six emotions, twelve gestures and two spoken phrases in an order, strength and mixture drawn from ``seed``,
    with blinks and glances.
    """
    rng = np.random.default_rng([seed, 0x5C21])
    items = [("emotion", g) for g in EMOTIONS.values()] + [("gesture", g) for g in GESTURES.values()]
    items += [("speech", {})] * 2
    lengths = {"emotion": 26.0, "gesture": 16.0, "speech": 42.0}
    scale = max(frames - 16, 0.25 * frames) / sum(lengths[kind] for kind, _ in items)
    events, now = [], 4.0
    for k in rng.permutation(len(items)):
        kind, gesture = items[k]
        length = lengths[kind] * scale
        if kind == "speech":
            events += _speech(rng, names, now, length)
        else:
            events.append(_gesture(rng, names, gesture, now, length))
        now += length
    events += _blinks(rng, names, frames) + _glances(rng, names, frames)
    time = np.arange(frames, dtype=float)
    total = sum(np.outer(event.level(time), event.units) for event in events)
    return np.clip(total, 0.0, 1.0)


def _gesture(rng, names, gesture, start: float, length: float) -> Event:
    """Fills its slot and a little of the next one, so that gestures overlap."""
    strength = rng.uniform(0.75, 1.1) * rng.uniform(0.85, 1.15, len(names))
    onset, release = rng.uniform(0.3, 0.42) * length, rng.uniform(0.35, 0.5) * length
    hold = max(1.15 * length - onset - release, 0.0)
    return Event(start, onset, hold, release, strength * unit_vector(gesture, names))


def _speech(rng, names, start: float, length: float) -> list[Event]:
    count = max(int(length / 5.5), 1)
    step = length / count
    chosen = rng.permutation(list(VISEMES))
    out = []
    for k in range(count):
        units = rng.uniform(0.7, 1.1) * unit_vector(VISEMES[chosen[k % len(chosen)]], names)
        out.append(Event(start + k * step, 0.7 * step, 0.1 * step, 0.7 * step, units))
    return out


def _blinks(rng, names, frames: int) -> list[Event]:
    out, now = [], rng.uniform(15, 40)
    while now < frames - 12:
        out.append(Event(now, 3.0, 1.0, 4.0, unit_vector({"eyeBlink": 1.0}, names)))
        now += rng.uniform(45, 85)
    return out


def _glances(rng, names, frames: int) -> list[Event]:
    """Return quick looks to the side, up or down. Each is held for half a second."""
    aside = {"eyeLookOutLeft": 0.6, "eyeLookInRight": 0.6}, {"eyeLookInLeft": 0.6, "eyeLookOutRight": 0.6}
    looks = [*aside, {"eyeLookDown": 0.5}, {"eyeLookUp": 0.5}]
    out, now = [], rng.uniform(20, 60)
    while now < frames - 24:
        out.append(Event(now, 2.0, 14.0, 2.0, unit_vector(looks[rng.integers(len(looks))], names)))
        now += rng.uniform(60, 110)
    return out


@dataclass(frozen=True)
class HeadMotion:
    """Smooth head motion over a whole recording; frame numbers count from its first frame.

    During the first ``neutral_frames`` the head turns slowly left, right, up and down (12 degrees yaw, 7 pitch); then
    it moves freely within 20 degrees yaw, 10 pitch, 8 roll and a few centimetres. The head is ``distance`` mm from the camera.
    ``turns`` (F, 3) replaces the free turning. It holds yaw, pitch and roll of the frames after the neutral ones, degrees.
    """

    seed: int
    neutral_frames: int
    fps: float
    distance: float
    pivot: tuple[float, float, float] = (0.0, -50.0, -80.0)
    turns: np.ndarray | None = None

    def pose(self, frame: float) -> np.ndarray:
        """Return the (4, 4) rigid transform from the head to the camera at a frame, which may be fractional."""
        yaw, pitch, roll, shift = self._scan(frame) if frame < self.neutral_frames else self._free(frame)
        angles = np.radians([pitch, yaw, roll])
        turn = rotation_vector_matrix(np.array([0, angles[1], 0])) @ rotation_vector_matrix(np.array([angles[0], 0, 0]))
        turn = turn @ rotation_vector_matrix(np.array([0, 0, angles[2]]))
        pivot = np.array(self.pivot)
        flip = np.diag([1.0, -1.0, -1.0])
        out = np.eye(4)
        out[:3, :3] = flip @ turn
        out[:3, 3] = flip @ (pivot - turn @ pivot + shift) + [0.0, 0.0, self.distance]
        return out

    def _scan(self, frame: float):
        phase = 2 * np.pi * frame / max(self.neutral_frames, 1)
        return 12 * np.sin(phase), 7 * np.sin(2 * phase), 0.0, np.zeros(3)

    def _free(self, frame: float):
        rng = np.random.default_rng([self.seed, 0xAEAD])
        seconds = (frame - self.neutral_frames) / self.fps
        ramp = soft_step(seconds / 1.5)
        limits = np.array([20.0, 10.0, 8.0, 30.0, 20.0, 30.0])
        periods = np.array([6.0, 4.3, 5.2, 5.5, 4.7, 6.5])
        values = np.zeros(6)
        for share, pace in ((0.55, 1.0), (0.3, 0.53), (0.15, 0.31)):
            period = pace * periods * rng.uniform(0.85, 1.2, 6)
            values += share * np.sin(2 * np.pi * seconds / period + rng.uniform(0, 2 * np.pi, 6))
        values *= limits * rng.uniform(0.8, 1.0, 6) * ramp
        if self.turns is not None and len(self.turns):
            values[:3] = ramp * self.turns[int(np.clip(round(frame) - self.neutral_frames, 0, len(self.turns) - 1))]
        return values[0], values[1], values[2], values[3:]
