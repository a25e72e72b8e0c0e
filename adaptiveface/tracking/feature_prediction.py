"""Predict the 2D features of frames that the detector did not look at, from the tracked face; they are then refined.

The pose of the head is known from the frame's own depth, and the expression from the last frame. The neutral's colours
(:mod:`.feature_refinement`) find the motion since then, with the prediction in place of a detection. The detector looks at the
next frame if features moved far, or if few of them are visible, because the face cannot be predicted then.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..geometry.frame import Features2D, RgbdFrame
from ..geometry.mesh import surface_points, transform_points
from ..model.actor import Actor
from .state import TrackerState

#: Tracking is certain while a smaller share of the face than this is hidden,
MOST_OCCLUDED = 0.05
#: and while features move from their prediction by no more than this between two frames (95 % of them), mm on the face;
FARTHEST = 6.0
#: and while at least so many are visible.
FEWEST = 20


def predict_features(frame: RgbdFrame, actor: Actor, last: TrackerState, pose: np.ndarray) -> RgbdFrame:
    """If nothing was detected, give the frame the features of the last frame's face in its new ``pose`` (4, 4)."""
    if frame.searched or frame.colour is None or last.confidence is None:
        return frame
    points = transform_points(pose, surface_points(last.v4, actor.feature_triangles, actor.feature_weights))
    pixels = np.where(last.confidence[:, None] > 0, frame.camera.project(points), np.nan)
    return replace(frame, features=Features2D(pixels, last.confidence))


def confidence_kept(found: RgbdFrame, refined: RgbdFrame) -> np.ndarray | None:
    """Confidences (40,) for the features of the next prediction, or None if tracking is not certain.

    ``found`` is the frame with detected or predicted features, and ``refined`` the same frame after they were refined and
    weighed by the depth.
    """
    if found.colour is None or found.features is None or refined.features is None:
        return None
    seen = refined.features.valid & found.features.valid
    if seen.sum() < FEWEST:
        return None
    if not found.searched:
        moved = np.linalg.norm(refined.features.pixels - found.features.pixels, axis=1)[seen]
        thinned = found.depth[::8, ::8]
        depth = float(np.median(thinned[thinned > 0]))
        if np.percentile(moved, 95) > FARTHEST * found.camera.fx / depth:
            return None
    return found.features.confidence
