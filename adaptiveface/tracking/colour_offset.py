"""Whether colour lies on depth: features found in the pictures and lifted by the depth against those of the fitted head.

A head that is fitted to features beside its depth is a compromise of both, a person who does not exist, and tracks without a
gap. What remains of the disagreement is the same in every frame. Measured on performers (median of 16 frames, across the
viewing direction): 0.1 and 0.2 mm where the pictures lie on the depth, 2.6 and 3.6 mm where they are 20 px to its right; on
real recordings 0.3 mm (TrueDepth) and 0 to 1.3 mm (three Kinects v2, infrared, which is registered by its making). The
largest is half a pixel there, and scatters by 1.5 mm from frame to frame, where pictures beside their depth scatter by 0.1 to
0.2 mm: what is less than a pixel or no larger than its own scatter is not measured, and nothing is said of it. Pictures that
are too high or too low are mostly fitted away, as a head that is longer or tilted: 20 px left 2.1 to 0.5 mm.
"""

from __future__ import annotations

import numpy as np

from ..geometry.frame import RgbdFrame
from ..geometry.mesh import transform_points
from ..model.actor import Actor
from .detection import lift_features
from .types import TrackedFrame

#: Median disagreement across the viewing direction that is said: mm, pixels, and multiples of its scatter over the frames.
SAID_MM, SAID_PIXELS, SAID_SCATTER = 1.0, 1.0, 2.0
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
        found = np.array(self._found)
        if not beyond_doubt(found):
            return ""
        right, down, _, scale = np.median(found, axis=0)
        return (
            f"{name}: features lifted by the depth lie {np.hypot(right, down):.1f} mm ({scale * right:+.1f}, "
            f"{scale * down:+.1f} px) beside the fitted head: the colour is probably not registered to the depth; "
            "align the pictures to the depth (in the recorder: registration, or depth to colour alignment) and record again"
        )


def beyond_doubt(found: np.ndarray) -> bool:
    """Whether the disagreement of many frames is larger than a pixel of the depth map and than its own scatter.

    ``found`` (F, 4): of each frame mm to the right, down and away from the camera; px per mm. The scatter is the median
    distance from the median over the frames, as a standard deviation (Rousseeuw & Croux 1993).
    """
    middle = np.median(found, axis=0)
    scatter = 1.4826 * np.median(np.linalg.norm(found[:, :2] - middle[:2], axis=1))
    return bool(np.hypot(*middle[:2]) > max(SAID_MM, SAID_PIXELS / middle[3], SAID_SCATTER * scatter))
