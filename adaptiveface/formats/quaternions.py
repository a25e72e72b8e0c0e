"""Convert between rotation matrices and quaternions x, y, z, w, as files of animations store them."""

from __future__ import annotations

import numpy as np


def quaternions(rotations: np.ndarray) -> np.ndarray:
    """(F, 4) unit quaternions of rotations (F, 3, 3). Neighbours lie in one hemisphere, so that they can be interpolated."""
    from scipy.spatial.transform import Rotation

    out = Rotation.from_matrix(rotations).as_quat()
    flips = np.cumprod(np.where((out[1:] * out[:-1]).sum(axis=1) < 0, -1.0, 1.0))
    out[1:] *= flips[:, None]
    return out


def quaternion_matrix(quaternion: np.ndarray) -> np.ndarray:
    """(3, 3) rotation of a quaternion (4,) of any length but zero."""
    x, y, z, w = quaternion
    s = 2.0 / (x * x + y * y + z * z + w * w)
    return np.array(
        [
            [1 - s * (y * y + z * z), s * (x * y - z * w), s * (x * z + y * w)],
            [s * (x * y + z * w), 1 - s * (x * x + z * z), s * (y * z - x * w)],
            [s * (x * z - y * w), s * (y * z + x * w), 1 - s * (x * x + y * y)],
        ]
    )
