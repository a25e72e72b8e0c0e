"""Apple's ARKit face shapes, and the paper's generic expressions as mixtures of them.

The table: row a of the weight matrix W (A, 52) says how strongly each ARKit shape takes part in expression a. For the
23 generic expressions the rows are ``FaceModel.generic_weights``, the same numbers that the generic expressions were
mixed from (``mouthSmileLeft`` is the ARKit shape of that name; ``browDown`` is browDownLeft + browDownRight;
``noseSneer`` adds 0.6 cheekSquint to each side; ...). An expression whose own name is an ARKit name is that shape. So
coefficients x (A,) become ARKit curves x W, and ARKit curves become coefficients by the bounded least squares
min |x W - a|^2 with 0 <= x <= 1.
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
# Keys are compared without case and separators; a trailing l or r stands for Left or Right.
_BY_KEY = {name.lower(): name for name in ARKIT_NAMES}
_BY_KEY |= {name.lower().replace("left", "l"): name for name in ARKIT_NAMES if name.endswith("Left")}
_BY_KEY |= {name.lower().replace("right", "r"): name for name in ARKIT_NAMES if name.endswith("Right")}
# ICT-FaceKit and others split three shapes that ARKit does not: their halves are driven by the whole.
_BY_KEY |= {whole.lower() + side: whole for whole in ("browInnerUp", "cheekPuff") for side in ("l", "r", "left", "right")}


def canonical_name(name: str) -> str | None:
    """The ARKit name that ``name`` stands for (any case, ``_L``/``Left``, separators), or None.

    >>> canonical_name("EYE_BLINK_L"), canonical_name("jaw-open"), canonical_name("frown")
    ('eyeBlinkLeft', 'jawOpen', None)
    """
    key = "".join(c for c in name.rsplit(".", 1)[-1].lower() if c.isalnum())
    return _BY_KEY.get(key) or _BY_KEY.get("".join(c for c in name.lower() if c.isalnum()))


@dataclass(frozen=True)
class ArkitWeights:
    """``matrix`` W (A, 52): rows follow ``names`` (A,), columns ``ARKIT_NAMES``; ``unknown``: names without a row."""

    names: tuple[str, ...]
    matrix: np.ndarray
    unknown: tuple[str, ...]

    def curves(self, coefficients: np.ndarray) -> np.ndarray:
        """(F, 52) ARKit curves in [0, 1] of coefficients (F, A); what adds up beyond 1 is clipped."""
        return np.clip(np.asarray(coefficients, float) @ self.matrix, 0.0, 1.0)

    def coefficients(self, curves: np.ndarray) -> np.ndarray:
        """(F, A) coefficients in [0, 1] whose curves come closest to ARKit curves (F, 52) (least squares)."""
        curves = np.asarray(curves, float)
        count = len(self.names)
        gram = self.matrix @ self.matrix.T + 1e-9 * np.eye(count)  # unknown names have zero rows and stay at zero
        lower, upper = np.zeros(count), np.ones(count)
        return np.array(
            [bounded_least_squares(gram, self.matrix @ row, lower, upper, sweeps=5000, tolerance=1e-10) for row in curves]
        ).reshape(len(curves), count)


def arkit_weights(names: Sequence[str], model: FaceModel | None = None) -> ArkitWeights:
    """The weight matrix of expressions ``names``: generic ones of the model (embedded by default) or ARKit names.

    Names that are neither are listed in ``unknown`` and have zero rows. Raises :class:`AdaptiveFaceError` when none of
    the names is known.
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
    """Generic expression of the embedded model -> its row (52,) of W."""
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
