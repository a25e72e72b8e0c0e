"""Describe how the whole face looks on the neutral: samples of the surface with their colours and their reliability.

``appearance.py`` describes the skin around the 40 features. These samples cover the whole frontal region. They are sorted
by how much they tell, so that the first ones alone also cover the face (``tracking/dense_skin.py``).
"""

from __future__ import annotations

import os
from dataclasses import dataclass, fields

import cv2
import numpy as np

from ..errors import FileFormatError
from ..files.records import array, record
from .appearance import SURROUNDINGS, contrast, mixtures

#: An actor keeps no more samples than this.
MOST = 8000
#: So many pixels show a channel of :func:`skin_channels` alike: the colours come from a picture of half the size.
PIXELS = np.array([1.0, 4.0, 4.0])


@record
@dataclass(frozen=True)
class Skin:
    """Samples on the surface of the neutral, the most telling ones first. Their colours are :func:`skin_channels`."""

    triangles: np.ndarray = array("SKIN 3", "i4", "corners of the triangle that a sample of the face sits on", below="N")
    weights: np.ndarray = array("SKIN 3", doc="barycentric weights of its place there")
    colours: np.ndarray = array("SKIN 3", doc="how it looks on the neutral (`skin_channels`), mean over the pictures")
    deviations: np.ndarray = array("SKIN 3", doc="standard deviation of that over the pictures: what light and pose change")
    slopes: np.ndarray = array("SKIN 3 2", doc="change of the colours along the edges from the triangle's first corner")
    coherence: np.ndarray = array("SKIN 3", doc="share of a picture's squared gradient that all the pictures show alike")

    def __len__(self) -> int:
        return len(self.triangles)

    @property
    def coloured(self) -> bool:
        """Whether the pictures had colour. In infrared ones red, green and blue are equal, so that two channels are empty."""
        return bool(self.colours[:, 1:].any())

    def first(self, count: int) -> Skin:
        """The ``count`` most telling samples."""
        return Skin(**{entry.name: getattr(self, entry.name)[:count] for entry in fields(self)})

    @classmethod
    def checked(cls, path: str | os.PathLike, data: dict[str, np.ndarray]) -> Skin:
        """Of the arrays in a file; raises :class:`FileFormatError` where they describe no samples of a surface."""
        if not 0 < len(data["triangles"]) <= MOST:
            raise FileFormatError(f"{path}: 'skin_triangles' must hold 1 to {MOST} samples")
        if min(data["deviations"].min(), data["coherence"].min()) < 0 or data["coherence"].max() > 1:
            raise FileFormatError(f"{path}: 'skin_deviations' holds negative values, or 'skin_coherence' none of 0 to 1")
        weights = data["weights"]
        if weights.min() < -0.01 or np.abs(weights.sum(axis=1) - 1).max() > 0.01:
            raise FileFormatError(f"{path}: rows of 'skin_weights' are not barycentric (0 to 1, sum 1)")
        return cls(**data)


def skin_channels(picture: np.ndarray) -> np.ndarray:
    """(H, W, 3) float32 of an RGB picture (H, W, 3): brightness in percent of what is around; two shares of colour against it.

    As :func:`~adaptiveface.model.appearance.channels`, but that the colours are coarser, as cameras send them, and lose what
    changes slowly over the face: gloss has the lamp's colour, and moves over the skin as the head turns.
    """
    size = picture.shape[1], picture.shape[0]
    brightness, *mixed = mixtures(picture)
    first, second, total = (cv2.pyrDown(plane) for plane in mixed)
    shares = [cv2.divide(first, total), cv2.divide(second, total)]
    slow = [cv2.GaussianBlur(share, (0, 0), 0.5 * SURROUNDINGS) for share in shares]
    fine = [cv2.pyrUp(share - blurred, dstsize=size) for share, blurred in zip(shares, slow, strict=True)]
    return cv2.merge([contrast(brightness), *fine])
