"""Exercise of notebook 05: the constant matrix of the Laplacian deformation, and its solution (equations 5 to 7)."""

from __future__ import annotations

import numpy as np

from .grading import Case, Exercise, Mistake, as_array, drawn, switched
from .pairs import close


@drawn(seed=16, count=6)
def cases(rng: np.random.Generator, number: int) -> Case:
    """Laplacians that are not symmetric, as one restricted to a region is not; weights of different size."""
    n = int(rng.integers(8, 30))
    weights = rng.uniform(0.2, 1.5, (n, n)) * (rng.random((n, n)) < 0.4)
    laplacian = np.diag(weights.sum(axis=1) + 0.3) - weights
    return dict(
        laplacian=laplacian,
        w1=float(rng.uniform(0.05, 0.4)),
        w2=float(rng.uniform(1.5, 6.0)),
        targets=rng.normal(size=(n, 3)),
    )


def solve_deformation(laplacian, w1, w2, targets, smooth=None, data=None, right=None):
    """The package's answer, and by its switches what goes wrong."""
    smooth = w2 * laplacian.T @ laplacian if smooth is None else smooth(laplacian, w2)
    data = w1 if data is None else data(w1)
    right = data * targets if right is None else right(laplacian, w1, targets)
    return np.linalg.lstsq(data * np.eye(len(targets)) + smooth, right, rcond=None)[0]


def parse(answer, case: Case) -> np.ndarray:
    """d (n, 3)."""
    return as_array(answer, case["targets"].shape, "d")


_by = switched(solve_deformation)
MISTAKES = (
    Mistake("L instead of L^T L: the energy is the square of L d", _by(smooth=lambda m, w: w * m)),
    Mistake("L L^T instead of L^T L: they differ where L is not symmetric", _by(smooth=lambda m, w: w * m @ m.T)),
    Mistake("L L instead of L^T L: they differ where L is not symmetric", _by(smooth=lambda m, w: w * m @ m)),
    Mistake("w2 enters squared: it is an energy weight", _by(smooth=lambda m, w: w**2 * m.T @ m)),
    Mistake(
        "the square root of w2 enters: that is right for rows, in L^T L it is w2 itself",
        _by(smooth=lambda m, w: w**0.5 * m.T @ m),
    ),
    Mistake("w2 does not enter", _by(smooth=lambda m, w: m.T @ m)),
    Mistake("w1 enters squared: it is an energy weight", _by(data=np.square)),
    Mistake("the square root of w1 enters: that is right for rows, in the normal equations it is w1 itself", _by(data=np.sqrt)),
    Mistake("w1 does not enter", _by(data=lambda w: 1.0)),
    Mistake("w1 is missing on the right-hand side: both sides come from the same derivative", _by(right=lambda m, w, t: t)),
    Mistake("w1 and w2 are swapped", lambda laplacian, w1, w2, targets: solve_deformation(laplacian, w2, w1, targets)),
    Mistake("the sign of the right-hand side is wrong", lambda **c: -solve_deformation(**c)),
    Mistake("the targets themselves came back: nothing was smoothed", lambda **c: c["targets"]),
    Mistake(
        "the targets are smoothed by the matrix instead of by its inverse",
        lambda laplacian, w1, w2, targets: (w1 * np.eye(len(targets)) + w2 * laplacian.T @ laplacian) @ targets,
    ),
)

SOLVE_DEFORMATION = Exercise(
    "solve_deformation",
    "05_laplacian_deformation",
    task=(
        "solve_deformation(laplacian, w1, w2, targets): laplacian (n, n), two energy weights and the displacements (n, 3) "
        "that the depth asks for -> the displacements d (n, 3) that minimise w1 |d - targets|^2 + w2 |laplacian d|^2. The "
        "matrix is the same in every frame; factorise it (scipy.linalg.cho_factor) rather than invert it."
    ),
    hints=(
        "Both terms are squares that are linear in d, so that the minimum is the solution of a linear system.",
        "Set half the derivative to zero and sort: what multiplies d is a constant symmetric matrix, the rest is the "
        "right-hand side. All three coordinates share the matrix.",
        "(w1 I + w2 L^T L) d = w1 targets; cho_solve(cho_factor(A), w1 * targets).",
    ),
    mistakes=MISTAKES,
    cases=cases,
    truth=solve_deformation,
    parse=parse,
    near=close,
)
