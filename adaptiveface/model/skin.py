"""What the whole face looks like on the neutral: samples of the surface with their colours, and how much each of them knows.

``appearance.py`` knows the skin around the 40 features. These samples lie over the whole frontal region. The most telling ones
come first, so that whoever wants fewer takes the first ones and still covers the face (``tracking/dense_skin.py``).
"""

from __future__ import annotations

import os
from dataclasses import dataclass, fields

import numpy as np

from ..errors import FileFormatError
from ..files.records import array, record

#: An actor keeps no more samples than this.
MOST = 8000


@record
@dataclass(frozen=True)
class Skin:
    """Samples on the surface of the neutral, in the order in which they are worth taking.

    The colours are :func:`~adaptiveface.model.appearance.channels` without blur.
    """

    triangles: np.ndarray = array("SKIN 3", "i4", "corners of the triangle that a sample of the face sits on", below="N")
    weights: np.ndarray = array("SKIN 3", doc="barycentric weights of its place there")
    colours: np.ndarray = array("SKIN 3", doc="how it looks on the neutral (`channels`), mean over the pictures")
    deviations: np.ndarray = array("SKIN 3", doc="standard deviation of that over the pictures: what light and pose change")
    detail: np.ndarray = array("SKIN", doc="squared gradient of the channels, summed", unit="1/mm^2")

    def __len__(self) -> int:
        return len(self.detail)

    def first(self, count: int) -> Skin:
        """The ``count`` most telling samples."""
        return Skin(**{entry.name: getattr(self, entry.name)[:count] for entry in fields(self)})

    @classmethod
    def checked(cls, path: str | os.PathLike, data: dict[str, np.ndarray]) -> Skin:
        """Of the arrays in a file; raises :class:`FileFormatError` where they describe no samples of a surface."""
        if not 0 < len(data["detail"]) <= MOST:
            raise FileFormatError(f"{path}: 'skin_detail' must hold 1 to {MOST} samples")
        if min(data["deviations"].min(), data["detail"].min()) < 0:
            raise FileFormatError(f"{path}: 'skin_deviations' or 'skin_detail' holds negative values")
        weights = data["weights"]
        if weights.min() < -0.01 or np.abs(weights.sum(axis=1) - 1).max() > 0.01:
            raise FileFormatError(f"{path}: rows of 'skin_weights' are not barycentric (0 to 1, sum 1)")
        return cls(**data)
