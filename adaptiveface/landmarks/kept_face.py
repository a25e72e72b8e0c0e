"""Of several faces in the picture, the one that is tracked; and the strictly rising clock that video mode asks for."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ..geometry.frame import RgbdFrame

#: Another face is taken only after the kept one has been away this long, s.
PATIENCE = 0.3
#: From one frame to the next, a face moves less than its own size in the picture and less than this in depth, mm.
DEPTH_STEP = 150.0


@dataclass(frozen=True)
class SeenFace:
    """Where one face is: ``centre`` (2,) px, ``size`` px (root of its box's area), ``depth`` mm (0: not measured)."""

    centre: np.ndarray
    size: float
    depth: float

    @classmethod
    def of(cls, mesh: np.ndarray, frame: RgbdFrame) -> SeenFace:
        """From landmarks (n, 2 or more) in pixels; the depth is the median of what is measured at the landmarks."""
        low, high = mesh[:, :2].min(axis=0), mesh[:, :2].max(axis=0)
        u, v = np.rint(mesh[:, :2]).astype(int).T
        height, width = frame.depth.shape
        inside = (u >= 0) & (v >= 0) & (u < width) & (v < height)
        depth = frame.depth[v[inside], u[inside]]
        depth = depth[depth > 0]
        return cls((low + high) / 2, float(np.sqrt(np.prod(high - low))), float(np.median(depth)) if len(depth) else 0)

    def step_from(self, other: SeenFace) -> float:
        """How far this is from ``other``, in the largest steps that a face makes between frames; inf beyond one."""
        step = float(np.linalg.norm(self.centre - other.centre)) / max(other.size, 1.0)
        if self.depth and other.depth:
            step = max(step, abs(self.depth - other.depth) / DEPTH_STEP)
        return step if step < 1.0 else math.inf


class KeptFace:
    """Follows one face from frame to frame; free to choose again when it was away for ``PATIENCE`` seconds."""

    def __init__(self) -> None:
        self._last: SeenFace | None = None
        self._time = self._size = None

    def choose(self, meshes: list[np.ndarray], frame: RgbdFrame) -> np.ndarray | None:
        """Of the landmarks (n, 2 or more) of every face in ``frame``, px: the kept face's, or None where it is not seen.

        While a face is kept, only one near its last place and depth is it. Otherwise the nearest one by depth is taken,
        or the largest where no depth is measured. A clock or an image size that changes starts over.
        """
        if self._last is not None and not self._continues(frame):
            self._last = None
        if not meshes:
            return None
        faces = [SeenFace.of(mesh, frame) for mesh in meshes]
        if self._last is not None:
            steps = [face.step_from(self._last) for face in faces]
            best = int(np.argmin(steps))
            if math.isinf(steps[best]):
                return None
        else:
            best = min(range(len(faces)), key=lambda k: (faces[k].depth or math.inf, -faces[k].size))
        self._last, self._time, self._size = faces[best], frame.timestamp, frame.depth.shape
        return meshes[best]

    def _continues(self, frame: RgbdFrame) -> bool:
        return 0.0 <= frame.timestamp - self._time <= PATIENCE and frame.depth.shape == self._size


class VideoClock:
    """Turns frame timestamps (s) into the strictly rising whole milliseconds that MediaPipe's video mode demands.

    A timestamp that falls back, jumps by more than a second or is no number (a sensor that was opened again, a clock
    that was set) counts as one frame later.
    """

    def __init__(self) -> None:
        self._milliseconds, self._timestamp = -1, math.nan

    def tick(self, timestamp: float) -> int:
        """Milliseconds for the frame of ``timestamp``, more than at the last call."""
        passed = timestamp - self._timestamp
        self._timestamp = timestamp
        step = round(1000 * passed) if 0 < passed <= 1.0 else 33
        self._milliseconds += max(step, 1)
        return self._milliseconds
