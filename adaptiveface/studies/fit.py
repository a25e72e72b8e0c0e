"""Look at one frame's blendshape fit as a linear system, and at the jitter and the lag of its filter (section 4.2)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..geometry.frame import RgbdFrame
from ..geometry.mesh import vertex_normals
from ..model.actor import Actor
from ..parameters import BlendshapeParameters, DepthParameters, KalmanParameters
from ..registration.association import find_correspondences
from ..registration.surface import crop_window, depth_surface
from ..tracking.bounded import bounded_least_squares
from ..tracking.feature_rows import feature_rows
from ..tracking.kalman import CoefficientFilter
from ..tracking.types import TrackedFrame


@dataclass(frozen=True)
class FitProblem:
    """Equations (1) and (2) of one frame: minimise x^T H x / 2 - g^T x with 0 <= x <= 1.

    Attributes
    ----------
    h : (A, A)
        The normal equations' matrix H.
    g : (A,)
        Their right-hand side.
    """

    h: np.ndarray
    g: np.ndarray

    def energy(self, x: np.ndarray) -> float:
        """Energy of coefficients (A,), up to a constant."""
        return float(0.5 * x @ self.h @ x - self.g @ x)

    def unbounded(self) -> np.ndarray:
        """The minimum (A,) without bounds."""
        return np.linalg.solve(self.h, self.g)

    def clipped(self) -> np.ndarray:
        """The unbounded minimum, clipped to [0, 1]: a shortcut that is not the bounded minimum, (A,)."""
        return np.clip(self.unbounded(), 0, 1)

    def bounded(self) -> np.ndarray:
        """The minimum (A,) within the bounds (section 4.2)."""
        return bounded_least_squares(self.h, self.g, np.zeros(len(self.g)), np.ones(len(self.g)))


def fit_problem(actor: Actor, frame: RgbdFrame, result: TrackedFrame, parameters: BlendshapeParameters) -> FitProblem:
    """Build the last linear system of a frame's fit, from the rows of equations (1) and (2).

    This is written for reading, without the robust weights and the joint pose of ``tracking/expression.py``.

    Parameters
    ----------
    actor : Actor
        The performer's rig.
    frame : RgbdFrame
        With depth and features.
    result : TrackedFrame
        Of that frame; its pose and coefficients are where the rows are taken.
    parameters : BlendshapeParameters
        w, the ridge and the largest distance of matches are used.

    Returns
    -------
    FitProblem
        The normal equations.
    """
    keep = actor.frontal & actor.depth_valid
    rotation = result.head_pose[:3, :3]
    x = result.coefficients_initial
    # The rows belong to the actor's own basis. With personal blendshapes, v1 is another shape.
    moved = np.tensordot(x, actor.blendshapes[: len(x)], axes=1)
    in_camera = result.in_camera(actor.neutral + moved)
    window = crop_window(frame.camera, frame.camera.project(in_camera[keep]), 20.0)
    surface = depth_surface(frame.depth, frame.camera, window, DepthParameters())
    normals = vertex_normals(in_camera, actor.triangles)
    matches = find_correspondences(surface, in_camera[keep], normals[keep], parameters.max_correspondence_distance)
    used = matches.weights > 0
    # Eq. (1): n^T (b0 + B x - p) = distance + n^T B (x - x_now), with everything in the head frame.
    planes = matches.normals[used] @ rotation
    basis = actor.blendshapes[:, keep][:, used]
    depth_rows = np.einsum("nd,and->na", planes, basis)
    depth_right = np.einsum("nd,nd->n", planes, moved[keep][used]) - matches.distances[used]
    # Eq. (2): [1 0 -u; 0 1 -v] P (R (f0 + F x) + t) for every visible feature.
    rows = feature_rows(frame.features, frame.camera, result.head_pose)
    corners, shares = actor.feature_triangles[rows.index], actor.feature_weights[rows.index]
    rest = np.einsum("fk,fkd->fd", shares, actor.neutral[corners])
    moves = np.einsum("fk,afkd->fda", shares, actor.blendshapes[:, corners])
    feature_rows_ = (rows.rows @ moves).reshape(-1, len(actor.blendshapes))
    feature_right = -(np.einsum("fij,fj->fi", rows.rows, rest) + rows.offsets).ravel()
    h = depth_rows.T @ depth_rows + parameters.w * feature_rows_.T @ feature_rows_
    h += (parameters.ridge + 1e-6) * np.eye(len(h))
    return FitProblem(h, depth_rows.T @ depth_right + parameters.w * feature_rows_.T @ feature_right)


def fitted_coefficients(results: Sequence[TrackedFrame]) -> np.ndarray:
    """Coefficients (F, A) of section 4.2 of all tracked frames."""
    return np.array([result.coefficients_initial for result in results if result.tracked])


def liveliest(coefficients: np.ndarray, count: int = 4) -> np.ndarray:
    """Numbers (count,) of the expressions whose coefficients (F, A) have the widest range, the widest first."""
    return np.argsort(-np.ptp(coefficients, axis=0))[:count]


def filtered(measured: np.ndarray, parameters: KalmanParameters) -> np.ndarray:
    """Filter measured coefficients (F, A) with the Kalman filter; returns (F, A)."""
    kalman = CoefficientFilter(parameters)
    return np.array([kalman.update(row) for row in measured])


def jitter(x: np.ndarray) -> float:
    """How much coefficients (F, A) tremble: root mean square of their second difference over the frames."""
    return float(np.sqrt((np.diff(x, 2, axis=0) ** 2).mean()))


def lag(output: np.ndarray, measured: np.ndarray, most: int = 30) -> int:
    """Number of frames by which ``output`` (F, A) trails ``measured`` (F, A): the shift with the largest correlation."""
    output, measured = output - output.mean(axis=0), measured - measured.mean(axis=0)

    def correlation(shift: int) -> float:
        late, early = output[shift:], measured[: len(measured) - shift]
        return float((late * early).sum() / max(np.linalg.norm(late) * np.linalg.norm(early), 1e-12))

    return int(np.argmax([correlation(shift) for shift in range(min(most, len(measured) // 3) + 1)]))
