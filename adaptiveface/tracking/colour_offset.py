"""Tell whether colour is registered to depth, from lifted features and those of the fitted head.

If the features lie beside their depth, the fitted head is a compromise: a person who does not exist, but who is tracked without
a gap. The rest of the disagreement is the same in every frame. It was measured on performers as a median of 16 frames, across
the viewing direction. It is 0.1 and 0.2 mm for registered pictures, and 2.6 and 3.6 mm for pictures that are 20 px too far to
the right. On real recordings it is 0.3 mm (TrueDepth) and 0 to 1.3 mm (three Kinects v2 with infrared pictures, which are
always registered). The largest of these is half a pixel and scatters by 1.5 mm from frame to frame, while unregistered
pictures scatter by 0.1 to 0.2 mm. A disagreement is therefore only reported if it exceeds a pixel and its own scatter. The fit
hides most of a vertical offset in a longer or tilted head: 20 px leave 2.1 to 0.5 mm.
"""

from __future__ import annotations

import numpy as np

from ..geometry.frame import RgbdFrame
from ..geometry.mesh import transform_points
from ..model.actor import Actor
from .detection import lift_features
from .types import TrackedFrame

#: Smallest median disagreement that is reported: mm, pixels, and multiples of its scatter over the frames.
SAID_MM, SAID_PIXELS, SAID_SCATTER = 1.0, 1.0, 2.0
#: Frames before anything is reported, frames after which nothing new is learned, and features that a frame must show.
FEWEST_FRAMES, MOST_FRAMES, FEWEST_FEATURES = 5, 90, 20


class ColourOffset:
    """Collects tracked frames with their features. :meth:`note` says what is wrong, if anything."""

    def __init__(self, actor: Actor) -> None:
        self._triangles, self._weights = actor.feature_triangles, actor.feature_weights
        self._found: list[np.ndarray] = []

    def add(self, tracked: TrackedFrame, frame: RgbdFrame) -> None:
        """Add a frame with depth and features."""
        if not tracked.tracked or frame.features is None or len(self._found) >= MOST_FRAMES:
            return
        index, lifted = lift_features(frame)
        if len(index) < FEWEST_FEATURES:
            return
        points = np.einsum("fk,fkd->fd", self._weights[index], tracked.v1[self._triangles[index]])
        off = np.median(lifted - transform_points(tracked.head_pose, points), axis=0)
        self._found.append(np.append(off, frame.camera.fx / np.median(lifted[:, 2])))

    def note(self, name: str) -> str:
        """A line that names the likely cause, or "" if the features and the head agree."""
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
    """Whether the disagreement of many frames exceeds a pixel of the depth map and its own scatter.

    ``found`` (F, 4) holds for each frame mm to the right, down and away from the camera, and px per mm. The scatter is the
    median distance from the median over the frames, as a standard deviation (Rousseeuw & Croux 1993).
    """
    middle = np.median(found, axis=0)
    scatter = 1.4826 * np.median(np.linalg.norm(found[:, :2] - middle[:2], axis=1))
    return bool(np.hypot(*middle[:2]) > max(SAID_MM, SAID_PIXELS / middle[3], SAID_SCATTER * scatter))
