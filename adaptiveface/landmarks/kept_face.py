"""Choose the face to track among several in a picture, and give video mode the strictly rising clock that it needs."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ..geometry.frame import RgbdFrame

#: Time for which the kept face must be gone before another one is chosen, s.
PATIENCE = 0.3
#: Largest change of a face's depth between frames, mm. In the picture, a face moves by less than its own size.
DEPTH_STEP = 150.0


@dataclass(frozen=True)
class SeenFace:
    """The place of one face.

    Attributes
    ----------
    centre : (2,) array
        Centre of the face's box, px.
    size : float
        Square root of the area of the box, px.
    depth : float
        Median depth of the face, mm. It is 0 if no depth is measured.
    """

    centre: np.ndarray
    size: float
    depth: float

    @classmethod
    def of(cls, mesh: np.ndarray, frame: RgbdFrame) -> SeenFace:
        """Find the place of a face.

        Parameters
        ----------
        mesh : (n, 2 or more) array
            Landmarks of the face, px.
        frame : RgbdFrame
            The frame that shows it. The depth is the median of the depths that are measured at the landmarks.
        """
        low, high = mesh[:, :2].min(axis=0), mesh[:, :2].max(axis=0)
        u, v = np.rint(mesh[:, :2]).astype(int).T
        height, width = frame.depth.shape
        inside = (u >= 0) & (v >= 0) & (u < width) & (v < height)
        depth = frame.depth[v[inside], u[inside]]
        depth = depth[depth > 0]
        return cls((low + high) / 2, float(np.sqrt(np.prod(high - low))), float(np.median(depth)) if len(depth) else 0)

    def step_from(self, other: SeenFace) -> float:
        """Return the distance from ``other`` as a share of a face's largest step between frames, or inf beyond that step."""
        step = float(np.linalg.norm(self.centre - other.centre)) / max(other.size, 1.0)
        if self.depth and other.depth:
            step = max(step, abs(self.depth - other.depth) / DEPTH_STEP)
        return step if step < 1.0 else math.inf


class KeptFace:
    """Follows one face from frame to frame, and may choose another after that face has been gone for ``PATIENCE`` seconds."""

    def __init__(self) -> None:
        self._last: SeenFace | None = None
        self._time, self._size = 0.0, (0, 0)

    def choose(self, meshes: list[np.ndarray], frame: RgbdFrame) -> np.ndarray | None:
        """Choose the kept face among all faces of a frame.

        While a face is kept, only a face near its last place and depth matches. Otherwise the nearest face is chosen, or the
        largest if no depth is measured. The choice starts over when the clock jumps or the image size changes.

        Parameters
        ----------
        meshes : list of (n, 2 or more) arrays
            Landmarks of every face, px.
        frame : RgbdFrame
            The frame that shows them.

        Returns
        -------
        array or None
            The entry of ``meshes`` that is the kept face; None if that face is not seen.
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

    A timestamp that goes back, jumps by more than a second or is not a number counts as one frame later. Such timestamps come
    from a sensor that was reopened or a clock that was set.
    """

    def __init__(self) -> None:
        self._milliseconds, self._timestamp = -1, math.nan

    def tick(self, timestamp: float) -> int:
        """Advance the clock by one frame.

        Parameters
        ----------
        timestamp : float
            Time of the frame, s.

        Returns
        -------
        int
            Time for MediaPipe, ms. It is always larger than the last one.
        """
        passed = timestamp - self._timestamp
        self._timestamp = timestamp
        step = round(1000 * passed) if 0 < passed <= 1.0 else 33
        self._milliseconds += max(step, 1)
        return self._milliseconds
