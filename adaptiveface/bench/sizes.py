"""Make face models of other sizes, to measure how the tracker's stages grow with the mesh."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy import sparse

from ..model.actor import Actor
from ..model.face_model import FaceModel
from ..neutral.capture import build_actor
from ..synthetic.performer import Performer
from ..synthetic.subdivision import loop_subdivision
from .decimation import decimated


def actor_of_size(performer: Performer, vertices: int) -> Actor:
    """Make the performer's rig on a mesh with this number of vertices.

    The performer's surface is the model's mesh after one step of Loop subdivision. It is coarsened to some of its own
    vertices. They lie exactly on the surface that the sensor sees, so that the same frames serve every size. ValueError is
    raised for more vertices than the performer's surface has.
    """
    model, kept = model_of_size(performer.model, vertices)
    return build_actor(model, performer.surface(np.zeros(len(performer.expression_names)))[kept])


def model_of_size(model: FaceModel, vertices: int) -> tuple[FaceModel, np.ndarray]:
    """Reduce a ``model`` to some vertices of its subdivided mesh, and return it with their numbers (V,) in that mesh.

    Mean, modes and expressions are the subdivided ones at these vertices. A vertex is frontal, or takes depth, if the
    vertices that it lies between do. Features keep their place on the surface. Data that only other parts of the package need
    (the mirrored vertices, the detector's other landmarks) are left out.
    """
    matrix, triangles = loop_subdivision(model.triangles, len(model.mean))
    fine = matrix @ model.mean
    if vertices > len(fine):
        raise ValueError(f"{vertices} vertices: there are {len(fine)} on the performer's surface")
    kept, faces = decimated(fine, triangles, vertices)
    rows = matrix[kept]
    corners, weights = places(feature_points(model, matrix), fine[kept], faces)
    return (
        replace(
            model,
            name=f"{model.name} on {len(kept)} vertices",
            mean=fine[kept],
            triangles=faces,
            identity_modes=_at(rows, model.identity_modes),
            expressions=_at(rows, model.expressions),
            frontal=_between(model.frontal, rows, kept),
            depth_valid=_between(model.depth_valid, rows, kept),
            feature_triangles=corners,
            feature_weights=weights,
            mirror=None,
            landmarks=None,
        ),
        kept,
    )


def feature_points(model: FaceModel, matrix: sparse.csr_matrix) -> np.ndarray:
    """Return the (40, 3) features on the subdivided surface of the mean head, whose first vertices are the model's."""
    smooth = (matrix @ model.mean)[: len(model.mean)]
    points: np.ndarray = np.einsum("fk,fkd->fd", model.feature_weights, smooth[model.feature_triangles])
    return points


def _at(rows: sparse.csr_matrix, fields: np.ndarray) -> np.ndarray:
    """Interpolate fields (M, V, 3) of the model at the vertices of ``rows`` (W, V), and return (M, W, 3) values."""
    return np.stack([rows @ field for field in fields])


def _between(mask: np.ndarray, rows: sparse.csr_matrix, kept: np.ndarray) -> np.ndarray:
    """Return a mask (V,) at ``kept`` (W,) vertices. In the middle of an edge, it holds if it holds at both ends."""
    old = kept < len(mask)
    # An edge point has 3/8 of each end, or a half on a rim. The opposite vertices have at most 1/8.
    ends = rows.multiply(rows > 0.3).astype(bool)
    outside = ends @ (~mask).astype(float) > 0
    return np.where(old, mask[np.minimum(kept, len(mask) - 1)], ~outside)


def places(points: np.ndarray, vertices: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Find the nearest place on a mesh for each of ``points`` (n, 3): corners (n, 3) int32 and barycentric weights (n, 3)."""
    a, b, c = (vertices[triangles[:, k]] for k in range(3))
    u, v = b - a, c - a
    uu, uv, vv = (u * u).sum(axis=1), (u * v).sum(axis=1), (v * v).sum(axis=1)
    corners, weights = np.empty((len(points), 3), np.int32), np.empty((len(points), 3))
    for number, point in enumerate(points):
        d = point - a
        du, dv = (d * u).sum(axis=1), (d * v).sum(axis=1)
        share = np.stack([du * vv - dv * uv, dv * uu - du * uv], axis=1) / np.maximum(uu * vv - uv * uv, 1e-12)[:, None]
        share = np.clip(share, 0.0, 1.0)
        share /= np.maximum(share.sum(axis=1, keepdims=True), 1.0)
        nearest = np.linalg.norm(d - share[:, :1] * u - share[:, 1:] * v, axis=1).argmin()
        corners[number] = triangles[nearest]
        weights[number] = [1.0 - share[nearest].sum(), *share[nearest]]
    return corners, weights
