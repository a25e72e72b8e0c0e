"""Define the signs, axes and units of Live Link Face. No other module holds them.

The axes of a face are those of ARKit's face anchor: x to the subject's own left, y up, z out of the face, right-handed.
(Apple's pages on ``ARFaceAnchor``: a person who looks to the left has a ``lookAtPoint`` with positive x.) Our head frame
has the same axes. Unreal's frame is (-z, x, y) of ARKit's and is left-handed. Epic's app writes the yaw, pitch and roll of a
rotation in Unreal's frame (``FRotator`` applies roll first, then pitch, then yaw). The change of handedness reverses every
turn, and the change of axes reverses the first one again. In terms of the face,

* yaw is positive to the subject's right: minus the turn about y;
* pitch is positive downwards: the turn about x;
* roll is positive towards the subject's left shoulder: minus the turn about z;

in radians, with the rotation R = R_y(-yaw) R_x(pitch) R_z(-roll). Eyes follow the same rule, and a take of a real iPhone
confirms it for them. Their yaw is -0.607 (lookOut - lookIn) for the left eye and +0.603 (lookOut - lookIn) for the right one.
Their pitch rises with lookDown. Their roll is 0.97 to 1.0 times yaw times pitch, which is the roll, with the sign above, of an
eye that turns about y first and about x afterwards. The head's angles are zero in that take, so their signs follow from the
axes alone.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from ..geometry.expression_names import ARKIT_NAMES

#: The nine angles that follow the shapes in a row, radians.
ROTATIONS = (
    "HeadYaw",
    "HeadPitch",
    "HeadRoll",
    "LeftEyeYaw",
    "LeftEyePitch",
    "LeftEyeRoll",
    "RightEyeYaw",
    "RightEyePitch",
    "RightEyeRoll",
)
#: Turn of an eye at a full lookIn or lookOut and at a full lookUp or lookDown, rad; roll per yaw and pitch, 1/rad.
EYE_YAW, EYE_PITCH, EYE_ROLL = 0.605, 0.556, 0.97
_SIGNS = np.array([-1.0, 1.0, -1.0])


def angles(rotations: np.ndarray) -> np.ndarray:
    """Return the (..., 3) yaw, pitch and roll of rotations, rad.

    ``rotations`` (..., 3, 3) rotate the face's axes: x to the left, y up, z out of the face.
    """
    rotations = np.asarray(rotations, float)
    flat = Rotation.from_matrix(rotations.reshape(-1, 3, 3)).as_euler("YXZ")
    return (_SIGNS * flat).reshape(*rotations.shape[:-2], 3)


def rotations(yaw_pitch_roll: np.ndarray) -> np.ndarray:
    """Return the (..., 3, 3) rotations for angles (..., 3), rad. This is the inverse of :func:`angles`."""
    turns = np.asarray(yaw_pitch_roll, float)
    flat = Rotation.from_euler("YXZ", (_SIGNS * turns).reshape(-1, 3)).as_matrix()
    return flat.reshape(*turns.shape[:-1], 3, 3)


def eye_angles(curves: np.ndarray) -> np.ndarray:
    """Compute the angles of the eyes from the eyeLook curves.

    Parameters
    ----------
    curves : (F, 52) array

    Returns
    -------
    (F, 6) array
        Yaw, pitch and roll of the left eye and then of the right eye, rad.
    """
    level = dict(zip(ARKIT_NAMES, np.asarray(curves, float).T, strict=True))
    out = []
    for side, away in (("Left", -1.0), ("Right", 1.0)):
        yaw = EYE_YAW * away * (level[f"eyeLookOut{side}"] - level[f"eyeLookIn{side}"])
        pitch = EYE_PITCH * (level[f"eyeLookDown{side}"] - level[f"eyeLookUp{side}"])
        out += [yaw, pitch, EYE_ROLL * yaw * pitch]
    return np.stack(out, axis=-1)


def eyes_of_gaze(gaze: np.ndarray) -> np.ndarray:
    """Compute the angles of both eyes from the gaze.

    Parameters
    ----------
    gaze : (..., 2, 2) array
        Yaw to the subject's left and pitch upwards of each eye.

    Returns
    -------
    (..., 6) array
        Yaw, pitch and roll of both eyes, rad.
    """
    yaw, pitch = -np.moveaxis(np.asarray(gaze, float), -1, 0)
    return np.stack([yaw, pitch, EYE_ROLL * yaw * pitch], axis=-1).reshape(*yaw.shape[:-1], 6)


def with_look(curves: np.ndarray, eyes: np.ndarray) -> np.ndarray:
    """Copy curves (..., 52) and set their eyeLook shapes, in [0, 1], for the angles ``eyes`` (..., 6) of :func:`eye_angles`."""
    out = np.array(curves, float)
    for side, away, first in (("Left", -1.0, 0), ("Right", 1.0, 3)):
        outwards = away * eyes[..., first] / EYE_YAW
        downwards = eyes[..., first + 1] / EYE_PITCH
        for look, value in (("Out", outwards), ("In", -outwards), ("Down", downwards), ("Up", -downwards)):
            out[..., ARKIT_NAMES.index(f"eyeLook{look}{side}")] = np.clip(value, 0.0, 1.0)
    return out
