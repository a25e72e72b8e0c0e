"""Fast Laplacian deformation (section 4.3, equations 3 to 7) with a matrix that is factorised once.

Unknown: the displacement (n, 3) of the frontal vertices in the head frame; everything else stays (Dirichlet boundary).
Energy, with energy weights (the docs tell why the printed eq. 7, read as row weights, makes w1 and w2 vanish):

    w1 sum_i (n_i^T (d_i - (p_i - v_i)))^2  +  w2 |L d|^2  +  sum_f w_f |H_f d_f - t_f|^2

The depth term acts along the normals only: depth says nothing about motion within the surface, and the paper's point-to-point
form (eq. 3) holds the skin back there. Its matrix would change with every frame; the constant matrix
A0 = w1 I + w2 L^T L bounds it from above, so conjugate gradients preconditioned with the factor of A0 (plus the features'
rows, added exactly by the Woodbury identity) solve it in one or two steps from the previous frame's displacement. A vertex
without depth simply has no depth row, and follows its neighbours.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from ..mesh import cotangent_laplacian
from .depth_surface import Correspondences
from .feature_rows import FeatureRows


class PrefactoredSystem:
    """A0 = w1 I + w2 L^T L on the frontal vertices, factorised once, three right-hand sides at a time.

    Raises ValueError when A0 is singular (w1 = 0 and no vertex outside the frontal region).
    """

    def __init__(self, vertices: np.ndarray, triangles: np.ndarray, frontal: np.ndarray, w1: float, w2: float) -> None:
        rows = cotangent_laplacian(vertices, triangles)[:, np.flatnonzero(frontal)]
        self.smoothing = (w2 * (rows.T @ rows)).tocsr()
        matrix = (self.smoothing + w1 * sp.identity(rows.shape[1])).tocsc()
        # The matrix is symmetric positive definite: diagonal pivots and a symmetric ordering keep the factor sparse.
        self._factor = splu(matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})

    def solve(self, right_hand_side: np.ndarray) -> np.ndarray:
        """A0^-1 b for b (n, c)."""
        return self._factor.solve(right_hand_side)


@dataclass(frozen=True)
class FeatureTerm:
    """The features' rows of one frame: for feature f with barycentric row e_f, energy sum_r w_fr (h_fr . (e_f d) - t_fr)^2.

    ``index`` (f,), ``rows`` (f, r, 3) unit mm, ``targets`` (f, r) mm, ``weights`` (f, r).
    """

    index: np.ndarray
    rows: np.ndarray
    targets: np.ndarray
    weights: np.ndarray


def feature_term(rows: FeatureRows, points: np.ndarray, pose: np.ndarray, focal: float, weight: float,
                 hold_depth: bool) -> FeatureTerm:
    """Lateral rows of eq. (5) in millimetres, and a third that keeps the depth (weak projection) when ``hold_depth``.

    points (f, 3) head frame: where the features are now. Eq. (2)'s rows are divided by the focal length, so that a
    residual is the lateral distance in mm and ``weight`` is per mm^2.
    """
    value = np.einsum("fij,fj->fi", rows.rows, points) + rows.offsets
    lateral, target = rows.rows / focal, -value / focal
    weights = np.repeat(weight * rows.weights[:, None], 2, axis=1)
    if hold_depth:
        along = np.broadcast_to(pose[2, :3], (len(lateral), 1, 3))
        lateral = np.concatenate([lateral, along], axis=1)
        target = np.column_stack([target, np.zeros(len(target))])
        weights = np.column_stack([weights, weights[:, 0]])
    return FeatureTerm(rows.index, lateral, target, weights)


class LaplacianDeformation:
    """Deforms the frontal region towards depth and 2D features, or features only (``w1 = 0``).

    ``barycentric`` (40, n) sparse: the features' points as combinations of frontal vertices.
    """

    def __init__(self, vertices: np.ndarray, triangles: np.ndarray, frontal: np.ndarray, feature_triangles: np.ndarray,
                 feature_weights: np.ndarray, w1: float, w2: float) -> None:
        self.w1 = w1
        self.system = PrefactoredSystem(vertices, triangles, frontal, w1, w2)
        index = np.cumsum(frontal) - 1
        inside = frontal[feature_triangles]
        entries = (feature_weights[inside], (np.nonzero(inside)[0], index[feature_triangles[inside]]))
        self.barycentric = sp.csr_matrix(entries, (len(feature_triangles), int(frontal.sum())))
        #: Response of every vertex to a unit force at a feature, A0^-1 E^T (n, 40), and its value at the features.
        self._response = self.system.solve(self.barycentric.T.toarray())
        self._compliance = self.barycentric @ self._response

    def _feature_correction(self, term: FeatureTerm):
        """The Woodbury system of the features' rows: (A0 + H^T W H)^-1 = A0^-1 - A0^-1 H^T (W^-1 + H A0^-1 H^T)^-1 H A0^-1."""
        count = term.rows.shape[1]
        index, rows = np.repeat(term.index, count), term.rows.reshape(-1, 3)
        matrix = self._compliance[np.ix_(index, index)] * (rows @ rows.T)
        matrix[np.diag_indices_from(matrix)] += 1.0 / np.maximum(term.weights.ravel(), 1e-12)
        return index, rows, matrix

    def deform_to_features(self, term: FeatureTerm) -> np.ndarray:
        """Exact minimum with w1 = 0: (n, 3); needs no sparse solve at all, only the features' responses."""
        index, rows, matrix = self._feature_correction(term)
        forces = np.linalg.solve(matrix, term.targets.ravel())
        return self._spread(index, rows * forces[:, None])

    def _spread(self, index: np.ndarray, forces: np.ndarray) -> np.ndarray:
        at_features = np.zeros((self._response.shape[1], 3))
        np.add.at(at_features, index, forces)
        return self._response @ at_features

    def deform(self, matches: Correspondences, normals: np.ndarray, term: FeatureTerm, start: np.ndarray, steps: int) -> np.ndarray:
        """Displacement (n, 3) towards depth and features by ``steps`` preconditioned conjugate-gradient steps.

        ``matches`` of the n frontal vertices (weight 0: none) with ``normals`` (n, 3) in the head frame; ``start`` (n, 3).
        """
        strength = self.w1 * matches.weights
        correction = self._feature_correction(term)
        right = -(strength * matches.distances)[:, None] * normals + self._pull(term, term.targets)
        displacement = start.copy()
        residual = right - self._apply(displacement, strength, normals, term)
        direction, previous = np.zeros_like(residual), 1.0
        for step in range(steps):
            preconditioned = self._precondition(residual, correction)
            slope = float(np.vdot(residual, preconditioned))
            if slope <= 0.0:
                break
            direction = preconditioned + (slope / previous if step else 0.0) * direction
            image = self._apply(direction, strength, normals, term)
            length = slope / float(np.vdot(direction, image))
            displacement += length * direction
            residual -= length * image
            previous = slope
        return displacement

    def _pull(self, term: FeatureTerm, values: np.ndarray) -> np.ndarray:
        """H^T W values, (n, 3)."""
        forces = np.einsum("fr,frd->fd", term.weights * values, term.rows)
        return self.barycentric[term.index].T @ forces

    def _apply(self, d: np.ndarray, strength: np.ndarray, normals: np.ndarray, term: FeatureTerm) -> np.ndarray:
        """The true system's matrix times a displacement (n, 3)."""
        along = strength * (normals * d).sum(axis=1)
        at_features = self.barycentric[term.index] @ d
        values = np.einsum("frd,fd->fr", term.rows, at_features)
        return self.system.smoothing @ d + along[:, None] * normals + self._pull(term, values)

    def _precondition(self, right: np.ndarray, correction) -> np.ndarray:
        index, rows, matrix = correction
        solved = self.system.solve(right)
        if len(rows) == 0:
            return solved
        at_rows = (rows * (self.barycentric @ solved)[index]).sum(axis=1)
        return solved - self._spread(index, rows * np.linalg.solve(matrix, at_rows)[:, None])
