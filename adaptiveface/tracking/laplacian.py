"""Fast Laplacian deformation (section 4.3, equations 3 to 7) with a matrix that is factorised once.

Unknown: the displacement (n, 3) of the frontal vertices in the head frame; everything else stays (Dirichlet boundary).
Energy, with energy weights (the docs tell why the printed eq. 7, read as row weights, makes w1 and w2 vanish):

    w1 sum_i (n_i^T (d_i - (p_i - v_i)))^2  +  w2 |L d|^2  +  sum_f w_f |H_f d_f - t_f|^2

The depth term acts along the normals only: depth says nothing about motion within the surface, and the paper's point-to-point
form (eq. 3) holds the skin back there. Its matrix would change with every frame; the constant matrix
A0 = w1 I + w2 L^T L bounds it from above, so conjugate gradients preconditioned with the factor of A0 (plus the features'
rows, added exactly by the Woodbury identity) solve it in one or two steps from the previous frame's displacement. A vertex
without depth simply has no depth row, and follows its neighbours. ``laplacian.depth_term`` = "point-to-point" has the
paper's form, whose matrix is A0 itself and needs no iteration; printed.py has its targets and the printed feature rows.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg.lapack import dpotrf, dpotrs

from ..caches.compiled import compiled
from ..geometry.camera import Camera
from ..geometry.frame import Features2D
from ..geometry.mesh import cotangent_laplacian
from ..model.actor import Actor
from ..registration.association import Correspondences
from .prefactored import LaplacianOperator, PrefactoredSystem
from .slow_modes import SlowModes
from .surface_term import SurfaceTerm

#: Row numbers (m,) and directions (m, 3) of the features' rows, and the factor of their Woodbury system; None without rows.
Correction = tuple[np.ndarray, np.ndarray, np.ndarray | None]


@dataclass(frozen=True)
class FeatureTerm:
    """The features' rows of one frame: for feature f with barycentric row e_f, energy sum_r w_fr (h_fr . (e_f d) - t_fr)^2.

    ``index`` (f,), ``rows`` (f, r, 3) and ``targets`` (f, r), whose unit is mm unless said, ``weights`` (f, r).
    """

    index: np.ndarray
    rows: np.ndarray
    targets: np.ndarray
    weights: np.ndarray

    @cached_property
    def matrices(self) -> np.ndarray:
        """The sums (f, 3, 3) over the rows of w_fr h_fr h_fr^T."""
        found: np.ndarray = (self.weights[:, :, None] * self.rows).transpose(0, 2, 1) @ self.rows
        return found

    @cached_property
    def pulls(self) -> np.ndarray:
        """The sums (f, 3) over the rows of w_fr t_fr h_fr."""
        found: np.ndarray = np.einsum("fr,frd->fd", self.weights * self.targets, self.rows)
        return found


def feature_term(
    features: Features2D | None,
    camera: Camera,
    pose: np.ndarray,
    mesh: np.ndarray,
    corners: np.ndarray,
    shares: np.ndarray,
    weight: float,
    hold_depth: bool,
) -> FeatureTerm:
    """Lateral rows of eq. (5) in millimetres, and a third that keeps the depth (weak projection) when ``hold_depth``.

    The features' points lie between ``corners`` (40, 3) of a mesh (N, 3), head frame, by ``shares`` (40, 3). The rows
    (:func:`.feature_rows`) are divided by the focal length, so that a residual is the lateral distance in mm and ``weight``
    is per mm^2.
    """
    count = 3 if hold_depth else 2
    if features is None:
        return FeatureTerm(np.zeros(0, int), np.zeros((0, count, 3)), np.zeros((0, count)), np.zeros((0, count)))
    index, confidence = np.flatnonzero(features.valid), features.confidence.astype(float, copy=False)
    lens = camera.fx, camera.fy, camera.cx, camera.cy
    rows, targets, weights = _lateral_rows(index, features.pixels, confidence, lens, pose, mesh, corners, shares, count)
    return FeatureTerm(index, rows, targets, weight * weights)


@compiled(nogil=True)
def _lateral_rows(
    index: np.ndarray,
    pixels: np.ndarray,
    confidence: np.ndarray,
    lens: tuple[float, float, float, float],
    pose: np.ndarray,
    mesh: np.ndarray,
    corners: np.ndarray,
    shares: np.ndarray,
    count: int,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rows (f, r, 3), targets (f, r) and confidences (f, r) of :func:`feature_term`: some 30 calls of NumPy in one."""
    fx, fy, cx, cy = lens
    rows, targets, weights = np.empty((len(index), count, 3)), np.zeros((len(index), count)), np.empty((len(index), count))
    point = np.empty(3)
    for n in range(len(index)):
        f = index[n]
        for d in range(3):
            point[d] = 0.0
            for k in range(3):
                point[d] += shares[f, k] * mesh[corners[f, k], d]
        for r in range(count):
            # (1, 0, (cx - u) / fx), (0, fy / fx, (cy - v) / fx), (0, 0, 1) in the camera frame
            x = 1.0 if r == 0 else 0.0
            y = fy / fx if r == 1 else 0.0
            z = 1.0 if r == 2 else ((cx - pixels[f, 0]) / fx if r == 0 else (cy - pixels[f, 1]) / fx)
            for d in range(3):
                rows[n, r, d] = x * pose[0, d] + y * pose[1, d] + z * pose[2, d]
            if r < 2:
                value = x * pose[0, 3] + y * pose[1, 3] + z * pose[2, 3]
                targets[n, r] = -(value + rows[n, r, 0] * point[0] + rows[n, r, 1] * point[1] + rows[n, r, 2] * point[2])
            weights[n, r] = confidence[f]
    return rows, targets, weights


