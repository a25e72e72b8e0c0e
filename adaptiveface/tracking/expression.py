"""Fitting with the initial blendshapes (section 4.2)."""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple, Self

import cv2
import numpy as np
from scipy.linalg.blas import dsyrk

from ..caches.compiled import compiled
from ..geometry.camera import Camera
from ..geometry.frame import Features2D
from ..geometry.mesh import transform_points
from ..model.actor import Actor
from ..parameters import BlendshapeParameters
from ..registration.association import find_correspondences
from ..registration.step import apply_rigid_update
from ..registration.surface import DepthSurface
from .bounded import BoundedSolver, bounded_least_squares
from .feature_rows import FeatureRows, camera_rows, turns
from .resolve import SparseResolve
from .shared_errors import SharedErrors


@dataclass(frozen=True)
class NormalEquations:
    """Quadratic energy in (pose update (6,), coefficients (A,)): H (6 + A, 6 + A) and right-hand side g (6 + A,)."""

    h: np.ndarray
    g: np.ndarray


def add_rows(
    equations: NormalEquations, jacobian: np.ndarray, residual: np.ndarray, weights: np.ndarray, current: np.ndarray
) -> None:
    """Add sum_i w_i (residual_i + J_i (z - current))^2 in place; z stacks the pose update and the coefficients.

    ``jacobian`` (m, 6 + A) is scaled in place. Only the upper triangle of H is filled, by BLAS's symmetric rank-k update.
    """
    root = np.sqrt(weights)
    target = root * (jacobian @ current - residual)
    jacobian *= root[:, None]
    equations.h[...] += dsyrk(1.0, jacobian.T)
    equations.g[...] += target @ jacobian


@compiled
def _depth_jacobian(
    points: np.ndarray, normals: np.ndarray, turned: np.ndarray, weights: np.ndarray, basis: np.ndarray, centre: np.ndarray
) -> np.ndarray:
    """(m, 6 + A) rows of the matched points: (v - c) x n, n, and the turned normal times the blendshapes (eq. 1)."""
    count, a = 0, basis.shape[2]
    for i in range(len(points)):
        count += weights[i] > 0.0
    jacobian, row = np.empty((count, 6 + a)), 0
    for i in range(len(points)):
        if weights[i] == 0.0:
            continue
        x, y, z = points[i, 0] - centre[0], points[i, 1] - centre[1], points[i, 2] - centre[2]
        n0, n1, n2 = normals[i, 0], normals[i, 1], normals[i, 2]
        jacobian[row, 0], jacobian[row, 1], jacobian[row, 2] = y * n2 - z * n1, z * n0 - x * n2, x * n1 - y * n0
        jacobian[row, 3], jacobian[row, 4], jacobian[row, 5] = n0, n1, n2
        for k in range(a):
            jacobian[row, 6 + k] = turned[i, 0] * basis[i, 0, k] + turned[i, 1] * basis[i, 1, k] + turned[i, 2] * basis[i, 2, k]
        row += 1
    return jacobian


#: Angle between the face's direction and the camera: up to the first a face is seen from the front, from the second on
#: it is a profile, degrees.
FRONT, PROFILE = 30.0, 70.0


def turned_away(pose: np.ndarray, centre: np.ndarray) -> float:
    """0 for a face seen from the front to 1 in profile; ``pose`` (4, 4) head to camera, ``centre`` (3,) camera frame, mm.

    In profile half of the face is hidden and the rest is seen at a grazing angle: a rigid head's fit opened its mouth by
    19 mm there, from depth alone, unless its coefficients were held back (``blendshapes.profile_stiffness``).
    """
    cosine = -(pose[:3, 2] @ centre) / np.linalg.norm(centre)
    angle = np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))
    return float(np.clip((angle - FRONT) / (PROFILE - FRONT), 0.0, 1.0))


@dataclass(frozen=True)
class HeldPose:
    """A penalty on the head's motion since the last frame's ``pose`` (4, 4): ``turn`` per rad^2, ``shift`` per mm^2."""

    pose: np.ndarray
    turn: float
    shift: float

    def add_to(self, equations: NormalEquations, pose: np.ndarray, middle: np.ndarray) -> None:
        """Add it for an update of ``pose``, which turns about the head-frame point ``middle`` (3,), in place."""
        turned = cv2.Rodrigues(pose[:3, :3] @ self.pose[:3, :3].T)[0].ravel()
        shifted = transform_points(pose, middle) - transform_points(self.pose, middle)
        weights = np.repeat([self.turn, self.shift], 3)
        equations.h[np.arange(6), np.arange(6)] += weights
        equations.g[:6] -= weights * np.concatenate([turned, shifted])


class Seen(NamedTuple):
    """What one frame gives to the fit: its depth with the normals of ``depth_vertices``, its features in the camera frame.

    ``shared`` holds errors that many of the features have in common.
    """

    surface: DepthSurface | None
    features: FeatureRows
    normals: np.ndarray | None
    shared: SharedErrors | None = None


