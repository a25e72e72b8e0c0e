"""Exercises: write a core function of the tracker, have it graded in words, and watch the tracker run on it.

    from adaptiveface import exercises
    exercises.POINT_TO_PLANE_STEP.check(my_function)

Each exercise is an :class:`Exercise`: ``grade`` runs a function on random cases with fixed seeds, ``in_tracker`` is a
context in which the tracker calls it, ``track`` compares the tracker with and without it, ``check`` does all of this.
"""

from .bounded import BOUNDED_LEAST_SQUARES
from .em import EM_STEP
from .grading import Exercise, Grade, Mistake, Report
from .laplacian import RIGHT_HAND_SIDE, FeaturePull
from .point_to_plane import POINT_TO_PLANE_STEP
from .trial import Trial

#: Every exercise, in the order of the notebooks.
EXERCISES = (POINT_TO_PLANE_STEP, BOUNDED_LEAST_SQUARES, RIGHT_HAND_SIDE, EM_STEP)

__all__ = [
    "BOUNDED_LEAST_SQUARES",
    "EM_STEP",
    "EXERCISES",
    "POINT_TO_PLANE_STEP",
    "RIGHT_HAND_SIDE",
    "Exercise",
    "FeaturePull",
    "Grade",
    "Mistake",
    "Report",
    "Trial",
]
