"""Describe how the skin around each 2D feature looks on the neutral: samples of the surface with their colours.

The paper's features come from a detector alone. A detector such as MediaPipe errs by a pixel, depending on the expression and
the person. The picture of the neutral tells where a point of the skin really went (``tracking/feature_refinement.py``).
"""

from __future__ import annotations

import os
from dataclasses import dataclass

import cv2
import numpy as np

from ..caches.compiled import compiled
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
    return blurred_channels(mixtures(picture), blur)


def blurred_channels(mixed: np.ndarray, blur: float) -> np.ndarray:
    """:func:`channels` of a picture's :func:`mixtures` (4, H, W), which serve for all blurs."""
    brightness, first, second, total = (cv2.GaussianBlur(plane, (0, 0), blur) for plane in mixed) if blur else mixed
    return cv2.merge([contrast(brightness), cv2.divide(first, total), cv2.divide(second, total)])


def contrast(brightness: np.ndarray) -> np.ndarray:
    """(H, W) percent of what is around: the blur of half the size, which takes a third of the time of the whole one."""
    around = cv2.GaussianBlur(cv2.pyrDown(brightness), (0, 0), 0.5 * SURROUNDINGS)
    relative = cv2.divide(brightness, cv2.pyrUp(around, dstsize=brightness.shape[::-1]))
    return cv2.log(relative) * np.float32(100.0)


def mixtures(picture: np.ndarray) -> np.ndarray:
    """(4, H, W) float32 of an RGB picture (H, W, 3): brightness, and two differences and the sum that they are shares of."""
    return _mixtures(*cv2.split(picture))


@compiled(nogil=True)
def _mixtures(red: np.ndarray, green: np.ndarray, blue: np.ndarray) -> np.ndarray:
    """:func:`mixtures` of the picture's planes, each (H, W) uint8: pixels side by side take a quarter of the time."""
    height, width = red.shape
    out = np.empty((4, height * width), np.float32)
    brightness, first, second, total = out
    reds, greens, blues = red.ravel(), green.ravel(), blue.ravel()
    for i in range(len(reds)):
        r, g, b = np.float32(reds[i]), np.float32(greens[i]), np.float32(blues[i])
        brightness[i] = np.float32(0.3) * r + np.float32(0.59) * g + np.float32(0.11) * b + np.float32(DARK)
        first[i], second[i] = r - g, g - b
        total[i] = (r + g + b + np.float32(DARK)) * np.float32(1.0 / CHROMA)
    return out.reshape(4, height, width)
