"""Solve identity, poses and expressions of many frames together, from a detector's landmarks alone (bundle adjustment).

The picture of a face depends on the person, on the head's pose and on the expression. One frame cannot separate these, but
many frames can. Identity coefficients and a constant offset of every landmark belong to the person. Each frame has a pose and
expression coefficients. All unknowns have Gaussian priors of measured size: identity by its modes, offsets by the differences
between people, and expressions by the detector's scores, which are only their start. Pictures do not show the size of the head,
so that the distance between the eyes is held at the average.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..geometry.camera import Camera
from ..geometry.mesh import surface_points, transform_points
from ..model.face_model import FaceModel
from ..model.feature_set import FeatureSet, opening_of
from ..registration.step import apply_rigid_update
from ..tracking.bounded import bounded_least_squares
from ..tracking.feature_rows import turns
from .features import ALONG

#: Gauss-Newton rounds.
ROUNDS = 10
#: Weight of landmarks relative to independent ones, because neighbouring landmarks have similar errors.
SHARE = 0.3
#: The same for the offsets, whose neighbours are also similar, so that common offsets are not forced into the identity.
OFFSET_SHARE = 1.0
#: Standard deviation of an expression coefficient from the value of the detector's scores, and of the eyes' distance from
#: that of the average head, mm.
EXPRESSION_SIGMA, EYES_SIGMA = 0.25, 0.5
#: A residual of this many deviations counts half.
OUTLIER = 3.0
#: Positions of the corners of both eyes (iBUG-68 numbers 36, 39, 42, 45) among the 40 features.
EYE_CORNERS = (8, 11, 14, 17)


@dataclass(frozen=True)
class View:
    """One frame of the bundle.

    Attributes
    ----------
    pixels : (L, 2)
        Of its landmarks; NaN for landmarks that are not seen.
    camera : Camera
        Of the frame.
    prior : (A,)
        Of the expression coefficients.
    distance : float
        Approximate distance of the head, mm.
    """

    pixels: np.ndarray
    camera: Camera
    prior: np.ndarray
    distance: float


@dataclass(frozen=True)
class Bundle:
    """The solution.

    Attributes
    ----------
    identity : (M,)
        Identity coefficients.
    offsets : (L, 3)
        Of the landmarks, head frame, mm.
    poses : (K, 4, 4)
        Head frame to camera frame, mm.
    coefficients : (K, A)
        Of the expressions.
    """

    identity: np.ndarray
    offsets: np.ndarray
    poses: np.ndarray
    coefficients: np.ndarray


#: See :func:`_frame_equations`.
FrameEquations = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]


class BundleProblem:
    """The energy of :func:`solve_bundle` and its linearisation, frame by frame."""

    def __init__(self, model: FaceModel, landmarks: FeatureSet, modes: int) -> None:
        self.landmarks, self.names = landmarks, model.generic_names
        at = landmarks.triangles, landmarks.weights
        modes = min(modes, len(model.identity_modes))
        self.mean = surface_points(model.mean, *at)
        self.modes = np.stack([surface_points(mode, *at) for mode in model.identity_modes[:modes]], axis=2)
        self.expressions = np.stack([surface_points(unit, *at) for unit in model.generic_expressions], axis=2)
        corners = model.feature_triangles[list(EYE_CORNERS)], model.feature_weights[list(EYE_CORNERS)]
        apart = [surface_points(mode, *corners) for mode in model.identity_modes[:modes]]
        between = np.array([-0.5, -0.5, 0.5, 0.5])
        self.eyes = np.array(
            [between @ points[:, 0] for points in apart]
        )  # change of the distance between the eyes per mode, mm

    def points(self, identity: np.ndarray, offsets: np.ndarray, x: np.ndarray) -> np.ndarray:
        """Landmarks (L, 3) in the head frame, mm."""
        places: np.ndarray = self.mean + self.modes @ identity + offsets + self.expressions @ x
        return places

    def linearise(
        self, view: View, pose: np.ndarray, identity: np.ndarray, offsets: np.ndarray, x: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Linearise one frame at ``pose``.

        Returns the rows (R, 6 + A) in its own unknowns, (R, M) in the identity and (R / 2, 2, 3) in the offsets, their values
        (R / 2, 2), the visible landmarks, and the centre of the pose's rotation. The rows are in standard deviations. The
        values are those at zero identity, offset and expression.
        """
        points = self.points(identity, offsets, x)
        pixels = view.pixels - self.landmarks.slides(pose, view.camera, points, opening_of(self.names, x))
        seen = np.flatnonzero(np.isfinite(pixels).all(axis=1))
        moved = transform_points(pose, points[seen])
        centre = moved.mean(axis=0)
        ray = (pixels[seen] - [view.camera.cx, view.camera.cy]) / [view.camera.fx, view.camera.fy]
        # The error in the picture is multiplied by a constant distance. With the head's own distance, a smaller head has
        # smaller errors in millimetres, and shrinks.
        shown = moved[:, :2] / moved[:, 2:]
        error = (shown - ray) * view.distance
        weight = SHARE * self.landmarks.trust(pose)[seen]
        weight = weight / (1.0 + (error**2).sum(axis=1) * weight / (2.0 * SHARE * OUTLIER**2))
        across = np.zeros((len(seen), 2, 3))
        across[:, 0, 0] = across[:, 1, 1] = 1.0
        across[:, :, 2] = -shown
        across *= (np.sqrt(weight) * view.distance / moved[:, 2])[:, None, None]
        in_head = across @ pose[:3, :3]
        own = np.concatenate([turns(moved - centre, across), across, in_head @ self.expressions[seen]], axis=2)
        bent = points[seen] - self.mean[seen]  # derivatives by identity, offset and expression
        value = np.sqrt(weight)[:, None] * error - (in_head @ bent[..., None])[..., 0]
        flat = 2 * len(seen), -1
        return own.reshape(flat), (in_head @ self.modes[seen]).reshape(flat), in_head, value, seen, centre