class LaplacianDeformation:
    """Deforms the frontal region towards depth and 2D features, or features only (``w1 = 0``).

    The features' points are combinations of frontal vertices: ``corners`` (40, 3) and ``shares`` (40, 3).
    """

    def __init__(
        self,
        vertices: np.ndarray,
        triangles: np.ndarray,
        frontal: np.ndarray,
        feature_triangles: np.ndarray,
        feature_weights: np.ndarray,
        w1: float,
        w2: float,
        laplacian: LaplacianOperator = cotangent_laplacian,
    ) -> None:
        self.w1, self.w2 = w1, w2
        self.slow: SlowModes | None = None
        self.system = PrefactoredSystem(vertices, triangles, frontal, w1, w2, laplacian)
        # A corner outside the frontal region does not move: its share of the feature is dropped.
        self.corners = (np.cumsum(frontal) - 1)[feature_triangles]
        self.shares = np.where(frontal[feature_triangles], feature_weights, 0.0)
        self._respond()

    @classmethod
    def of(cls, actor: Actor, w1: float, w2: float, laplacian: LaplacianOperator = cotangent_laplacian) -> LaplacianDeformation:
        """The deformation of an actor's frontal region."""
        rigging = (actor.neutral, actor.triangles, actor.frontal, actor.feature_triangles, actor.feature_weights)
        return cls(*rigging, w1, w2, laplacian)

    def reweighted(self, w1: float, w2: float) -> LaplacianDeformation:
        """The same surface and features with other energy weights; costs less than a new one."""
        out = copy.copy(self)
        out.w1, out.w2, out.system = w1, w2, self.system.reweighted(w1, w2)
        out._respond()
        return out

    def bounded(self, extra: np.ndarray, slow: SlowModes | None = None) -> LaplacianDeformation:
        """The same energies, whose constant matrix A0 also bounds further rows: of at most ``extra`` (n,) at the vertices.

        ``slow``: what is solved beside the iterations, in place of the features' rows: few modes hold these as well.
        """
        out = copy.copy(self)
        out.system, out.slow = self.system.reweighted(self.w1 + extra, self.w2), slow
        out._respond()
        return out

    def _respond(self) -> None:
        unit_forces = np.zeros((self.system.smoothing.shape[0], len(self.corners)))
        np.add.at(unit_forces, (self.corners, np.arange(len(self.corners))[:, None]), self.shares)
        #: Response of every vertex to a unit force at a feature, A0^-1 E^T (n, 40), and its value at the features.
        self._response = self.system.solve(unit_forces)
        self._compliance = np.einsum("fk,fkg->fg", self.shares, self._response[self.corners])
        self._response = self._response.astype(np.float32)

    def _at_features(self, field: np.ndarray, index: np.ndarray) -> np.ndarray:
        """A field (n, 3) at the features' points: (f, 3)."""
        values: np.ndarray = np.einsum("fk,fkd->fd", self.shares[index], field[self.corners[index]])
        return values

    def feature_correction(self, term: FeatureTerm) -> Correction:
        """The Woodbury system of the features' rows: (A0 + H^T W H)^-1 = A0^-1 - A0^-1 H^T (W^-1 + H A0^-1 H^T)^-1 H A0^-1."""
        index, rows = term.index.repeat(term.rows.shape[1]), term.rows.reshape(-1, 3)
        if len(rows) == 0:
            return index, rows, None
        matrix = rows @ rows.T
        _add_compliance(matrix, self._compliance, index, term.weights.ravel())
        return index, rows, dpotrf(matrix, overwrite_a=1, clean=0)[0]

    def deform_to_features(self, term: FeatureTerm) -> np.ndarray:
        """Exact minimum with w1 = 0: (n, 3); needs no sparse solve at all, only the features' responses."""
        index, rows, factor = self.feature_correction(term)
        if len(rows) == 0:
            return np.zeros((len(self._response), 3))
        return self._spread(index, rows * dpotrs(factor, term.targets.ravel())[0][:, None])

    def _spread(self, index: np.ndarray, forces: np.ndarray) -> np.ndarray:
        """Response (n, 3) to the ``forces`` (m, 3) of rows at the features ``index`` (m,)."""
        response: np.ndarray = self._response @ _at_features(index, forces, self._response.shape[1])
        return response

    def deform_to_points(self, offsets: np.ndarray, term: FeatureTerm) -> np.ndarray:
        """Exact minimum with equation (3), w1 |d - offsets|^2, in place of the depth term along the normals: (n, 3).

        ``offsets`` (n, 3) head frame, mm: p_i - v_i. Its matrix is A0, which is factorised: one direct solve.
        """
        without = self.system.solve(self.w1 * offsets)
        index, rows, factor = self.feature_correction(term)
        if len(rows) == 0:
            return without
        missing = term.targets.ravel() - (rows * self._at_features(without, index)).sum(axis=1)
        displacement: np.ndarray = without + self._spread(index, rows * dpotrs(factor, missing)[0][:, None])
        return displacement

    def deform(
        self,
        matches: Correspondences,
        normals: np.ndarray,
        term: FeatureTerm,
        start: np.ndarray,
        steps: int,
        skin: SurfaceTerm | None = None,
    ) -> np.ndarray:
        """Displacement (n, 3) towards depth and features by ``steps`` steps from ``start`` (n, 3): :class:`FrameSystem`."""
        return FrameSystem(self, matches, normals, term).deform(start, steps, skin)

    def right_hand_side(self, matches: Correspondences, normals: np.ndarray, term: FeatureTerm) -> np.ndarray:
        """b (n, 3) of the normal equations A d = b: depth pulls along ``normals`` (n, 3), features pull at their corners."""
        right: np.ndarray = -(self.w1 * matches.weights * matches.distances)[:, None] * normals
        self.at_points(term).add_pulls(right)
        return right

    def at_points(self, term: FeatureTerm) -> SurfaceTerm:
        """The features' rows, summed up at each feature's point."""
        return SurfaceTerm(self.corners[term.index], self.shares[term.index], term.matrices, term.pulls)

    def precondition(self, right: np.ndarray, correction: Correction | None) -> np.ndarray:
        """The search direction (n, 3) for a residual (n, 3), by A0 and the features' rows."""
        solved = self.system.precondition(right)
        if correction is None:
            return solved
        index, rows, factor = correction
        if len(rows) == 0:
            return solved
        at_rows = (rows * self._at_features(solved, index)).sum(axis=1)
        direction: np.ndarray = solved - self._spread(index, rows * dpotrs(factor, at_rows)[0][:, None])
        return direction


