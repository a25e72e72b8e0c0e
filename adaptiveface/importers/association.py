"""Find features, the frontal region and the depth mask of a foreign mesh by fitting our own model to its mean head.

The foreign mean is treated like a neutral scan: our model's pose and identity are fitted to it, and the result is
shrink-wrapped onto it (paper, section 3). The features and masks of our mesh are then transferred to the closest points.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import trimesh
from scipy.spatial import cKDTree

from ..errors import TrackingError
from ..geometry.mesh import boundary_edges, surface_points, transform_points, triangle_normals, vertex_normals
from ..model.face_model import FaceModel, embedded_face_model
from ..neutral.fit import fit_identity
from ..neutral.fuse import FusedScan
from ..neutral.shrink_wrap import shrink_wrap
from ..parameters import FitParameters, ShrinkWrapParameters

SAMPLES = 60_000
NORMAL_MM = 6.0  # a difference of 1 between normals counts as this distance, which keeps upper and lower lip apart
FRONTAL_REACH_MM = 25.0  # vertices farther from the fitted face do not belong to it
DEPTH_REACH_MM = 4.0
MIN_MATCHED, MAX_RESIDUAL_MM = 0.5, 1.5
_FIT = FitParameters(max_correspondence_distance=30.0, iterations=30)
_WRAP = ShrinkWrapParameters()


@dataclass(frozen=True)
class Association:
    """What was found out about a foreign mesh of V vertices.

    Attributes
    ----------
    feature_triangles, feature_weights : (40, 3)
        The triangle on which each feature lies, and its barycentric weights there.
    frontal, depth_valid : (V,) bool
        The masks of :class:`FaceModel`.
    offset : (3,)
        Translation that moves the face to its place in our own model, mm.
    residual : float
        Median distance between the fitted face and the foreign one, mm.
    """

    feature_triangles: np.ndarray
    feature_weights: np.ndarray
    frontal: np.ndarray
    depth_valid: np.ndarray
    offset: np.ndarray
    residual: float


def associate(vertices: np.ndarray, triangles: np.ndarray, features: np.ndarray | None = None) -> Association:
    """Fit our own model to a mean head.

    Parameters
    ----------
    vertices : (V, 3)
        In mm, with y up and the face towards +z.
    triangles : (T, 3)
        Vertex numbers.
    features : (40,), optional
        Vertex numbers of the features, if they are known.

    Raises
    ------
    TrackingError
        The mesh does not look like a face in millimetres.
    """
    model = embedded_face_model()
    start = _nose_tip(model.mean) - _nose_tip(vertices)
    scan = _as_scan(vertices + start, triangles)
    fit = fit_identity(scan, model, _FIT)
    wrap = shrink_wrap(scan, model, transform_points(fit.scan_from_head, fit.vertices), _WRAP)
    if wrap.matched[model.depth_valid].mean() < MIN_MATCHED or wrap.residual > MAX_RESIDUAL_MM:
        raise TrackingError(
            f"only {wrap.matched[model.depth_valid].mean():.0%} of our own face matches it, {wrap.residual:.1f} mm apart"
        )
    fitted = wrap.vertices - start
    if features is None:
        feature_triangles, feature_weights = transfer_features(model, fitted, vertices, triangles)
    else:
        feature_triangles, feature_weights = features_at(features, triangles)
    frontal, depth_valid = transfer_masks(model, fitted, vertices, triangles)
    offset = model.mean[model.frontal].mean(axis=0) - fitted[model.frontal].mean(axis=0)
    offset[0] = 0.0  # a foreign head's plane of symmetry does not move
    return Association(feature_triangles, feature_weights, frontal, depth_valid, offset, wrap.residual)


def _nose_tip(vertices: np.ndarray) -> np.ndarray:
    return vertices[vertices[:, 2].argmax()]


def _as_scan(vertices: np.ndarray, triangles: np.ndarray) -> FusedScan:
    """Sample the surface densely, because closest points must not depend on the spacing of the foreign mesh's vertices."""
    mesh = trimesh.Trimesh(vertices, triangles, process=False)
    points, face = trimesh.sample.sample_surface(mesh, SAMPLES, seed=0)
    normals = surface_points(vertex_normals(vertices, triangles), triangles[face], _weights(mesh, points, face))
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    return FusedScan(
        np.asarray(points), normals, np.ones(len(points)), np.empty(0, int), np.empty((0, 4, 4)), np.empty(0), (), ()
    )


def _weights(mesh, points: np.ndarray, face: np.ndarray) -> np.ndarray:
    return trimesh.triangles.points_to_barycentric(mesh.triangles[face], points)


def transfer_features(model: FaceModel, fitted, vertices, triangles) -> tuple[np.ndarray, np.ndarray]:
    """Triangles (40, 3) and weights (40, 3) of the points on the foreign mesh that are closest to our ``fitted`` features."""
    points = surface_points(fitted, model.feature_triangles, model.feature_weights)
    directions = _unit(surface_points(vertex_normals(fitted, model.triangles), model.feature_triangles, model.feature_weights))
    corners, normals = vertices[triangles], _unit(triangle_normals(vertices, triangles))
    found, weights = np.empty((len(points), 3), np.int32), np.empty((len(points), 3))
    for f, (point, direction) in enumerate(zip(points, directions, strict=True)):
        near = np.flatnonzero(np.abs(corners - point).min(axis=1).max(axis=1) < 30.0)
        closest = trimesh.triangles.closest_point(corners[near], np.broadcast_to(point, (len(near), 3)))
        cost = ((closest - point) ** 2).sum(axis=1) + NORMAL_MM**2 * ((normals[near] - direction) ** 2).sum(axis=1)
        best = int(cost.argmin())
        found[f] = triangles[near[best]]
        w = trimesh.triangles.points_to_barycentric(corners[near[best]][None], closest[best][None])[0]
        weights[f] = np.clip(w, 0, 1) / np.clip(w, 0, 1).sum()
    return found, weights


def features_at(vertices: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Triangles (40, 3) and weights (40, 3) of features at vertices (40,)."""
    order = np.argsort(triangles.ravel(), kind="stable")
    first = order[np.searchsorted(triangles.ravel()[order], vertices)]
    found = triangles[first // 3]
    return found.astype(np.int32), (found == np.asarray(vertices)[:, None]).astype(float)


def transfer_masks(model: FaceModel, fitted, vertices, triangles) -> tuple[np.ndarray, np.ndarray]:
    """The masks frontal (V,) and depth_valid (V,) of the foreign mesh, from the nearest vertices of our ``fitted`` mesh."""
    normals = vertex_normals(vertices, triangles)
    own = np.hstack([fitted, NORMAL_MM * vertex_normals(fitted, model.triangles)])
    distance, nearest = cKDTree(own).query(np.hstack([vertices, NORMAL_MM * normals]))
    frontal = model.frontal[nearest] & (distance < FRONTAL_REACH_MM)
    valid = frontal & model.depth_valid[nearest] & (distance < DEPTH_REACH_MM + NORMAL_MM)
    away = np.linalg.norm(vertices - fitted[nearest], axis=1)
    valid &= away < DEPTH_REACH_MM + 0.5 * _spacing(fitted, model)
    valid[np.unique(boundary_edges(triangles))] = False
    return frontal, valid


def _spacing(fitted: np.ndarray, model: FaceModel) -> float:
    triangles = model.triangles[model.frontal[model.triangles].all(axis=1)]
    return float(np.median(np.linalg.norm(fitted[triangles[:, 0]] - fitted[triangles[:, 1]], axis=1)))


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-12)
