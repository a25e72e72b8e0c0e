"""Score results against ground truth by stage, region and performance: figure 11's curves, figure 5's ablations.

Nothing here is needed for tracking. :mod:`.metrics` holds the measures as functions of arrays, :mod:`.run` scores.
"""

from .compare import bootstrap_interval, score_other, score_result
from .metrics import (
    ACTIVE_MOTION,
    TrueSurface,
    active_share,
    motion_error,
    neutral_alignment,
    pose_error,
    split_by_normal,
    surface_distance,
    tracked_alignment,
    true_motion,
)
from .regions import REGIONS, actor_regions, region_masks
from .run import STAGES, ErrorCollector, Evaluation, evaluate_run
from .truth import FIRST, NEUTRAL, PERFORMANCE_NAMES, REPEAT, GroundTruth, TruthFrame, truth_of

__all__ = [
    "ACTIVE_MOTION",
    "FIRST",
    "NEUTRAL",
    "PERFORMANCE_NAMES",
    "REGIONS",
    "REPEAT",
    "STAGES",
    "ErrorCollector",
    "Evaluation",
    "GroundTruth",
    "TrueSurface",
    "TruthFrame",
    "active_share",
    "actor_regions",
    "bootstrap_interval",
    "evaluate_run",
    "motion_error",
    "neutral_alignment",
    "pose_error",
    "region_masks",
    "score_other",
    "score_result",
    "split_by_normal",
    "surface_distance",
    "tracked_alignment",
    "true_motion",
    "truth_of",
]
