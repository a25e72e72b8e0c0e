"""Find the regions of the face for which errors are reported, from the 2D features, so that every model has them."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from ..geometry.frame import FEATURE_IDS, FEATURE_REGIONS
from ..geometry.mesh import surface_points
from ..model.actor import Actor
from ..model.face_model import FaceModel

#: Order of the regions in tables. A vertex belongs to one region at most.
REGIONS = ("lips", "eyes", "brows", "cheeks", "chin")

#: A vertex within this distance of a feature of a region belongs to it, mm.
FEATURE_RADIUS = 8.0
#: Half width of the cheek around the middle between outer eye corner and mouth corner, mm.
CHEEK_RADIUS = 25.0


def region_masks(
    neutral: np.ndarray, feature_triangles: np.ndarray, feature_weights: np.ndarray, frontal: np.ndarray
) -> dict[str, np.ndarray]:
    """Find the regions of a neutral mesh.

    The vertices of lips, eyes and brows lie within 8 mm (in a straight line) of one of their features. The nearest feature
    decides between these regions. The cheeks lie within 25 mm of the middle between the outer eye corner (iBUG 36, 45) and the
    mouth corner (48, 54) of the same side. The chin lies below the lowest lip feature, and between the mouth corners or at most
    half the width of the mouth beside them.

    Parameters
    ----------
    neutral : (N, 3)
        Vertices, mm.
    feature_triangles, feature_weights : (40, 3)
        Places of the features on the mesh: corners of a triangle, and barycentric weights.
    frontal : (N,) bool
        The frontal region.

    Returns
    -------
    dict
        Disjoint subsets (N,) bool of ``frontal`` by the names of ``REGIONS``.
    """
    features = surface_points(neutral, feature_triangles, feature_weights)
    distance, nearest = cKDTree(features).query(neutral)
    close = frontal & (distance < FEATURE_RADIUS)
    masks = {name: close & (FEATURE_REGIONS[nearest] == name) for name in ("lips", "eyes", "brows")}
    free = frontal & ~close

    def feature(number: int) -> np.ndarray:
        return features[np.flatnonzero(FEATURE_IDS == number)[0]]

    cheeks = np.zeros(len(neutral), bool)
    for eye_corner, mouth_corner in ((36, 48), (45, 54)):
        middle = (feature(eye_corner) + feature(mouth_corner)) / 2
        middle = neutral[frontal][np.linalg.norm((neutral[frontal] - middle)[:, :2], axis=1).argmin()]
        cheeks |= np.linalg.norm(neutral - middle, axis=1) < CHEEK_RADIUS
    masks["cheeks"] = free & cheeks
    right, left = feature(48), feature(54)
    side = np.abs(neutral[:, 0] - (right[0] + left[0]) / 2) < np.abs(left[0] - right[0])
    below = neutral[:, 1] < features[FEATURE_REGIONS == "lips"][:, 1].min()
    masks["chin"] = free & ~cheeks & side & below
    return masks


def actor_regions(actor: Actor | FaceModel) -> dict[str, np.ndarray]:
    """Return the regions of a head.

    Parameters
    ----------
    actor : Actor or FaceModel
        The head. Of a face model, it is the mean head.

    Returns
    -------
    dict
        As :func:`region_masks` returns it.
    """
    neutral = actor.mean if isinstance(actor, FaceModel) else actor.neutral
    return region_masks(neutral, actor.feature_triangles, actor.feature_weights, actor.frontal)
