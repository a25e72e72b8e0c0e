"""Register the depth and the picture of two cameras: remove the depth's lens distortion, and align the picture to it.

This is for libraries that deliver both as they were taken. Depth is interpolated between neighbours on the same surface, and
taken from the nearest pixel at edges, so that no measurement arises between foreground and background. A lens without
distortion leaves every value unchanged.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from ..geometry.camera import Camera

#: Depth that differs by more within 3 x 3 pixels does not belong to a single surface, mm.
EDGE_MM = 10.0


@dataclass(frozen=True)
class Lens:
    """Calibration of one camera with a distorting lens.

    Attributes
    ----------
    width, height : int
        Size of the image, px.
    matrix : (3, 3)
        Intrinsic matrix, px.
    distortion : (8,)
        k1, k2, p1, p2, k3, k4, k5 and k6 of the rational model, in OpenCV's order.
    """

    width: int
    height: int
    matrix: np.ndarray
    distortion: np.ndarray


class Registration:
    """Maps depth and pictures to the pinhole camera that the depth camera is without its distortion.

    Parameters
    ----------
    depth : Lens
        The depth camera.
    colour : Lens, optional
        The colour camera. It is None if there are no pictures.
    rotation : (3, 3), optional
        Rotation of points from the depth camera to the colour camera. By default, there is none.
    translation : (3,)
        Translation of the rotated points, mm.

    Attributes
    ----------
    camera : Camera
        The pinhole camera.

    Raises
    ------
    adaptiveface.errors.FileFormatError
        A calibration is impossible.
    """

    def __init__(self, depth: Lens, colour: Lens | None = None, rotation=None, translation=(0.0, 0.0, 0.0)) -> None:
        k = np.asarray(depth.matrix, float)
        self.camera = Camera(depth.width, depth.height, *map(float, (k[0, 0], k[1, 1], k[0, 2], k[1, 2])))
        self._maps = _undistortion(depth)
        self._bent = None
        if colour is not None:
            onto = np.asarray(colour.matrix, float)
            turned = onto @ (np.eye(3) if rotation is None else np.asarray(rotation, float))
            self._rays = np.moveaxis(self.camera.rays() @ turned.T, -1, 0).astype(np.float32)
            self._offset = (onto @ np.asarray(translation, float).reshape(3)).astype(np.float32)
            self._bent = _undistortion(colour)
        self._has_colour = colour is not None

    def depth(self, raw: np.ndarray) -> np.ndarray:
        """Remove the lens distortion from a depth image.

        Parameters
        ----------
        raw : (H, W) array
            Depth in mm as the camera took it. A pixel of 0 has no measurement.

        Returns
        -------
        (H, W) float32
            Depth in mm without distortion. A pixel of 0 has no measurement.
        """
        raw = np.asarray(raw, np.float32)
        if self._maps is None:
            return raw
        around = np.ones((3, 3), np.uint8)
        smooth = (cv2.dilate(raw, around) - cv2.erode(raw, around) < EDGE_MM).astype(np.uint8)
        smooth[[0, -1]] = smooth[:, [0, -1]] = 0  # there is no measurement beyond the border
        nearest, between = (cv2.remap(raw, *self._maps, how) for how in (cv2.INTER_NEAREST, cv2.INTER_LINEAR))
        return np.where(cv2.remap(smooth, *self._maps, cv2.INTER_NEAREST) > 0, between, nearest)

    def image(self, picture: np.ndarray) -> np.ndarray:
        """Remove the lens distortion from a picture (H, W, 3) that the depth camera itself took."""
        return picture if self._maps is None else cv2.remap(picture, *self._maps, cv2.INTER_LINEAR)

    def colour(self, picture: np.ndarray, depth: np.ndarray) -> np.ndarray:
        """Align a picture of the colour camera to a depth image.

        Parameters
        ----------
        picture : (h, w, 3) uint8
            The picture as the colour camera took it.
        depth : (H, W) float32
            Depth in mm, as :meth:`depth` returned it.

        Returns
        -------
        (H, W, 3) uint8
            The colour at each pixel of ``depth``. A pixel is black if it has no measurement or lies outside the picture.
        """
        if not self._has_colour:
            return np.zeros((*depth.shape, 3), np.uint8)
        measured = depth > 0
        z = np.where(measured, depth, 1.0).astype(np.float32)
        x, y, ahead = (ray * z + offset for ray, offset in zip(self._rays, self._offset, strict=True))
        measured &= ahead > 0
        ahead[~measured] = 1.0
        x, y = x / ahead, y / ahead
        x[~measured] = -1e4
        if self._bent is not None:
            x, y = (cv2.remap(m, x, y, cv2.INTER_LINEAR, borderValue=-1e4) for m in self._bent)
        return cv2.remap(picture, x, y, cv2.INTER_LINEAR)


def _undistortion(lens: Lens) -> tuple[np.ndarray, np.ndarray] | None:
    """Return the place (H, W) float32 u and v of each pinhole pixel in the lens's image, or None if no pixel moves."""
    if not np.any(lens.distortion):
        return None
    size, k = (lens.width, lens.height), np.asarray(lens.matrix, float)
    return cv2.initUndistortRectifyMap(k, np.asarray(lens.distortion, float), None, k, size, cv2.CV_32FC1)
