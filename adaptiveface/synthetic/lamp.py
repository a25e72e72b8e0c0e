"""The light in the room of a synthetic performer, as a function of time."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..geometry.rendering import Light
from .fields import soft_step

#: A lamp that is carried round the face comes back after so many seconds, and goes so far aside, degrees.
_ROUND, _ASIDE = 7.0, 70.0
#: Seconds from one change of the lamps to the next, and that a change takes.
_PERIOD, _FADE = 2.5, 0.15
#: Light of the lamps that take turns: level, colour (R, G, B), and direction of the key light, camera frame.
_LAMPS = (
    (1.0, (1.0, 1.0, 1.0), (-0.45, -0.75, -0.5)),
    (0.55, (1.12, 0.98, 0.78), (0.8, -0.3, -0.5)),
    (0.8, (0.9, 1.0, 1.12), (0.0, -1.0, -0.4)),
)


@dataclass(frozen=True)
class Lamp:
    """Light of one moment: ``light`` on a matt white surface, times ``colour`` (3,)."""

    light: Light
    colour: np.ndarray

    @property
    def brightness(self) -> np.ndarray:
        """Return the (3,) light on skin that faces the camera. A camera's automatic gain sees this light."""
        key = np.asarray(self.light.key_direction, float)
        towards = -key[2] / np.linalg.norm(key)
        return self.colour * (self.light.ambient + self.light.head + self.light.key * max((towards + 0.35) / 1.35, 0.0))


def lamp(kind: str, seconds: float) -> Lamp:
    """The light ``seconds`` after the start; kind: "steady", "moving" or "changing"."""
    if kind == "moving":
        angle = np.radians(_ASIDE) * np.sin(2 * np.pi * seconds / _ROUND)
        height = -0.35 - 0.45 * np.cos(2 * np.pi * seconds / (0.6 * _ROUND))
        direction = float(np.sin(angle)), float(height), float(-np.cos(angle))
        return Lamp(Light(ambient=0.25, head=0.25, key=0.55, key_direction=direction), np.ones(3))
    if kind == "changing":
        step, within = divmod(max(seconds, 0.0), _PERIOD)
        before, after = (_LAMPS[int(k) % len(_LAMPS)] for k in (step - 1, step))
        if step == 0:
            before = after
        share = float(soft_step(within / _FADE))
        level, colour, key = ((1 - share) * np.asarray(a) + share * np.asarray(b) for a, b in zip(before, after, strict=True))
        light = replace(Light(), key_direction=(float(key[0]), float(key[1]), float(key[2])))
        return Lamp(light, level * colour)
    return Lamp(Light(), np.ones(3))
