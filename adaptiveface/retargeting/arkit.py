"""Convert between coefficients of expressions and curves of Apple's ARKit face shapes.

Row a of the weight matrix W (A, 52) tells how strongly each ARKit shape takes part in expression a. For the 23 generic
expressions, the rows are ``FaceModel.generic_weights``, of which the expressions themselves are mixed: ``mouthSmileLeft`` is
the ARKit shape of that name, ``browDown`` is browDownLeft + browDownRight, ``noseSneer`` adds 0.6 cheekSquint on each side,
and so on. An expression with an ARKit name is that shape. Coefficients x (A,) become ARKit curves x W. ARKit curves a (52,)
become coefficients by the bounded least-squares problem min |x W - a|^2 with 0 <= x <= 1.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from ..errors import AdaptiveFaceError
from ..livelink import ARKIT_NAMES
from ..model.face_model import FaceModel, embedded_face_model
from ..tracking.bounded import bounded_least_squares

_NUMBER = {name: number for number, name in enumerate(ARKIT_NAMES)}
# Keys have neither capitals nor separators. A trailing l or r stands for Left or Right.
_BY_KEY = {name.lower(): name for name in ARKIT_NAMES}
_BY_KEY |= {name.lower().replace("left", "l"): name for name in ARKIT_NAMES if name.endswith("Left")}
_BY_KEY |= {name.lower().replace("right", "r"): name for name in ARKIT_NAMES if name.endswith("Right")}
# ICT-FaceKit and others split shapes that ARKit does not split. The whole drives both halves.
_BY_KEY |= {whole.lower() + side: whole for whole in ("browInnerUp", "cheekPuff") for side in ("l", "r", "left", "right")}


def canonical_name(name: str) -> str | None:
    """The ARKit name that ``name`` stands for, or None. Case, separators, and ``_L`` for ``Left`` do not matter.

    >>> canonical_name("EYE_BLINK_L"), canonical_name("jaw-open"), canonical_name("frown")
    ('eyeBlinkLeft', 'jawOpen', None)
    """
    key = "".join(c for c in name.rsplit(".", 1)[-1].lower() if c.isalnum())
    return _BY_KEY.get(key) or _BY_KEY.get("".join(c for c in name.lower() if c.isalnum()))


@dataclass(frozen=True)
class ArkitWeights:
    """The weights of ARKit's shapes in A expressions.

    Attributes
    ----------
    names : (A,)
        Names of the expressions.
    matrix : (A, 52)
        W, with a row per expression and a column for each of ``ARKIT_NAMES``.
    unknown : tuple of str
        Expressions whose rows are zero, because their names are not known.
    """

    names: tuple[str, ...]
    matrix: np.ndarray
    unknown: tuple[str, ...]

    def curves(self, coefficients: np.ndarray) -> np.ndarray:
        """(F, 52) ARKit curves in [0, 1] of coefficients (F, A). Sums above 1 are clipped."""
        return np.clip(np.asarray(coefficients, float) @ self.matrix, 0.0, 1.0)

    def coefficients(self, curves: np.ndarray) -> np.ndarray:
        """(F, A) coefficients in [0, 1] whose curves are closest to ARKit curves (F, 52) in the least-squares sense."""
        curves = np.asarray(curves, float)
        count = len(self.names)
        gram = self.matrix @ self.matrix.T + 1e-9 * np.eye(
            count
        )  # the rows of unknown names are zero, and so are their coefficients
        lower, upper = np.zeros(count), np.ones(count)
        return np.array(
            [bounded_least_squares(gram, self.matrix @ row, lower, upper, sweeps=5000, tolerance=1e-10) for row in curves]
        ).reshape(len(curves), count)


def arkit_weights(names: Sequence[str], model: FaceModel | None = None) -> ArkitWeights:
    """The weight matrix of expressions.

    Parameters
    ----------
    names : sequence of str
        Names of the model's generic expressions, or ARKit names. Others are listed as ``unknown``, and their rows are zero.
    model : FaceModel, optional
        By default, the embedded model.

    Raises
    ------
    AdaptiveFaceError
        None of the names is known.
    """
    generic = generic_rows() if model is None else _rows(model)
    matrix = np.zeros((len(names), len(ARKIT_NAMES)))
    unknown = []
    for row, name in zip(matrix, names, strict=True):
        if name in generic:
            row[:] = generic[name]
        elif known := canonical_name(name):
            row[_NUMBER[known]] = 1.0
        else:
            unknown.append(name)
    if len(unknown) == len(names):
        raise AdaptiveFaceError(f"none of the expressions {', '.join(names)[:200]} is known; ARKit names are expected")
    return ArkitWeights(tuple(names), matrix, tuple(unknown))


@lru_cache(maxsize=1)
def generic_rows() -> dict[str, np.ndarray]:
    """The row (52,) of W by name of the embedded model's generic expression."""
    return _rows(embedded_face_model())


def _rows(model: FaceModel) -> dict[str, np.ndarray]:
    columns = [canonical_name(name) for name in model.expression_names]
    rows = {}
    for name, weights in zip(model.generic_names, model.generic_weights, strict=True):
        rows[name] = np.zeros(len(ARKIT_NAMES))
        for column, weight in zip(columns, weights, strict=True):
            if column:
                rows[name][_NUMBER[column]] += weight
    return rows


def weight_table(model: FaceModel | None = None) -> str:
    """The matrix of the 23 generic expressions as a Markdown table, for the documentation."""
    lines = ["| generic expression | ARKit shapes |", "|---|---|"]
    for name, row in (generic_rows() if model is None else _rows(model)).items():
        mixture = " + ".join(f"{row[i]:.3g} {ARKIT_NAMES[i]}" for i in np.flatnonzero(row))
        lines.append(f"| {name} | {mixture} |")
    return "\n".join(lines)