class FrameSystem:
    """A d = b of one frame: smoothing, depth and features. Rows of colours join them, other ones at every look.

    Parameters
    ----------
    deformation : LaplacianDeformation
        Its energies and its constant matrix; ``bounded`` for colours where there are any.
    matches : Correspondences
        Of the n frontal vertices (weight 0: none).
    normals : (n, 3)
        Their normals in the head frame.
    term : FeatureTerm
        The features' rows.
    """

    def __init__(
        self, deformation: LaplacianDeformation, matches: Correspondences, normals: np.ndarray, term: FeatureTerm
    ) -> None:
        self.deformation, self._normals, self._term = deformation, normals, term
        self._strength, self._features = deformation.w1 * matches.weights, deformation.at_points(term)
        self._right = deformation.right_hand_side(matches, normals, term)
        self._last: tuple[np.ndarray, np.ndarray] | None = None  # a displacement and its image, for the next look

    def apply(self, displacement: np.ndarray) -> np.ndarray:
        """The matrix times a displacement (n, 3), without colours."""
        image = self.deformation.system.apply(displacement, self._strength, self._normals)
        self._features.add_image(image, displacement)
        return image

    def deform(self, start: np.ndarray, steps: int, skin: SurfaceTerm | None = None) -> np.ndarray:
        """Displacement (n, 3) by ``steps`` preconditioned conjugate-gradient steps from ``start`` (n, 3).

        Where there are slow modes, a step in their span comes first. ``skin``: the colours' rows.
        """
        slow, deformation = self.deformation.slow, self.deformation
        correction = deformation.feature_correction(self._term) if slow is None and steps else None
        first = [] if slow is None else [slow.solve]

        def precondition(residual: np.ndarray) -> np.ndarray:
            """The search direction (n, 3) for a residual (n, 3)."""
            return deformation.precondition(residual, correction)

        displacement = start.copy()
        image = self._last[1] if self._last is not None and self._last[0] is start else self.apply(start)
        residual = self._right - image
        if skin is not None:
            skin.add_residual(residual, start)
        earlier: list[tuple[np.ndarray, np.ndarray, float]] = []  # directions, their images and their stiffness
        for solve in [*first, *[precondition] * steps]:
            direction = solve(residual)
            for other, seen, stiffness in earlier:
                _add(direction, -float(np.vdot(direction, seen)) / stiffness, other)
            slope = float(np.vdot(residual, direction))
            if slope <= 0.0:
                break
            plain = seen = self.apply(direction)
            if skin is not None:
                seen = plain.copy()
                skin.add_image(seen, direction)
            stiffness = float(np.vdot(direction, seen))
            _add(displacement, slope / stiffness, direction)
            _add(residual, -slope / stiffness, seen)
            if skin is not None:
                _add(image, slope / stiffness, plain)
            earlier.append((direction, seen, stiffness))
        if skin is not None:
            self._last = displacement, image
        return displacement


@compiled(nogil=True)
def _add_compliance(matrix: np.ndarray, compliance: np.ndarray, index: np.ndarray, weights: np.ndarray) -> None:
    """Make products of rows (m, m) the Woodbury system of these rows, in place.

    ``compliance`` (40, 40) between the features, ``index`` (m,) of the rows' features, and the rows' ``weights`` (m,).
    """
    for i in range(len(index)):
        for j in range(len(index)):
            matrix[i, j] *= compliance[index[i], index[j]]
        matrix[i, i] += 1.0 / max(weights[i], 1e-12)


@compiled(nogil=True)
def _at_features(index: np.ndarray, forces: np.ndarray, count: int) -> np.ndarray:
    """Sums (count, 3) of the rows' ``forces`` (m, 3) at each feature, in single precision."""
    total = np.zeros((count, 3))
    for i in range(len(index)):
        for k in range(3):
            total[index[i], k] += forces[i, k]
    return total.astype(np.float32)


@compiled(nogil=True)
def _add(field: np.ndarray, factor: float, other: np.ndarray) -> None:
    """``field += factor * other`` of two fields (n, 3), in place and in one pass."""
    for i in range(len(field)):
        for k in range(3):
            field[i, k] += factor * other[i, k]
