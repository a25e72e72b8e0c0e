"""Let a learner write a core function of the method, grade it in words, and run the tracker on it.

    from adaptiveface import exercises
    exercises.POINT_TO_PLANE_STEP.check(my_function)
    exercises.POINT_TO_PLANE_STEP.hint(1)

Each exercise is an :class:`Exercise`: ``grade`` runs a function on random cases with fixed seeds, ``stages``
makes the stages of a tracker that calls it, ``track`` compares the tracker with and without it, ``check`` does all of this.
"""

from .bounded import BOUNDED_LEAST_SQUARES
from .brightness import BRIGHTNESS_STEP
from .cotangent import COTANGENT_MATRIX
from .em import EM_STEP
from .grading import Exercise, Grade, Mistake, Report
from .identity import IDENTITY_STEP
from .kalman import KALMAN_STEP
from .laplacian import RIGHT_HAND_SIDE, FeaturePull
from .metric import ACTIVE_SHARE
from .point_to_plane import POINT_TO_PLANE_STEP
from .projection import PROJECT
from .resolve import RESOLVE
from .rigidity import RIGIDITY_ENERGY
from .system import SOLVE_DEFORMATION
from .transfer import DEFORMATION_GRADIENT
from .trial import Trial
from .tsdf import TSDF_INTEGRATION

#: Every exercise, in the order of the notebooks.
EXERCISES = (
    TSDF_INTEGRATION,
    IDENTITY_STEP,
    RIGIDITY_ENERGY,
    DEFORMATION_GRADIENT,
    POINT_TO_PLANE_STEP,
    BOUNDED_LEAST_SQUARES,
    KALMAN_STEP,
    COTANGENT_MATRIX,
    SOLVE_DEFORMATION,
    RIGHT_HAND_SIDE,
    BRIGHTNESS_STEP,
    PROJECT,
    EM_STEP,
    ACTIVE_SHARE,
    RESOLVE,
)

__all__ = [
    "ACTIVE_SHARE",
    "BOUNDED_LEAST_SQUARES",
    "BRIGHTNESS_STEP",
    "COTANGENT_MATRIX",
    "DEFORMATION_GRADIENT",
    "EM_STEP",
    "EXERCISES",
    "Exercise",
    "FeaturePull",
    "Grade",
    "IDENTITY_STEP",
    "KALMAN_STEP",
    "Mistake",
    "POINT_TO_PLANE_STEP",
    "PROJECT",
    "RESOLVE",
    "RIGHT_HAND_SIDE",
    "RIGIDITY_ENERGY",
    "Report",
    "SOLVE_DEFORMATION",
    "TSDF_INTEGRATION",
    "Trial",
]
