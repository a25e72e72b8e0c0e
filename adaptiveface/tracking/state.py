"""What a tracker knows from one frame to the next."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from .colour_clock import ColourClock
from .kalman import FilterState


@dataclass(frozen=True)
class TrackerState:
    """Where the last frame left the face. A frame replaces it as a whole, so that a kept state stays what it was.

    What is learned over many frames is not part of it: that is the tracker's ``model``.

    Attributes
    ----------
    pose : (4, 4) float or None
        Head to camera, mm; None where the head is still to be found.
    coefficients : (A,) float
        Filtered blendshape coefficients (section 4.2).
    v1, v4 : (N, 3) float
        Meshes of the initial blendshapes and of the final deformation, head frame, mm.
    deformation : (n, 3) float
        Displacement v2 - v1 of the frontal vertices, from which the next frame's solve starts, mm.
    filter : FilterState or None
        What the Kalman filter knows; None before its first frame.
    confidence : (40,) float or None
        Of the features that were detected last; None where they cannot be predicted: the tracker is not certain.
    clock : ColourClock
        Whether the pictures are in time; kept by trackers with a colour term.
    """

    pose: np.ndarray | None
    coefficients: np.ndarray
    v1: np.ndarray
    v4: np.ndarray
    deformation: np.ndarray
    filter: FilterState | None = None
    confidence: np.ndarray | None = None
    clock: ColourClock = field(default_factory=ColourClock)
