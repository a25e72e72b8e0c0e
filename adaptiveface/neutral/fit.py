"""Section 3, second step: rigid pose and identity coefficients that bring the statistical model onto the merged scan.

The energy is a negative log posterior (Blanz & Vetter 1999): point-to-plane distances to the scan and point-to-ray
distances to the 2D features, each over its expected deviation, plus the Gaussian prior of the coefficients. Where the detector
sees an expression, coefficients of the generic expressions are unknowns as well (:mod:`~adaptiveface.neutral.expression`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from ..errors import TrackingError
from ..geometry.mesh import rotation_vector_matrix, surface_points, transform_points, vertex_areas, vertex_normals
from ..model.face_model import FaceModel
from ..parameters import FitParameters
from .expression import ExpressionPrior
from .features import Evidence, constraints_on, neutral_evidence
from .fuse import FusedScan

DEFAULTS = FitParameters()
_MIN_CORRESPONDENCES = 300


@dataclass(frozen=True)
class IdentityFit:
    """What :func:`fit_identity` found.

    Attributes
    ----------
    identity : (M,)
        Coefficients, standard deviations.
    scan_from_head : (4, 4)
        Head frame of the model to the frame of the scan, mm.
    expression : (A,)
        Coefficients of the generic expressions that the scan shows; zeros for a neutral face.
    vertices : (V, 3)
        The fitted head as the scan shows it, in the head frame, mm: with its expression.
    residual : float
        Median point-to-plane distance to the scan, mm.
    matched : (V,) bool
        Vertices with a scan correspondence.
    feature_rms : (40,)
        Distance of each feature from its viewing rays, mm; NaN where it was not seen.
    history : (I,)
        The residual after each round, mm.
    """

    identity: np.ndarray
    expression: np.ndarray
    scan_from_head: np.ndarray
    vertices: np.ndarray
    residual: float
    matched: np.ndarray
    feature_rms: np.ndarray
    history: np.ndarray


@dataclass(frozen=True)
class ScanCorrespondences:
    """Mesh vertices, by number (n,), and their closest scan points, normals (n, 3), signed distances (n,) mm."""

    vertices: np.ndarray
    points: np.ndarray
    normals: np.ndarray
    distances: np.ndarray


class ScanSearch:
    """Closest-point queries on a merged scan, with the usual rejections."""

    def __init__(self, scan: FusedScan) -> None:
        self.scan, self.tree = scan, cKDTree(scan.points)

    def correspondences(
        self, vertices: np.ndarray, normals: np.ndarray, allowed: np.ndarray, reach: float, normal_angle: float
    ) -> ScanCorrespondences:
        """Partners of the ``allowed`` (V,) vertices (V, 3) nearer than ``reach`` mm whose normals agree."""
        numbers = np.flatnonzero(allowed)
        distance, nearest = self.tree.query(vertices[numbers], distance_upper_bound=reach)
        numbers, nearest = numbers[np.isfinite(distance)], nearest[np.isfinite(distance)]
        points, planes = self.scan.points[nearest], self.scan.normals[nearest]
        offset = vertices[numbers] - points
        along = (offset * planes).sum(axis=1)
        # A large offset inside the surface means that the scan ends here: its rim would attract everything beyond.
        sideways = np.linalg.norm(offset - along[:, None] * planes, axis=1)
        agree = (planes * normals[numbers]).sum(axis=1) > np.cos(np.radians(normal_angle))
        keep = agree & (sideways < np.maximum(4.0, 0.7 * np.abs(along)))
        return ScanCorrespondences(numbers[keep], points[keep], planes[keep], along[keep])


@dataclass(frozen=True)
class Head:
    """What a round of the fit knows: pose (4, 4) head to scan; identity (M,); expression (A,)."""

    pose: np.ndarray
    identity: np.ndarray
    expression: np.ndarray

    def shape(self, model: FaceModel, prior: ExpressionPrior | None) -> np.ndarray:
        """(V, 3) mm, head frame."""
        neutral = model.neutral(self.identity)
        return neutral if prior is None else neutral + np.tensordot(self.expression, prior.shapes, axes=1)


def fit_identity(scan: FusedScan, model: FaceModel, parameters: FitParameters = DEFAULTS) -> IdentityFit:
    """Solve for the global rigid transformation and the identity coefficients (section 3).

    Each round finds the closest points and makes one Gauss-Newton step on all unknowns. The first rounds solve for the pose
    (and the expression, if there is one), later ones for a growing number of modes.

    Parameters
    ----------
    scan : FusedScan
        The merged neutral scan.
    model : FaceModel
        Its mean and identity modes.
    parameters : FitParameters
        Weights and limits.

    Returns
    -------
    IdentityFit
        The fitted head.

    Raises
    ------
    TrackingError
        The scan and the model do not meet.
    """
    modes = min(parameters.modes, len(model.identity_modes))
    prior = _expression_prior(scan, model, parameters)
    expression = np.zeros(len(model.generic_weights)) if prior is None else prior.mean
    return fit_head(scan, model, parameters, Head(np.eye(4), np.zeros(modes), expression), few_first=True)


def fit_head(scan: FusedScan, model: FaceModel, parameters: FitParameters, start: Head, few_first: bool = False) -> IdentityFit:
    """Rounds of :func:`fit_identity` from a ``start``. ``few_first``: the pose alone at first, then more and more modes."""
    search, head = ScanSearch(scan), start
    prior = _expression_prior(scan, model, parameters)
    area = vertex_areas(model.mean, model.triangles)
    history, reach = [], parameters.max_correspondence_distance
    found = evidence = None
    for iteration in range(parameters.iterations):
        used = _modes_now(iteration, len(start.identity)) if few_first else len(start.identity)
        vertices, normals = _posed(model, head, prior)
        found = search.correspondences(vertices, normals, model.depth_valid, reach, parameters.max_normal_angle)
        if len(found.vertices) < _MIN_CORRESPONDENCES:
            raise TrackingError(
                f"the face model meets the neutral scan in {len(found.vertices)} points only: the scan does not show a "
                "face where the 2D features see one"
            )
        evidence = neutral_evidence(scan, model, vertices, head.pose[:3, :3], parameters.contour)
        history.append(float(np.median(np.abs(found.distances))))
        head = _step(model, head, prior, used, found, evidence, area, parameters)
        reach = float(np.clip(6 * 1.4826 * history[-1], 4.0, parameters.max_correspondence_distance))
    vertices, normals = _posed(model, head, prior)
    found = search.correspondences(vertices, normals, model.depth_valid, reach, parameters.max_normal_angle)
    return _fitted(scan, model, head, prior, found, vertices, np.array(history))


def _expression_prior(scan: FusedScan, model: FaceModel, parameters: FitParameters) -> ExpressionPrior | None:
    return ExpressionPrior.of(scan, model) if parameters.expression else None


def _fitted(
    scan: FusedScan,
    model: FaceModel,
    head: Head,
    prior: ExpressionPrior | None,
    found: ScanCorrespondences,
    vertices: np.ndarray,
    history: np.ndarray,
) -> IdentityFit:
    """The result, and how far its posed ``vertices`` (V, 3) lie from the scan, by the pairs ``found`` and by the features."""
    matched = np.zeros(len(vertices), bool)
    matched[found.vertices] = True
    constraints = constraints_on(scan, model, vertices)
    rms = constraints.rms(surface_points(vertices, model.feature_triangles, model.feature_weights))
    return IdentityFit(
        head.identity,
        head.expression,
        head.pose,
        head.shape(model, prior),
        float(np.median(np.abs(found.distances))),
        matched,
        np.where(constraints.seen, rms, np.nan),
        history,
    )


def _modes_now(iteration: int, modes: int) -> int:
    """Pose alone for 4 rounds, then 3 more modes every round: the strong modes settle before the fine ones."""
    return min(modes, max(0, 3 * (iteration - 3)))


def _posed(model: FaceModel, head: Head, prior: ExpressionPrior | None) -> tuple[np.ndarray, np.ndarray]:
    vertices = transform_points(head.pose, head.shape(model, prior))
    return vertices, vertex_normals(vertices, model.triangles)


def _step(
    model: FaceModel,
    head: Head,
    prior: ExpressionPrior | None,
    used: int,
    found: ScanCorrespondences,
    evidence: Evidence,
    area: np.ndarray,
    parameters: FitParameters,
) -> Head:
    """One Gauss-Newton step: the pose turns about the head's centre, ``used`` modes and the expression change."""
    identity, pose = head.identity, head.pose
    vertices = transform_points(pose, head.shape(model, prior))
    centre = vertices[found.vertices].mean(axis=0)
    # Point to plane, with Tukey's weights and the vertices' areas (their density must not decide).
    scale = max(3 * 1.4826 * np.median(np.abs(found.distances)), 1.0)
    weight = area[found.vertices] * np.clip(1 - (found.distances / (1.5 * scale)) ** 2, 0, None) ** 2
    weight *= parameters.samples / area[found.vertices].sum() / parameters.scan_sigma**2
    rigid = np.concatenate([np.cross(vertices[found.vertices] - centre, found.normals), found.normals], axis=1)
    # n . (R m) = (R^T n) . m: the normals are turned instead of the modes.
    back = found.normals @ pose[:3, :3]
    shapes = model.identity_modes[:used]
    if prior is not None:
        shapes = np.concatenate([shapes, prior.shapes])
    shape = sum(shapes[:, found.vertices, d] * back[:, d] for d in range(3)).T
    rows = np.concatenate([rigid, shape], axis=1)
    lhs, rhs = rows.T @ (rows * weight[:, None]), -rows.T @ (weight * found.distances)
    _add_features(lhs, rhs, shapes, vertices, pose[:3, :3], centre, evidence, parameters)
    diagonal = np.arange(6, 6 + used)
    lhs[diagonal, diagonal] += 1.0
    rhs[diagonal] -= identity[:used]
    lhs[np.arange(6), np.arange(6)] += 1e-9 * np.trace(lhs[:6, :6])
    if prior is None:
        solution, expression = np.linalg.solve(lhs, rhs), head.expression
    else:
        solution, expression = prior.solve(lhs, rhs, head.expression)
    step = np.eye(4)
    step[:3, :3] = rotation_vector_matrix(solution[:3])
    step[:3, 3] = centre + solution[3:6] - step[:3, :3] @ centre
    identity = identity.copy()
    identity[:used] += solution[6:]
    return Head(step @ pose, identity, expression)


def _add_features(
    lhs: np.ndarray,
    rhs: np.ndarray,
    shapes: np.ndarray,
    vertices: np.ndarray,
    rotation: np.ndarray,
    centre: np.ndarray,
    evidence: Evidence,
    parameters: FitParameters,
) -> None:
    """Point-to-ray rows of the 2D features, added to the normal equations in place."""
    triangles, weights, constraints = evidence
    points = surface_points(vertices, triangles, weights)
    modes = shapes[:, triangles] @ rotation.T
    shape = np.einsum("fk,mfkj->fjm", weights, modes)
    x, y, z = (points - centre).T
    zero = np.zeros_like(x)
    spin = np.stack([np.stack(r, axis=1) for r in ([zero, z, -y], [-z, zero, x], [y, -x, zero])], axis=1)
    jacobian = np.concatenate([spin, np.broadcast_to(np.eye(3), spin.shape), shape], axis=2)
    offset = np.einsum("fij,fj->fi", constraints.A, points) - constraints.b
    weight = constraints.strength / parameters.feature_sigma**2
    lhs += np.einsum("f,fim,fij,fjn->mn", weight, jacobian, constraints.A, jacobian, optimize=True)
    rhs -= np.einsum("f,fim,fi->m", weight, jacobian, offset)
