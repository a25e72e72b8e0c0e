"""2D features of frames that the detector did not look at: where the tracked face has them, for the refinement to move.

The head's pose is known from the frame's own depth, and the expression from the last frame. What the face did since then, the
neutral's colours find (:mod:`.feature_refinement`), which take the prediction for a detection. A face that cannot be predicted
that way has the detector look at the next frame: features that moved far, or of which few are seen.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..geometry.frame import Features2D, RgbdFrame
from ..geometry.mesh import surface_points, transform_points
from ..model.actor import Actor
from .state import TrackerState

#: Tracking is certain while less of the face than this is behind something.
MOST_OCCLUDED = 0.05
#: and while features move from their prediction by no more than this between two frames (95 % of them), mm on the face;
FARTHEST = 6.0
#: and while so many are seen.
FEWEST = 20


def predict_features(frame: RgbdFrame, actor: Actor, last: TrackerState, pose: np.ndarray) -> RgbdFrame:
    """The frame with features where last frame's face has them in its new ``pose`` (4, 4), if nobody looked for any."""
    if frame.searched or frame.colour is None or last.confidence is None:
        return frame
    points = transform_points(pose, surface_points(last.v4, actor.feature_triangles, actor.feature_weights))
    pixels = np.where(last.confidence[:, None] > 0, frame.camera.project(points), np.nan)
    return replace(frame, features=Features2D(pixels, last.confidence))


def confidence_kept(found: RgbdFrame, refined: RgbdFrame) -> np.ndarray | None:
    """(40,) the confidence of the features ``found``, detected or predicted, to predict the next ones with; None: not certain.

    ``refined``: the frame with these features refined and weighed by the depth.
    """
    if found.colour is None or found.features is None or refined.features is None:
        return None
    seen = refined.features.valid & found.features.valid
    if seen.sum() < FEWEST:
        return None
    if not found.searched:
        moved = np.linalg.norm(refined.features.pixels - found.features.pixels, axis=1)[seen]
        depth = float(np.median(found.depth[found.depth > 0]))
        if np.percentile(moved, 95) > FARTHEST * found.camera.fx / depth:
            return None
    return found.features.confidence
