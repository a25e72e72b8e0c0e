"""Hold what a tracker knows from one frame to the next."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from .colour_clock import ColourClock
from .kalman import FilterState


@dataclass(frozen=True)
class TrackerState:
    """The face after the last frame. A frame replaces the state as a whole, so that a stored state never changes.

    What is learned over many frames is not part of it, but of the tracker's ``model``.

    Attributes
    ----------
    pose : (4, 4) float or None
        Head frame to camera frame, mm; None if the head must be found first.
    coefficients : (A,) float
        Filtered blendshape coefficients (section 4.2).
    v1, v4 : (N, 3) float
        Meshes of the initial blendshapes and of the final deformation, head frame, mm.
    deformation : (n, 3) float
        Displacement v2 - v1 of the frontal vertices, mm, at which the next frame's solve starts.
    filter : FilterState or None
        State of the Kalman filter; None before its first frame.
    confidence : (40,) float or None
        Of the features that were detected last; None if the tracker is not certain, so that they cannot be predicted.
    clock : ColourClock
        Tells whether the pictures are in time; used by trackers with a colour term.
    """

    pose: np.ndarray | None
    coefficients: np.ndarray
    v1: np.ndarray
    v4: np.ndarray
    deformation: np.ndarray
    filter: FilterState | None = None
    confidence: np.ndarray | None = None
    clock: ColourClock = field(default_factory=ColourClock)
