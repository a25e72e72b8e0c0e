"""Define an RGB-D frame and the 2D facial features that are found in it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from .camera import Camera

#: iBUG-68 numbers of the 40 features: brows, eye contours, lips (paper, section 1).
FEATURE_IDS = np.array([*range(18, 26), *range(36, 48), *range(48, 68)], np.int32)

#: MediaPipe FaceLandmarker index of each feature in ``FEATURE_IDS``.
MEDIAPIPE_INDICES = np.array(
    [63, 105, 66, 107, 336, 296, 334, 293]
    + [33, 160, 158, 133, 153, 144, 362, 385, 387, 263, 373, 380]
    + [61, 40, 37, 0, 267, 270, 291, 321, 314, 17, 84, 91]
    + [78, 81, 13, 311, 308, 402, 14, 178],
    np.int32,
)

#: Landmarks of MediaPipe's face mesh, irises included, and those of the iris centres, left eye of the subject first.
LANDMARKS = 478
IRIS_CENTRES = (473, 468)

#: Region of each feature in ``FEATURE_IDS``, for reports and weights.
FEATURE_REGIONS = np.array(["brows"] * 8 + ["eyes"] * 12 + ["lips"] * 20)


@dataclass(frozen=True)
class DetectedFace:
    """Everything that the detector found of a face.

    Attributes
    ----------
    mesh : (478, 3)
        MediaPipe's landmarks, pixels, and their depth on the same scale.
    scores : (51,) or None
        Expression scores from 0 to 1, in the order of ``expression_names.SCORE_NAMES``.
    """

    mesh: np.ndarray
    scores: np.ndarray | None = None


@dataclass(frozen=True)
class Features2D:
    """The 2D features of one frame, in the order of ``FEATURE_IDS``.

    Attributes
    ----------
    pixels : (40, 2) float64
        Places in the depth image, pixels; NaN where a feature was not seen.
    confidence : (40,)
        From 0 to 1; 0 where a feature was not seen.
    face : DetectedFace or None
        Everything else that the detector found. None where the features did not come from the detector.
    irises : (2, 2) or None
        Iris centres where they are known without the detector, pixels; NaN where they were not seen.
    """

    pixels: np.ndarray
    confidence: np.ndarray
    face: DetectedFace | None = None
    irises: np.ndarray | None = None

    @property
    def iris_centres(self) -> np.ndarray | None:
        """Centres of the irises, (2, 2) px, the subject's left eye first; None if they were not searched."""
        if self.irises is not None:
            return self.irises
        if self.face is None or len(self.face.mesh) < LANDMARKS:
            return None
        return self.face.mesh[list(IRIS_CENTRES), :2]

    @cached_property
    def valid(self) -> np.ndarray:
        """(40,) bool: seen, finite, with positive confidence. Found out once, as a frame is asked a dozen times."""
        seen: np.ndarray = np.isfinite(self.pixels).all(axis=1) & (self.confidence > 0)
        seen.setflags(write=False)
        return seen

    @property
    def bounding_box(self) -> np.ndarray:
        """(4,) u_min, v_min, u_max, v_max of the valid features, pixels."""
        seen = self.pixels[self.valid]
        return np.concatenate([seen.min(axis=0), seen.max(axis=0)])


@dataclass(frozen=True)
class RgbdFrame:
    """One frame of a source.

    Attributes
    ----------
    depth : (H, W) float32
        Depth, mm; 0 where nothing was measured, never NaN.
    camera : Camera
        The calibration.
    colour : (H, W, 3) uint8 or None
        RGB, aligned to the depth pixel by pixel.
    index : int
        The frame's number in the source.
    timestamp : float
        Seconds.
    features : Features2D or None
        The 2D features, where a face was found.
    searched : bool
        False where nobody looked for features, for a tracker that can predict them; then there are none.
    """

    depth: np.ndarray
    camera: Camera
    colour: np.ndarray | None = None
    index: int = 0
    timestamp: float = 0.0
    features: Features2D | None = None
    searched: bool = True

    @property
    def seen(self) -> Features2D:
        """The features of a frame that has some; raises ValueError for one without."""
        if self.features is None:
            raise ValueError(f"frame {self.index} has no 2D features")
        return self.features
