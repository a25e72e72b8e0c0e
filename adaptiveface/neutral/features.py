"""Turn the 2D features of the neutral frames into constraints on the head, and calibrate them for one person.

A feature at a pixel of frame k lies on a viewing ray. The mean of its squared distances to the rays of all frames is a
quadratic form x.A x - 2 b.x + c of its 3D position x, so that all frames together need one (3, 3) matrix. These are the
point-to-point 2D feature constraints of section 3.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..geometry.frame import Features2D
from ..geometry.mesh import surface_points, vertex_normals
from ..model.face_model import FaceModel
from ..model.feature_set import FeatureSet
from .fuse import FusedScan


@dataclass(frozen=True)
class FeatureConstraints:
    """Mean squared distances of the features to their viewing rays: x.A x - 2 b.x + c in the scan frame, mm^2.

    Attributes
    ----------
    A, b, c : (40, 3, 3), (40, 3), (40,)
        Coefficients of the quadratic forms.
    weights : (40,)
        Sums of the confidences over the frames; 0 for a feature that was never seen.
    trust : float
        Highest confidence of any feature, in [0, 1], as the source of the features gives it.
    certainty : (40,) or None
        The trust of each feature, if it is known.
    """

    A: np.ndarray
    b: np.ndarray
    c: np.ndarray
    weights: np.ndarray
    trust: float = 1.0
    certainty: np.ndarray | None = None

    @property
    def strength(self) -> np.ndarray:
        """Weights (40,) of the constraints: the certainty or the squared trust; 0 for features that were never seen.

        A detector makes the same error in all neutral frames, so that many frames are no better than one, and the error goes
        into the mesh. The trust is squared because this was better than the trust itself (``docs/paper-notes.md``).
        """
        return self.seen * (self.trust**2 if self.certainty is None else self.certainty)

    @property
    def seen(self) -> np.ndarray:
        """Which features have a constraint, (40,) bool."""
        return self.weights > 0

    def joined(self, other: FeatureConstraints) -> FeatureConstraints:
        """Return these constraints followed by those of ``other``."""
        pairs = ((getattr(self, name), getattr(other, name)) for name in ("A", "b", "c", "weights", "strength"))
        A, b, c, weights, certainty = (np.concatenate(pair) for pair in pairs)
        return FeatureConstraints(A, b, c, weights, self.trust, certainty)

    def rms(self, points: np.ndarray) -> np.ndarray:
        """Root mean square distances (40,) of points (40, 3) in the scan frame from their rays, mm."""
        square = np.einsum("fi,fij,fj->f", points, self.A, points) - 2 * (self.b * points).sum(1) + self.c
        distances: np.ndarray = np.sqrt(np.maximum(square, 0.0))
        return distances


def feature_constraints(scan: FusedScan, points: np.ndarray, normals: np.ndarray) -> FeatureConstraints:
    """Gather the rays of the scan's frames from the features' current positions and normals (40, 3) in the scan frame.

    The weight of a view depends on how far the feature's skin is turned to it, because detectors guess what is turned away. The
    direction is the mean of the skin's normal and the face's direction, +z, because the normals of inner lips face no camera.
    Rays that are farther than three robust standard deviations from their median are dropped.
    """
    facing = normals + [0.0, 0.0, 1.0]
    facing /= np.maximum(np.linalg.norm(facing, axis=1, keepdims=True), 1e-9)
    seen = ((k, features) for k, features in enumerate(scan.features) if features is not None)
    rows = [_rays(scan, k, features, points, facing) for k, features in seen]
    if not rows:
        zero = np.zeros(len(points))
        return FeatureConstraints(np.zeros((len(points), 3, 3)), np.zeros_like(points), zero, zero)
    centre, direction, weight = (np.stack(part) for part in zip(*rows, strict=True))
    across = np.eye(3) - direction[..., :, None] * direction[..., None, :]
    weight = _without_outliers(points, centre, across, weight)
    total = weight.sum(axis=0)
    weight = weight / np.where(total > 0, total, 1.0)
    A = np.einsum("kf,kfij->fij", weight, across)
    b = np.einsum("kf,kfij,kfj->fi", weight, across, centre)
    c = np.einsum("kf,kfi,kfij,kfj->f", weight, centre, across, centre)
    trust = max(float(features.confidence.max()) for features in scan.features if features is not None)
    return FeatureConstraints(A, b, c, total, trust)


def _rays(
    scan: FusedScan, k: int, features: Features2D, points: np.ndarray, facing: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Origins (40, 3) and unit directions (40, 3) of frame k's rays in the scan frame, mm, and their weights (40,)."""
    rotation, translation = scan.poses[k][:3, :3], scan.poses[k][:3, 3]
    pixels = np.where(features.valid[:, None], features.pixels, 0.0)
    direction = scan.cameras[k].back_project(pixels, np.ones(len(pixels))) @ rotation
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    centre = np.broadcast_to(-translation @ rotation, points.shape)
    cosine = -(direction * facing).sum(axis=1)
    weight = np.where(features.valid, features.confidence, 0.0) * np.clip(cosine - 0.2, 0.0, None)
    return centre, direction, weight


