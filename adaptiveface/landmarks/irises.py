"""Find irises for recordings whose features lack them, so that the gaze can be measured."""

from __future__ import annotations

import dataclasses

import numpy as np

from ..geometry.frame import FEATURE_IDS, Features2D, RgbdFrame
from .detector import FeatureDetector

#: Rows of the eyes' corners among the features, the subject's left eye first.
_CORNERS = np.searchsorted(FEATURE_IDS, [[42, 45], [36, 39]])


class IrisFinder:
    """Finds irises in the colour images of frames whose features have none. A detector is made when it is first needed."""

    def __init__(self, detector: FeatureDetector | None = None) -> None:
        self._detector = detector

    def close(self) -> None:
        """Close the detector."""
        if self._detector is not None:
            self._detector.close()
            self._detector = None

    def onto(self, frame: RgbdFrame) -> RgbdFrame:
        """Return the frame with irises, or unchanged if it lacks features or colour or already has irises."""
        features = frame.features
        if features is None or frame.colour is None or features.iris_centres is not None:
            return frame
        if self._detector is None:
            self._detector = FeatureDetector()
        found = self._detector.detect(frame)
        irises = None if found is None else beside(features, found)
        return dataclasses.replace(frame, features=dataclasses.replace(features, irises=irises))


def beside(features: Features2D, found: Features2D) -> np.ndarray | None:
    """Return the irises (2, 2) px of ``found``, moved so that the corners of each eye meet those of ``features``."""
    if found.iris_centres is None:
        return None
    return found.iris_centres + (features.pixels[_CORNERS] - found.pixels[_CORNERS]).mean(axis=1)
