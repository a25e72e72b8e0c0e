"""Estimate the expression that the frames of a neutral scan still show, and remove it from the neutral.

People smile at cameras. A smile that is taken for the person's own face ruins the rig: it is missing in every smile, and calm
frames get its opposite. So the head is fitted with expression coefficients beside those of the identity
(:func:`~adaptiveface.neutral.fit.fit_identity`), the mesh is wrapped onto the scan as that is, and what the expression moved
is taken off again.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..geometry.expression_names import SCORE_NAMES
from ..geometry.frame import DetectedFace
from ..model.blendshapes import deformation_transfer
from ..model.face_model import FaceModel
from ..tracking.bounded import bounded_least_squares
from ..tracking.expression_prior import UPPER, expression_statistics
from .fuse import FusedScan

#: The detector's scores that show an expression, and their values on faces at rest (without Left and Right). Its scores of
#: brows, lids, pucker and chin differ more from person to person than from expression to expression.
TELLING = {
    "jawOpen": 0.3,
    "jawLeft": 0.3,
    "jawRight": 0.3,
    "mouthSmile": 0.3,
    "mouthUpperUp": 0.3,
    "mouthLowerDown": 0.3,
    "mouthFunnel": 0.3,
    "cheekPuff": 0.3,
    "noseSneer": 0.3,
    "mouthFrown": 0.5,
    "mouthStretch": 0.5,
}
_REST = np.array(
    [TELLING.get(name.removesuffix("Left").removesuffix("Right"), TELLING.get(name, np.inf)) for name in SCORE_NAMES]
)
#: Standard deviation of the coefficients of brows and lids, which the scores do not show.
UPPER_DEVIATION = 0.05


def expressiveness(face: DetectedFace | None) -> float:
    """Strength of the expression in the detector's scores: above 1 for more than a face at rest, 0 without scores."""
    return 0.0 if face is None or face.scores is None else float((face.scores / _REST).max())


def scored_coefficients(face: DetectedFace, model: FaceModel) -> np.ndarray:
    """Coefficients (A,) of the generic expressions that are closest to the detector's scores; zeros without scores."""
    if face.scores is None:
        return np.zeros(len(model.generic_weights))
    score = dict(zip(SCORE_NAMES, face.scores, strict=True))
    wanted = np.array([score.get(name, 0.0) for name in model.expression_names])
    gram = model.generic_weights @ model.generic_weights.T + 0.1 * np.eye(len(model.generic_weights))
    bounds = np.zeros(len(gram)), np.ones(len(gram))
    return bounded_least_squares(gram, model.generic_weights @ wanted, *bounds)


def untold(model: FaceModel) -> np.ndarray:
    """Standard deviations (A,) of coefficients without a score, from the values in a real take."""
    names, moments = expression_statistics()
    usual = dict(zip(names, np.sqrt(np.diag(moments)), strict=True))
    return np.array([UPPER_DEVIATION if n.startswith(UPPER) else usual.get(n, UPPER_DEVIATION) for n in model.generic_names])


@dataclass(frozen=True)
class ExpressionPrior:
    """Gaussian prior of the expression in a scan, with coefficients in [0, 1].

    The detector's scores give the start of the fit. A coefficient is as uncertain as it is strong.

    Attributes
    ----------
    shapes : (A, V, 3)
        Generic expressions of the average head, mm.
    mean, deviation : (A,)
        Of their coefficients.
    """

    shapes: np.ndarray
    mean: np.ndarray
    deviation: np.ndarray

    @classmethod
    def of(cls, scan: FusedScan, model: FaceModel) -> ExpressionPrior | None:
        """Make the prior from the detector's scores in the frames of the scan; None for a face at rest, or without scores."""
        faces = [features.face for features in scan.features if features is not None]
        scores = [face.scores for face in faces if face is not None and face.scores is not None]
        if not scores:
            return None
        middle = np.median(scores, axis=0)
        told = DetectedFace(np.zeros((0, 3)), np.where(middle > _REST, middle, 0.0))
        mean = scored_coefficients(told, model)
        return cls(model.generic_expressions, mean, np.maximum(mean, untold(model))) if mean.any() else None

    def solve(self, lhs: np.ndarray, rhs: np.ndarray, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Solve normal equations (n + A) for a step of n free unknowns, and for new coefficients (A,) instead of ``x``."""
        n = len(lhs) - len(x)
        eliminated = np.linalg.solve(lhs[:n, :n], np.column_stack([lhs[:n, n:], rhs[:n]]))
        h = lhs[n:, n:] - lhs[n:, :n] @ eliminated[:, :-1]
        g = rhs[n:] - lhs[n:, :n] @ eliminated[:, -1] + h @ x
        precision = self.deviation**-2.0
        found = bounded_least_squares(h + np.diag(precision), g + precision * self.mean, np.zeros(len(x)), np.ones(len(x)), x)
        return eliminated[:, -1] - eliminated[:, :-1] @ (found - x), found


def without_expression(model: FaceModel, identity: np.ndarray, expression: np.ndarray, scanned: np.ndarray) -> np.ndarray:
    """Remove an expression (A,) from a ``scanned`` head (V, 3), which ``identity`` (M,) fits best; returns (V, 3) mm.

    The change from the fitted head with the expression to the one without it is transferred to the scanned head.
    """
    if not expression.any():
        return scanned
    neutral = model.neutral(identity)
    expressive = neutral + np.tensordot(expression, model.generic_expressions, axes=1)
    relaxed: np.ndarray = scanned + deformation_transfer(expressive, scanned, model.triangles, (neutral - expressive)[None])[0]
    return relaxed