def _without_outliers(points: np.ndarray, centre: np.ndarray, across: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Set the weights (K, 40) of rays to zero that lie far from those of most frames."""
    offset = np.einsum("kfij,kfj->kfi", across, points - centre)
    offset = np.where(weight[..., None] > 0, offset, np.nan)
    with np.errstate(all="ignore"):
        seen = (weight > 0).any(axis=0)
        middle = np.zeros_like(points)
        middle[seen] = np.nanmedian(offset[:, seen], axis=0)
        distance = np.linalg.norm(offset - middle, axis=2)
        spread = np.full(len(points), np.inf)
        spread[seen] = np.maximum(3 * 1.4826 * np.nanmedian(distance[:, seen], axis=0), 1.0)
    return np.where(distance <= spread, weight, 0.0)


def constraints_on(scan: FusedScan, model: FaceModel, vertices: np.ndarray) -> FeatureConstraints:
    """Make :func:`feature_constraints` for a head of the model at ``vertices`` (V, 3) in the scan frame, mm."""
    normals = vertex_normals(vertices, model.triangles)
    places = model.feature_triangles, model.feature_weights
    return feature_constraints(scan, surface_points(vertices, *places), surface_points(normals, *places))


def calibrated_features(
    constraints: FeatureConstraints, model: FaceModel, vertices: np.ndarray, limit: float
) -> tuple[np.ndarray, np.ndarray]:
    """Move each feature on the surface to the place of this person's detections.

    A detector's features differ a little from those of the model. The difference varies between faces, but is constant on one
    face. If it is removed in the neutral, it does not pull at the expressions.

    Parameters
    ----------
    constraints : FeatureConstraints
        From the frames of the scan.
    model : FaceModel
        Has the mesh and the features.
    vertices : (V, 3)
        The head in the frame of the constraints, mm.
    limit : float
        Largest shift of a feature, mm.

    Returns
    -------
    triangles, weights : (40, 3) int, (40, 3)
        New places of the features. Features that were never seen are unchanged.
    """
    triangles, feature_triangles = model.triangles, model.feature_triangles
    triangles_out, weights_out = feature_triangles.copy(), np.array(model.feature_weights, float)
    if limit == 0:
        return triangles_out, weights_out
    home = surface_points(vertices, feature_triangles, model.feature_weights)
    samples = _barycentric_grid(8)
    for f in np.flatnonzero(constraints.seen):
        near = surface_patch(triangles, vertices, feature_triangles[f], home[f], limit)
        points = np.einsum("sk,tkd->tsd", samples, vertices[near])
        away = ((points - home[f]) ** 2).sum(axis=2)
        energy = np.einsum("tsi,ij,tsj->ts", points, constraints.A[f], points) - 2 * points @ constraints.b[f]
        # A slight pull to the old place decides along the viewing ray, about which the detections say nothing.
        energy = np.where(away <= limit**2, energy + 0.01 * away, np.inf)
        t, s = np.unravel_index(np.argmin(energy), energy.shape)
        if np.isfinite(energy[t, s]):
            triangles_out[f], weights_out[f] = near[t], samples[s]
    return triangles_out, weights_out


#: Largest number of independent frames that a neutral scan counts as for the place of a landmark.
INDEPENDENT = 40.0
#: Differences of landmarks between people are larger along the view than across it by this factor.
ALONG = 1.0


def calibrated_landmarks(scan: FusedScan, model: FaceModel, vertices: np.ndarray) -> FeatureSet | None:
    """Give the model's landmarks the offsets of this person's detections in the frames of the scan.

    Landmarks that no fit uses keep their common offsets, so that they still measure the fit. Nothing changes if no detector has
    seen the frames. The result is None for a model without landmarks. ``vertices`` (V, 3) are in the scan frame, which is that
    of the head, mm.
    """
    landmarks = model.landmarks
    if landmarks is None or not _detected(scan):
        return landmarks
    points = landmarks.points(vertices)
    seen = _turned_back(scan, _landmarks_seen(scan, landmarks), landmarks, points)
    constraints = _landmark_constraints(scan, seen, landmarks, model, vertices)
    count = min(float(sum(features is not None for features in seen)), INDEPENDENT)
    prior = 1.0 / (landmarks.personal[:, None] * [1.0, 1.0, ALONG]) ** 2
    evidence = count * constraints.seen / landmarks.deviations(0.0) ** 2
    h = evidence[:, None, None] * constraints.A + prior[:, :, None] * np.eye(3)
    g = evidence[:, None] * constraints.b + prior * (points + landmarks.offset)
    offset = np.linalg.solve(h, g[..., None])[..., 0] - points
    return replace(landmarks, offset=np.where(landmarks.held_out[:, None], landmarks.offset, offset))


#: Regions in which the 40 features have no point and a depth camera sees little. The forehead is left out, because hair may
#: hide it.
CONTOUR = ("chin", "jaw", "cheeks")
#: A landmark only counts if its distance exceeds this many of its deviations, and only by the excess. A smaller distance may be
#: due to the detector, and the scan is more accurate.
TOLERATED = 1.6

#: Triangles (F, 3) and weights (F, 3) of the features on the mesh, and their constraints.
Evidence = tuple[np.ndarray, np.ndarray, FeatureConstraints]


def neutral_evidence(
    scan: FusedScan,
    model: FaceModel,
    vertices: np.ndarray,
    rotation: np.ndarray,
    contour: bool,
    tolerated: float = TOLERATED,
) -> Evidence:
    """Gather what pictures show of a head at ``vertices`` (V, 3) in the scan frame, turned by ``rotation`` (3, 3).

    The 40 features have no point on chin, jaw and cheeks, and a depth camera measures little of skin that is turned away, so
    that real heads got the jaw of the average person. ``contour`` adds the detector's landmarks in these regions, if a detector
    has seen the frames and the model has landmarks. They only count beyond ``tolerated`` deviations.
    ``rotation`` turns the head frame into the scan frame.
    """
    features = constraints_on(scan, model, vertices)
    own = model.feature_triangles, model.feature_weights, features
    if not contour or model.landmarks is None or not _detected(scan) or not features.seen.any():
        return own
    landmarks = model.landmarks.select(~model.landmarks.held_out & np.isin(model.landmarks.regions, CONTOUR))
    if not len(landmarks):
        return own
    found = _landmark_constraints(scan, _landmarks_seen(scan, landmarks), landmarks, model, vertices)
    offset = landmarks.offset @ rotation.T
    # The detector sees x + o, and (x + o).A (x + o) - 2 b.(x + o) equals x.A x - 2 (b - A o).x up to a constant.
    found = replace(found, b=found.b - np.einsum("fij,fj->fi", found.A, offset))
    deviation = np.sqrt(landmarks.personal**2 + landmarks.deviations(0.0) ** 2)
    # An offset that the 40 features share comes from colour that is not aligned to the depth, not from the head's shape.
    common = np.median(_off(features, surface_points(vertices, *own[:2]))[features.seen], axis=0)
    found = replace(found, b=found.b + common)
    off = np.linalg.norm(_off(found, landmarks.points(vertices)), axis=1)
    beyond = np.clip(1.0 - tolerated * deviation / np.maximum(off, 1e-9), 0.0, None)
    found = replace(found, certainty=beyond / deviation**2)
    triangles = np.concatenate([model.feature_triangles, landmarks.triangles])
    return triangles, np.concatenate([model.feature_weights, landmarks.weights]), features.joined(found)


def _off(constraints: FeatureConstraints, points: np.ndarray) -> np.ndarray:
    """Vectors (F, 3) across the view from the seen places of points (F, 3) to the points, mm."""
    offsets: np.ndarray = np.einsum("fij,fj->fi", constraints.A, points) - constraints.b
    return offsets


def _detected(scan: FusedScan) -> bool:
    return any(features is not None and features.face is not None for features in scan.features)


def _landmarks_seen(scan: FusedScan, landmarks: FeatureSet) -> list[Features2D | None]:
    """The landmarks in every frame of the scan, with their inverse variances as confidences."""
    seen: list[Features2D | None] = []
    for features, pose in zip(scan.features, scan.poses, strict=True):
        pixels = None if features is None else landmarks.pixels(features)
        seen.append(None if pixels is None else Features2D(pixels, landmarks.trust(pose)))
    return seen


def _turned_back(
    scan: FusedScan, seen: list[Features2D | None], landmarks: FeatureSet, points: np.ndarray
) -> list[Features2D | None]:
    """Correct the landmarks for the detector's common error of turn; ``points`` (L, 3) are in the head frame, mm."""
    excess = replace(landmarks, offset=np.zeros_like(landmarks.offset))
    return [
        None if features is None else replace(features, pixels=features.pixels - excess.slides(pose, camera, points))
        for features, pose, camera in zip(seen, scan.poses, scan.cameras, strict=True)
    ]


def _landmark_constraints(
    scan: FusedScan, seen: list[Features2D | None], landmarks: FeatureSet, model: FaceModel, vertices: np.ndarray
) -> FeatureConstraints:
    placed = replace(model, feature_triangles=landmarks.triangles, feature_weights=landmarks.weights)
    return constraints_on(replace(scan, features=tuple(seen)), placed, vertices)


def surface_patch(triangles: np.ndarray, vertices: np.ndarray, start: np.ndarray, home: np.ndarray, limit: float) -> np.ndarray:
    """Triangles (t, 3) that are connected to the ``start`` triangle within ``limit`` mm, so that none is on the other lip."""
    close = ((vertices - home) ** 2).sum(axis=1) <= limit**2
    reached = np.zeros(len(vertices), bool)
    reached[start] = True
    local = triangles[close[triangles].any(axis=1)]
    while True:
        touched = reached[local].any(axis=1)
        grown = np.zeros_like(reached)
        grown[local[touched]] = True
        grown = (grown & close) | reached
        if (grown == reached).all():
            return local[touched] if touched.any() else start[None]
        reached = grown


def _barycentric_grid(steps: int) -> np.ndarray:
    """Evenly spread barycentric weights (n, 3) in a triangle, including its corners."""
    i, j = np.meshgrid(np.arange(steps + 1), np.arange(steps + 1), indexing="ij")
    inside = i + j <= steps
    return np.stack([i[inside], j[inside], steps - i[inside] - j[inside]], axis=1) / steps
