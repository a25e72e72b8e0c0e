"""Define the result of one frame, which contains that of every stage, so that nothing else needs private state."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import IntEnum

import numpy as np

from ..geometry.mesh import transform_points
from ..renamed import renamed


class SampleState(IntEnum):
    """What became of a frame as a training sample (section 5). The values are those in ``result.npz``.

    A sample is HIDDEN if too little of the face has depth, if too much of it is hidden, or if its picture shows another moment
    than its depth (:mod:`.colour_clock`).
    """

    UNTRACKED = 0
    IN_ANCHOR_SPACE = 1
    LEARNED = 2
    OUTLIER = 3
    HIDDEN = 4


#: Names of the timed stages in their order.
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
    """The tracker's result for one frame, tracked or not, with N vertices and A expressions.

    Attributes
    ----------
    index : int
        The frame's number in the source.
    timestamp : float
        Seconds.
    tracked : bool
        Whether the face was tracked.
    head_pose : (4, 4)
        Head frame to camera frame, mm.
    v1, v2, v3, v4 : (N, 3)
        The mesh after each stage of section 4, head frame, mm: initial blendshapes, Laplacian-deformed, projected on the
        adaptive space, final.
    coefficients_initial, coefficients : (A,)
        Expression coefficients of v1, and re-solved from v4 (section 6).
    sample_state : SampleState
        What became of the frame as a training sample.
    corrective_updates : int
        Number of PCA updates so far.
    residual : float
        Mean point-to-plane distance of the rigid fit, mm.
    anchor_distance, adaptive_distance : float
        Mean distance of v2 from the anchor space and from the adaptive space over the frontal region, mm, before the frame
        itself is learned from (figure 11).
    stage_ms : dict
        Milliseconds per stage of ``STAGE_NAMES``.
    reason : str
        Why the frame is not tracked, or "".
    held_out : (R,)
        Error of the landmarks that no fit used, by region, % of the eyes' distance; empty if none were detected.
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
        """Turn head-frame points (n, 3) into the camera frame, mm."""
        return transform_points(self.head_pose, vertices)

    @property
    def vertices(self) -> np.ndarray:
        """The final mesh v4 (N, 3) in the camera frame, mm."""
        return self.in_camera(self.v4)