class BlendshapeFit:
    """The bounded fit of the initial blendshapes to depth (point to plane) and 2D features, equations (1) and (2).

    Two departures from the paper, both measured (see the paper notes in the docs). The rigid pose is solved together with
    the coefficients (``joint_pose``), because an expression biases a pose that is found alone. A ridge and a temporal
    penalty keep coefficients that the data do not determine from wandering.

    Parameters
    ----------
    actor : Actor
        Its neutral b0 and its blendshapes B.
    parameters : BlendshapeParameters
        Weights, bounds and limits.
    solver : callable
        Solves the bounded problems, as :func:`.bounded_least_squares` does.
    """

    #: How rows enter the normal equations; a subclass may look at them on their way.
    add_rows = staticmethod(add_rows)

    def __init__(self, actor: Actor, parameters: BlendshapeParameters, solver: BoundedSolver = bounded_least_squares) -> None:
        self.parameters, self._solver, self._actor = parameters, solver, actor
        self.neutral = actor.neutral
        #: Every so many of the vertices that may take a depth correspondence, and their part of b0 and B.
        self.depth_vertices = np.flatnonzero(actor.frontal & actor.depth_valid)[:: parameters.vertex_stride]
        self._b0 = np.ascontiguousarray(self.neutral[self.depth_vertices])
        self._middle = self._b0.mean(axis=0)
        self._radius = float(np.sqrt(((self._b0 - self._middle) ** 2).sum(axis=1).mean()))
        self._f0 = np.einsum("fk,fkd->fd", actor.feature_weights, self.neutral[actor.feature_triangles])
        self._take(actor.blendshapes[: parameters.A])
        #: Section 6: the re-solve of the final mesh, ``resolve(vertices (N, 3), start (A,))``.
        self.resolve = SparseResolve(actor, self.basis, parameters, np.float32, solver)

    def _take(self, basis: np.ndarray) -> None:
        """Fit with the expressions ``basis`` (A, N, 3), mm."""
        self.basis, count, actor = basis, len(basis), self._actor
        # Single precision: half the memory to stream in every round, and still 1e-5 mm.
        self._b = np.ascontiguousarray(self.basis[:, self.depth_vertices].transpose(1, 2, 0), np.float32)
        self._b_flat = self._b.reshape(-1, count)
        self._motion = self._b_flat.T.astype(float) @ self._b_flat / max(len(self._b), 1)  # (A, A) mean squared motion, mm^2
        self._f = np.einsum("fk,afkd->fda", actor.feature_weights, self.basis[:, actor.feature_triangles])
        self._flat = self.basis.reshape(count, -1).astype(np.float32, copy=False)

    def with_basis(self, basis: np.ndarray) -> Self:
        """The same fit with other meshes (A, N, 3) of the same expressions, displacements from the neutral, mm."""
        out = copy.copy(self)
        out._take(basis)
        out.resolve = self.resolve.with_basis(basis)
        return out

    def shape(self, x: np.ndarray) -> np.ndarray:
        """v1 = b0 + B x, (N, 3) in the head frame."""
        mesh: np.ndarray = self.neutral + (x.astype(np.float32) @ self._flat).reshape(-1, 3)
        return mesh

    def feature_points(self, x: np.ndarray) -> np.ndarray:
        """(40, 3) head-frame points of the features at coefficients x."""
        points: np.ndarray = self._f0 + self._f @ x
        return points

    def fit(
        self,
        surface: DepthSurface | None,
        features: Features2D | None,
        camera: Camera,
        pose: np.ndarray,
        x: np.ndarray,
        normals: np.ndarray | None,
        held: HeldPose | None = None,
        settle: Callable[[np.ndarray], np.ndarray] | None = None,
        shared: SharedErrors | None = None,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Alternate between the search for correspondences and the bounded solve.

        Parameters
        ----------
        surface : DepthSurface or None
            The depth map around the face. Without it the features alone decide.
        features : Features2D or None
            The frame's 2D features.
        camera : Camera
            The frame's calibration.
        pose : (4, 4)
            The start, head frame to camera frame, mm.
        x : (A,)
            The coefficients of the previous frame.
        normals : (n, 3) or None
            Unit normals of ``depth_vertices``, head frame. None without a surface.
        held : HeldPose, optional
            Holds the pose near that of the last frame.
        settle : callable, optional
            What becomes of the coefficients in the end (the Kalman filter). The pose is solved for its result.
        shared : SharedErrors, optional
            Errors that many of the features have in common.

        Returns
        -------
        pose : (4, 4)
            Head frame to camera frame, mm.
        x : (A,)
            The coefficients.
        """
        previous, seen = x, Seen(surface, camera_rows(features, camera), normals, shared)
        for left in range(self.parameters.iterations - 1, -1, -1):
            equations, centre = self._assemble(seen, pose, x, previous)
            if held is not None:
                held.add_to(equations, pose, self._middle)
            before = x
            x, update_for = self.solve(equations, x)
            done = left == 0 or self._step(update_for(x), x - before) < self.parameters.min_step
            if done and settle is not None:
                x = settle(x)
            if self.parameters.joint_pose:
                pose = apply_rigid_update(pose, update_for(x), centre)
            if done:
                break
        return pose, x

    def _step(self, update: np.ndarray, change: np.ndarray) -> float:
        """By how much a round moves the face at most, root mean square, mm: pose ``update`` (6,) and ``change`` (A,) of x."""
        turn, shift = np.linalg.norm(update[:3]), np.linalg.norm(update[3:])
        return float(turn * self._radius + shift + np.sqrt(max(change @ self._motion @ change, 0.0)))

    def _assemble(
        self, seen: Seen, pose: np.ndarray, x: np.ndarray, previous: np.ndarray
    ) -> tuple[NormalEquations, np.ndarray]:
        p, count = self.parameters, len(x)
        equations = NormalEquations(np.zeros((6 + count, 6 + count)), np.zeros(6 + count))
        current = np.concatenate([np.zeros(6), x])
        centre = transform_points(pose, self._middle)
        if seen.surface is not None and seen.normals is not None:
            self._add_depth(equations, seen.surface, pose, x, seen.normals, centre, current)
        rows = seen.features.at(pose)
        if len(rows.index):
            basis = self._f[rows.index]
            points = self._f0[rows.index] + basis @ x
            residual = np.einsum("fij,fj->fi", rows.rows, points) + rows.offsets
            in_camera = rows.rows @ pose[:3, :3].T
            lever = transform_points(pose, points) - centre
            jacobian = np.concatenate([turns(lever, in_camera), in_camera, rows.rows @ basis], axis=2).reshape(-1, 6 + count)
            weights = np.repeat(p.w * rows.weights, 2)
            if seen.shared is not None:
                target = jacobian @ current - residual.ravel()
                h, g = seen.shared.explained(rows.index, pose, jacobian, target, weights)
                equations.h[...] -= np.triu(h)
                equations.g[...] -= g
            self.add_rows(equations, jacobian, residual.ravel(), weights, current)
        stiff = p.ridge * (1.0 if seen.surface is None else p.profile_stiffness ** turned_away(pose, centre))
        ridge = np.concatenate([np.full(6, 1e-6), np.full(count, stiff + p.temporal)])
        equations.h[...] += np.triu(equations.h, 1).T + np.diag(ridge)
        equations.g[6:] += p.temporal * previous
        return equations, centre

    def _add_depth(
        self,
        equations: NormalEquations,
        surface: DepthSurface,
        pose: np.ndarray,
        x: np.ndarray,
        normals: np.ndarray,
        centre: np.ndarray,
        current: np.ndarray,
    ) -> None:
        """Equation (1)'s rows of the vertices that find a partner in the depth map, added in place."""
        p = self.parameters
        shape = self._b0 + (self._b_flat @ x.astype(np.float32)).reshape(-1, 3)
        matches = find_correspondences(surface, shape, normals, p.max_correspondence_distance, pose)
        matched = matches.weights > 0
        if p.weights == "equal":
            matches = matches.equally_weighted()
        jacobian = _depth_jacobian(
            matches.points, matches.normals, matches.normals @ pose[:3, :3], matches.weights, self._b, centre
        )
        distances = matches.distances[matched]
        # Each stands for ``vertex_stride`` vertices, so that w keeps its meaning.
        weights = p.vertex_stride * matches.weights[matched] / (1.0 + (distances / p.outlier_distance) ** 2)
        self.add_rows(equations, jacobian, distances, weights, current)

    def solve(self, equations: NormalEquations, x: np.ndarray) -> tuple[np.ndarray, Callable[[np.ndarray], np.ndarray]]:
        """Eliminate the unbounded pose update (Schur complement), and solve for the bounded coefficients.

        Parameters
        ----------
        equations : NormalEquations
            In the pose update and the coefficients.
        x : (A,)
            A first guess.

        Returns
        -------
        x : (A,)
            The coefficients.
        update_for : callable
            The pose update (6,) that fits given coefficients (A,) best.
        """
        h, g, count = equations.h, equations.g, len(x)
        lower, upper = np.full(count, self.parameters.lower), np.full(count, self.parameters.upper)
        if not self.parameters.joint_pose:
            return self._solver(h[6:, 6:], g[6:], lower, upper, x), lambda x: np.zeros(6)
        eliminated = np.linalg.solve(h[:6, :6], np.column_stack([h[:6, 6:], g[:6]]))
        reduced = h[6:, 6:] - h[6:, :6] @ eliminated[:, :-1]
        x = self._solver(reduced, g[6:] - h[6:, :6] @ eliminated[:, -1], lower, upper, x)
        return x, lambda x: eliminated[:, -1] - eliminated[:, :-1] @ x
