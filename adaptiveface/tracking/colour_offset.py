"""Whether colour lies on depth: features found in the pictures and lifted by the depth against those of the fitted head.

A head that is fitted to features beside its depth is a compromise of both, a person who does not exist, and tracks without a
gap. What remains of the disagreement is the same in every frame. Measured on performers (median of 16 frames, across the
viewing direction): 0.1 and 0.2 mm where the pictures lie on the depth, 2.6 and 3.6 mm where they are 20 px to its right; on
real recordings 0.3 mm (TrueDepth) and 0.8 mm (Kinect v2, infrared). Pictures that are too high or too low are mostly fitted
away, as a head that is longer or tilted: 15 px left 1.3 mm, 20 px sometimes less than what is said here.
"""

from __future__ import annotations

import numpy as np

from ..geometry.frame import RgbdFrame
from ..geometry.mesh import transform_points
from ..model.actor import Actor
from .detection import lift_features
from .types import TrackedFrame

#: Median disagreement across the viewing direction that is said, mm.
SAID_MM = 1.0
#: Frames before anything is said, frames after which nothing new is learned, and features that a frame must show.
FEWEST_FRAMES, MOST_FRAMES, FEWEST_FEATURES = 5, 90, 20


class ColourOffset:
    """Collects tracked frames with their features; :meth:`note` says what is wrong, if anything."""

    def __init__(self, actor: Actor) -> None:
        self._triangles, self._weights = actor.feature_triangles, actor.feature_weights
        self._found: list[np.ndarray] = []

    def add(self, tracked: TrackedFrame, frame: RgbdFrame) -> None:
        """Take a frame with depth and features."""
        if not tracked.tracked or frame.features is None or len(self._found) >= MOST_FRAMES:
            return
        index, lifted = lift_features(frame)
        if len(index) < FEWEST_FEATURES:
            return
        points = np.einsum("fk,fkd->fd", self._weights[index], tracked.v1[self._triangles[index]])
        off = np.median(lifted - transform_points(tracked.head_pose, points), axis=0)
        self._found.append(np.append(off, frame.camera.fx / np.median(lifted[:, 2])))

    def note(self, name: str) -> str:
        """One line that names the likely cause, or "" where features and head agree."""
        if len(self._found) < FEWEST_FRAMES:
            return ""
        right, down, _, scale = np.median(self._found, axis=0)
        if np.hypot(right, down) < SAID_MM:
            return ""
        return (
            f"{name}: features lifted by the depth lie {np.hypot(right, down):.1f} mm ({scale * right:+.1f}, "
            f"{scale * down:+.1f} px) beside the fitted head: the colour is probably not registered to the depth; "
            "align the pictures to the depth (in the recorder: registration, or depth to colour alignment) and record again"
        )
