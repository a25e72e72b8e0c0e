"""Describe how the skin around each 2D feature looks on the neutral: samples of the surface with their colours.

The paper's features come from a detector alone. A detector such as MediaPipe errs by a pixel, depending on the expression and
the person. The picture of the neutral tells where a point of the skin really went (``tracking/feature_refinement.py``).
"""

from __future__ import annotations

import os
from dataclasses import dataclass

import cv2
import numpy as np

from ..errors import FileFormatError
from ..files.records import array, record

#: Gaussian blurs from coarse (which reaches farther) to fine (which is more exact), px.
BLURS = (1.5, 0.0)
#: Brightness is relative to its surroundings, a blur of this size, px, because smooth shading moves over a turning head.
SURROUNDINGS = 4.0
#: How many units of a channel the whole of a colour share is; of brightness, one unit is one percent.
CHROMA = 300.0
#: A difference of fewer grey levels is noise.
DARK = 8.0


@record
@dataclass(frozen=True)
class Appearance:
    """Q samples of the skin around the features, sorted by feature."""

    triangles: np.ndarray = array("Q 3", "i4", "corners of the triangle that a sample of the skin sits on", below="N")
    weights: np.ndarray = array("Q 3", doc="barycentric weights of its place there")
    feature: np.ndarray = array("Q", "i4", "the feature that it belongs to, ascending")
    colours: np.ndarray = array(f"{len(BLURS)} Q 3", doc="how it looks on the neutral, coarse and fine (`channels`)")

    def __len__(self) -> int:
        return len(self.feature)

    @classmethod
    def checked(cls, path: str | os.PathLike, data: dict[str, np.ndarray]) -> Appearance:
        """Of the arrays in a file; raises :class:`FileFormatError` where they describe no samples of 40 features."""
        feature = data["feature"]
        if len(feature) == 0 or (np.diff(feature.astype(int)) < 0).any() or feature[0] < 0 or feature[-1] >= 40:
            raise FileFormatError(f"{path}: 'appearance_feature' must hold numbers from 0 to 39 in ascending order")
        return cls(**data)


def channels(picture: np.ndarray, blur: float) -> np.ndarray:
    """(H, W, 3) float32 of an RGB picture (H, W, 3): brightness in percent of what is around, and two colour differences.

    Neither depends much on the light: lips stay redder than skin where a shadow falls. On the real mannequin's turn plain
    brightness pulled the lips along with the shading (median 0.97 px; so 0.84; the detector's own 1.20).
    """
    rgb = picture.astype(np.float32)
    if blur:
        rgb = cv2.GaussianBlur(rgb, (0, 0), blur)
    red, green, blue = rgb[..., 0], rgb[..., 1], rgb[..., 2]
    total = (red + green + blue + DARK) / CHROMA
    brightness = 0.3 * red + 0.59 * green + 0.11 * blue + DARK
    contrast = 100.0 * np.log(brightness / cv2.GaussianBlur(brightness, (0, 0), SURROUNDINGS))
    return np.stack([contrast, (red - green) / total, (green - blue) / total], axis=-1)