def solve_bundle(model: FaceModel, landmarks: FeatureSet, views: list[View], poses: np.ndarray, modes: int) -> Bundle:
    """Minimise the sum of squared landmark residuals and priors over K ``views``, starting from ``poses`` (K, 4, 4).

    This is Gauss-Newton, in which each frame's pose and expression are eliminated (Schur complement). Coefficients at their
    bounds of 0 and 1 are not eliminated, and stay there for a round.
    """
    problem = BundleProblem(model, landmarks, modes)
    count, m = len(landmarks), problem.modes.shape[2]
    identity, offsets = np.zeros(m), np.zeros((count, 3))
    x = np.array([view.prior for view in views])
    poses = np.array(poses)
    for _ in range(ROUNDS):
        h, g = _priors(problem, landmarks)
        parts = []
        for view, pose, coefficients in zip(views, poses, x, strict=True):
            part = _frame_equations(problem, view, pose, identity, offsets, coefficients)
            parts.append(part)
            _add_eliminated(h, g, part, coefficients)
        shared = np.linalg.solve(h, g)
        identity, offsets = shared[:m], shared[m:].reshape(count, 3)
        for k, part in enumerate(parts):
            poses[k], x[k] = _own_update(part, shared, poses[k], x[k])
    return Bundle(identity, offsets, poses, x)


def _priors(problem: BundleProblem, landmarks: FeatureSet) -> tuple[np.ndarray, np.ndarray]:
    """Normal equations of the shared unknowns before any frame is added: identity (M), offsets (3 L)."""
    m, count = len(problem.eyes), len(landmarks)
    h = np.zeros((m + 3 * count, m + 3 * count))
    h[:m, :m] = np.eye(m) + np.outer(problem.eyes, problem.eyes) / EYES_SIGMA**2
    apart = (landmarks.personal[:, None] * [1.0, 1.0, ALONG]).ravel()
    diagonal = np.arange(m, len(h))
    h[diagonal, diagonal] = OFFSET_SHARE / apart**2
    return h, np.zeros(len(h))


def _frame_equations(
    problem: BundleProblem, view: View, pose: np.ndarray, identity: np.ndarray, offsets: np.ndarray, x: np.ndarray
) -> FrameEquations:
    """Blocks of one frame's normal equations (own, own by shared, shared), both right-hand sides, and the turn's centre."""
    own, by_identity, by_offset, value, seen, centre = problem.linearise(view, pose, identity, offsets, x)
    m, count = by_identity.shape[1], len(problem.mean)
    shared = np.zeros((len(own), m + 3 * count))
    shared[:, :m] = by_identity
    rows = np.arange(len(own)).reshape(-1, 2)
    columns = m + 3 * seen[:, None] + np.arange(3)
    shared[rows[:, :, None], columns[:, None, :]] = by_offset
    value = value.ravel()
    prior = np.concatenate([np.full(6, 1e-9), np.full(len(x), 1.0 / EXPRESSION_SIGMA**2)])
    h = own.T @ own + np.diag(prior)
    g = -own.T @ value + prior * np.concatenate([np.zeros(6), view.prior])
    return h, own.T @ shared, shared.T @ shared, g, -shared.T @ value, centre


def _add_eliminated(h: np.ndarray, g: np.ndarray, part: FrameEquations, x: np.ndarray) -> None:
    """Add a frame to the shared equations, in place, and eliminate its pose and its free coefficients."""
    own, cross, shared, right, shared_right, _ = part
    free = np.concatenate([np.ones(6, bool), (x > 1e-6) & (x < 1 - 1e-6)])
    held = np.flatnonzero(~free)
    value = np.concatenate([np.zeros(6), x])[held]
    right = right[free] - own[np.ix_(free, held)] @ value
    eliminated = np.linalg.solve(own[np.ix_(free, free)], np.column_stack([cross[free], right]))
    h += shared - cross[free].T @ eliminated[:, :-1]
    g += shared_right - cross[held].T @ value - cross[free].T @ eliminated[:, -1]


def _own_update(part: FrameEquations, shared: np.ndarray, pose: np.ndarray, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Compute a frame's new pose and bounded coefficients from the shared unknowns."""
    own, cross, _, right, _, centre = part
    right = right - cross @ shared
    eliminated = np.linalg.solve(own[:6, :6], np.column_stack([own[:6, 6:], right[:6]]))
    reduced = own[6:, 6:] - own[6:, :6] @ eliminated[:, :-1]
    limits = np.zeros(len(x)), np.ones(len(x))
    x = bounded_least_squares(reduced, right[6:] - own[6:, :6] @ eliminated[:, -1], *limits, x)
    return apply_rigid_update(pose, eliminated[:, -1] - eliminated[:, :-1] @ x, centre), x
