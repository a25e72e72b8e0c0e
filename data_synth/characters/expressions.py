"""Expressions of a character: deformation transfer from the face model, then lids that close and lips that touch."""

from __future__ import annotations

import numpy as np
from face_model.anatomy import Anatomy, find_anatomy
from face_model.identity_space import mirrored
from face_model.lids import blink
from face_model.mouth import separate_lips
from face_model.tracking_mesh import TrackingMesh

from adaptiveface.model.blendshapes import deformation_transfer
from adaptiveface.model.face_model import FaceModel

UPPER_SHARE = {"mouthRollUpper": 1.0, "mouthRollLower": 0.0}


def transferred_units(model: FaceModel, skin: np.ndarray, eyes: dict, mesh: TrackingMesh, motion: float) -> dict:
    """Name -> displacement (V, 3) of the character's skin (V, 3); ``eyes``: Left/Right -> points of the eyeballs."""
    units = deformation_transfer(model.mean, skin, model.triangles, motion * model.expressions)
    units = dict(zip(model.expression_names, units, strict=True))
    left = find_anatomy(skin, eyes["Left"], mesh)
    # A head without symmetry is mirrored to close its right eye with the code for the left one.
    other = mirrored(skin, mesh.mirror)
    right = find_anatomy(other, eyes["Right"] * [-1.0, 1.0, 1.0], mesh)
    units["eyeBlinkLeft"] = _blink(skin, units["eyeBlinkLeft"], left)
    units["eyeBlinkRight"] = mirrored(_blink(other, mirrored(units["eyeBlinkRight"], mesh.mirror), right), mesh.mirror)
    for name, field in units.items():
        if name.startswith(("mouth", "jaw", "cheekPuff", "noseSneer")) and name != "mouthClose":
            units[name] = field + _contact(skin + field, left, UPPER_SHARE.get(name, 0.5))
    both = skin + units["jawOpen"] + units["mouthClose"]
    units["mouthClose"] = units["mouthClose"] + _contact(both, left, 0.5)
    return units


def _blink(skin: np.ndarray, unit: np.ndarray, anatomy: Anatomy) -> np.ndarray:
    return blink(skin, unit, anatomy.left_eye, anatomy.left_lid_distance, anatomy.smoother)


def _contact(points: np.ndarray, anatomy: Anatomy, share: float) -> np.ndarray:
    return separate_lips(points, anatomy.lips, anatomy.mesh.triangles, anatomy.smoother, share)
