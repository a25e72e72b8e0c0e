"""What tracking hands back for one frame: every stage's result, so that nobody reaches into private state."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import IntEnum

import numpy as np

from ..geometry.mesh import transform_points
from ..renamed import renamed


class SampleState(IntEnum):
    """What became of a frame as a training sample (section 5); the values are those of ``result.npz``.

    HIDDEN: too little of the face has depth, or too much of it is behind something, whatever the sample looks like.
    """

    UNTRACKED = 0
    IN_ANCHOR_SPACE = 1
    LEARNED = 2
    OUTLIER = 3
    HIDDEN = 4


#: Names of the timed stages, in the order in which they run.
STAGE_NAMES = (
    "preprocess",
    "rigid",
    "blendshapes",
    "laplacian",
    "skin",
    "projection",
    "final_deformation",
    "adaptive_pca",
    "resolve",
)


@renamed
@dataclass(frozen=True)
class TrackedFrame:
    """One frame, tracked or not. Shapes: N vertices, A expressions; the stages v1..v4 are in the head frame, mm.

    head_pose (4, 4) head to camera; v1 initial blendshapes, v2 Laplacian-deformed, v3 projected on the adaptive space, v4
    final, each (N, 3) (section 4); coefficients_initial (A,) of v1 and coefficients (A,) re-solved from v4 (section 6);
    residual: mean point-to-plane distance of the rigid fit, mm; anchor_distance, adaptive_distance: mean distance of v2
    from the anchor space and from the adaptive space over the frontal region, mm, before the frame itself is learned from
    (figure 11); corrective_updates: PCA updates so far; stage_ms: milliseconds per stage of ``STAGE_NAMES``; reason: why
    the frame is not tracked, or "".
    """

    index: int
    timestamp: float
    tracked: bool
    head_pose: np.ndarray
    v1: np.ndarray
    v2: np.ndarray
    v3: np.ndarray
    v4: np.ndarray
    coefficients_initial: np.ndarray
    coefficients: np.ndarray
    sample_state: SampleState
    corrective_updates: int
    residual: float = float("nan")
    anchor_distance: float = float("nan")
    adaptive_distance: float = float("nan")
    stage_ms: dict[str, float] = field(default_factory=dict)
    reason: str = ""
    held_out: np.ndarray = field(default_factory=lambda: np.zeros(0))

    def in_camera(self, vertices: np.ndarray) -> np.ndarray:
        """Head-frame points (n, 3) in the camera frame, mm."""
        return transform_points(self.head_pose, vertices)

    @property
    def vertices(self) -> np.ndarray:
        """(N, 3) final mesh v4 in the camera frame, mm."""
        return self.in_camera(self.v4)
