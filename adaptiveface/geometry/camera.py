"""Define the pinhole camera: x right, y down, z forward, in millimetres, with pixel centres at integers."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..errors import FileFormatError, abbreviated

#: Largest number of pixels of a picture. 8K video has 33 million.
MAX_PIXELS = 1 << 25

#: Assumed field of view of a camera without calibration, across its longer side, degrees. Laptops have 55 to 70.
FIELD_OF_VIEW = 60.0
#: Field of view that can be asked for, degrees.
FIELD_OF_VIEW_RANGE = (10.0, 150.0)


@dataclass(frozen=True)
class Camera:
    """A pinhole camera without distortion.

    Attributes
    ----------
    width, height : int
        Size of the picture, pixels.
    fx, fy : float
        Focal lengths, pixels.
    cx, cy : float
        Principal point, pixels; pixel centres lie at integers.

    Raises
    ------
    FileFormatError
        A value is one that no camera has: NaN, a focal length that is not positive, too many pixels.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float

    def __post_init__(self) -> None:
        if not (0 < self.width <= 16384 and 0 < self.height <= 16384 and self.width * self.height <= MAX_PIXELS):
            given = f"{abbreviated(self.width, 12)} x {abbreviated(self.height, 12)}"
            raise FileFormatError(f"image size {given} is not between 1 and 16384 pixels, {MAX_PIXELS} in all")
        values = np.array([self.fx, self.fy, self.cx, self.cy], float)
        if not np.isfinite(values).all() or self.fx <= 0 or self.fy <= 0:
            given = ", ".join(f"{value:g}" for value in values)
            raise FileFormatError(f"camera intrinsics are not usable: fx, fy, cx, cy = {given}")

    @property
    def matrix(self) -> np.ndarray:
        """(3, 3) projection matrix P of the paper's eq. (2)."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    def zoomed(self, factor: float) -> Camera:
        """The camera with ``factor`` times the focal length."""
        return replace(self, fx=self.fx * factor, fy=self.fy * factor)

    def project(self, points: np.ndarray) -> np.ndarray:
        """Points (..., 3) mm in the camera frame -> pixels (..., 2)."""
        z = points[..., 2]
        return np.stack([self.fx * points[..., 0] / z + self.cx, self.fy * points[..., 1] / z + self.cy], axis=-1)

    def back_project(self, pixels: np.ndarray, depth: np.ndarray) -> np.ndarray:
        """Pixels (..., 2) with depth (...) mm -> points (..., 3) mm in the camera frame."""
        x = (pixels[..., 0] - self.cx) / self.fx * depth
        y = (pixels[..., 1] - self.cy) / self.fy * depth
        return np.stack([x, y, depth], axis=-1)

    def rays(self) -> np.ndarray:
        """(H, W, 3) viewing rays with z = 1, so that ``rays * depth`` are points."""
        u, v = np.meshgrid(np.arange(self.width, dtype=float), np.arange(self.height, dtype=float))
        return np.stack([(u - self.cx) / self.fx, (v - self.cy) / self.fy, np.ones_like(u)], axis=-1)
