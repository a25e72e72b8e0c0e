"""Exercise of notebook 09: coefficients solved once more from the final mesh (section 6)."""

from __future__ import annotations

import numpy as np
from scipy.optimize import lsq_linear

from .grading import Case, Exercise, Mistake, as_array, drawn


@drawn(seed=19, count=6)
def cases(rng: np.random.Generator, number: int) -> Case:
    """Few expressions at work, and motion that none of them holds."""
    a = int(rng.integers(5, 20))
    basis = rng.normal(size=(4 * a, a)) + 0.6 * rng.normal(size=(4 * a, 1))
    x = np.where(rng.random(a) < 0.4, rng.uniform(0.2, 1.2, a), 0.0)
    displacement = basis @ x + 1.2 * rng.normal(size=4 * a)
    weights = rng.uniform(0.6, 1.4) * np.linalg.norm(basis, axis=0)
    return dict(basis=basis, displacement=displacement, weights=weights)


def solve(basis, displacement, weights, lower=0.0, upper=1.0):
    """The exact minimum: the weights shift the right-hand side, the bounds hold (active set, Stark & Parker 1995)."""
    gram = basis.T @ basis
    factor = np.linalg.cholesky(gram).T
    right = np.linalg.solve(factor.T, basis.T @ displacement - weights)
    return lsq_linear(factor, right, (lower, upper), method="bvls", tol=1e-14).x


def parse(answer, case: Case) -> np.ndarray:
    """x (A,)."""
    return as_array(answer, case["weights"].shape, "x")


def near(a, b, case: Case) -> bool:
    """Same coefficients to 1e-4."""
    return bool(np.abs(a - b).max() < 1e-4)


def faults(answer, case: Case) -> list[str]:
    """Coefficients lie between 0 and 1."""
    if answer.min() < -1e-6 or answer.max() > 1 + 1e-6:
        return [f"the bounds are broken: coefficients from {answer.min():.3g} to {answer.max():.3g}, 0 to 1 is allowed"]
    return []


def _by(change, **bounds):
    return lambda basis, displacement, weights: solve(basis, displacement, change(weights), **bounds)


def _thresholded(basis, displacement, weights):
    x = solve(basis, displacement, 0 * weights)
    return np.clip(x - weights / (basis**2).sum(axis=0), 0, 1)


def _small_dropped(basis, displacement, weights):
    x = solve(basis, displacement, 0 * weights)
    return np.where(x < 0.1, 0.0, x)


def _ridge(basis, displacement, weights):
    stacked = np.vstack([basis, np.diag(np.sqrt(weights))])
    return lsq_linear(stacked, np.concatenate([displacement, 0 * weights]), (0, 1), method="bvls", tol=1e-14).x


def _clipped(basis, displacement, weights):
    gram = basis.T @ basis
    return np.clip(np.linalg.solve(gram, basis.T @ displacement - weights), 0, 1)


def _correlated(basis, displacement, weights):
    return np.clip((basis.T @ displacement - weights) / (basis**2).sum(axis=0), 0, 1)


MISTAKES = (
    Mistake(
        "the sparsity does not enter: motion that no expression holds is spread over many small coefficients",
        _by(lambda w: 0 * w),
    ),
    Mistake("the sign of the sparsity is wrong: it rewards coefficients", _by(np.negative)),
    Mistake(
        "the sparsity counts twice: the energy has half the square, so its slope is B^T (B x - d) + w", _by(lambda w: 2 * w)
    ),
    Mistake("the sparsity counts half: the square carries the factor one half, the weights do not", _by(lambda w: 0.5 * w)),
    Mistake("the weights are squared", _by(np.square)),
    Mistake(
        "every expression has the mean weight: large expressions must explain more", _by(lambda w: np.full(len(w), w.mean()))
    ),
    Mistake("the plain fit was lowered afterwards: once one coefficient falls, the others must make up for it", _thresholded),
    Mistake("small coefficients of the plain fit were set to 0: that is a threshold, not this minimum", _small_dropped),
    Mistake("the weights punish the squares: a ridge makes all coefficients smaller and none zero", _ridge),
    Mistake("the unbounded solution was clipped: once a coefficient stops at 0, the others must make up for it", _clipped),
    Mistake("each coefficient was fitted alone: the expressions overlap", _correlated),
    Mistake(
        "the upper bound is only clipped at the end; it must hold while the others are solved",
        lambda **c: np.clip(solve(**c, upper=np.inf), 0, 1),
    ),
)

RESOLVE = Exercise(
    "resolve",
    "09_retargeting",
    task=(
        "resolve(basis, displacement, weights): basis (m, A), the expressions as columns, displacement (m,) of v4 from the "
        "neutral, weights (A,) of the sparsity -> the coefficients x (A,), 0 <= x <= 1, that minimise |basis x - "
        "displacement|^2 / 2 + sum_k weights_k x_k."
    ),
    hints=(
        "For coefficients that are not negative, the sum of weights times coefficients is linear. What does that do to the "
        "slope?",
        "The weights only shift the right-hand side of the normal equations. What remains is the bounded problem of notebook "
        "04.",
        "minimise x^T H x / 2 - g^T x over 0 <= x <= 1 with H = B^T B and g = B^T d - w.",
    ),
    mistakes=MISTAKES,
    cases=cases,
    truth=solve,
    parse=parse,
    near=near,
    faults=faults,
    iterative=True,
)
