"""A performance to watch the correctives by: three new expressions, each repeated, a hand and a fault of the sensor."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..geometry.frame import RgbdFrame
from .script import Event, unit_vector
from .sensor import SyntheticSensor

#: Expressions that the 23 blendshapes cannot mix, as expression units; see :data:`script.GESTURES`.
EXPRESSIONS = {
    "laugh": {"mouthSmile": 1.0, "jawOpen": 0.6, "cheekSquint": 1.0, "eyeSquint": 0.6, "mouthUpperUp": 0.5},
    "rage": {"browDown": 1.0, "eyeSquint": 0.8, "mouthPress": 1.0, "noseSneer": 1.0, "jawForward": 0.4},
    "smirk": {
        "mouthSmileRight": 1.0,
        "cheekSquintRight": 1.0,
        "mouthDimpleRight": 0.6,
        "jawRight": 0.6,
        "eyeSquintRight": 0.6,
    },
}
#: Frames of one round; of an expression from its onset to the next one's; of the first onset.
ROUND, SLOT, FIRST = 150, 44, 6
#: Frames after the neutral ones in which a hand passes, and in which half of the depth image arrives displaced.
HAND, FAULT = range(138, 148), range(238, 241)
#: How far the faulty half is displaced, mm: farther, and the head no longer fits; the frame would not be tracked at all.
FAULT_MM = 11.0


def lesson_script(names: tuple[str, ...]) -> np.ndarray:
    """Return the (150, E) activations of one round.

    Each expression rises in 8 frames, is held for 20 frames and falls in 8 frames.
    """
    time = np.arange(ROUND, dtype=float)
    total = np.zeros((ROUND, len(names)))
    for k, units in enumerate(EXPRESSIONS.values()):
        event = Event(FIRST + SLOT * k, 8, 20, 8, unit_vector(units, names))
        total += np.outer(event.level(time), event.units)
    return np.clip(total, 0.0, 1.0)


class LessonSensor(SyntheticSensor):
    """Performer ``seed`` makes the three expressions of :data:`EXPRESSIONS` in turn, and then all of them once more.

    In the frames :data:`HAND` a hand passes in front of the face; in :data:`FAULT` one half of the depth image is
    displaced by :data:`FAULT_MM`. 320 x 240 pixels from 450 mm, so that 300 frames fit into the memory of a small server.
    """

    def __init__(self, seed: int = 7, noise: str = "truedepth", neutral_frames: int = 16) -> None:
        super().__init__(seed, noise, neutral_frames, ROUND, 2, 320, 240, distance=450.0)
        self.script = lesson_script(self.performer.expression_names)
        self.name = f"three expressions by synthetic performer {seed}, {noise} noise"

    def read(self, index: int) -> RgbdFrame:
        """Frame ``index``; raises IndexError outside the recording."""
        frame, number = super().read(index), index - self.neutral_frames
        if number in HAND:
            share = (number - HAND.start) / (len(HAND) - 1)
            return replace(frame, depth=self._with_hand(frame.depth, index, share))
        if number in FAULT:
            depth = frame.depth.copy()
            half = depth[:, : depth.shape[1] // 2]
            half[half > 0] += FAULT_MM
            return replace(frame, depth=depth)
        return frame

    def _with_hand(self, depth: np.ndarray, index: int, share: float) -> np.ndarray:
        """A fist, 50 mm in front of the nose, that goes from the subject's left cheek to the mouth as ``share`` grows."""
        u0, v0 = self.camera.project(self.ground_truth(index).vertices.mean(axis=0)[None])[0]
        v, u = np.mgrid[: depth.shape[0], : depth.shape[1]]
        from_centre = np.hypot((u - u0 - 40 * (1 - share)) / 26, (v - v0 - 14) / 32)
        nose = depth[depth > 0].min()
        return np.where(from_centre < 1, nose - 50 + 25 * from_centre**2, depth).astype(depth.dtype)
