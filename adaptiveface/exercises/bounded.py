"""Exercise of notebook 04: the bounded solver of the blendshape coefficients (section 4.2; Sugimoto et al. 1995)."""

from __future__ import annotations

import functools

import numpy as np
from scipy.optimize import lsq_linear

from ..tracking.expression import BlendshapeFit
from ..tracking.stages import Stages
from .grading import Case, Exercise, Mistake, Wrong, as_array, drawn


@drawn(seed=4, count=8)
def cases(rng: np.random.Generator, number: int) -> Case:
    """Correlated normal equations with none, some or many bounds active; later ones with bounds other than 0, 1."""
    a = int(rng.integers(4, 24))
    jacobian = rng.normal(size=(3 * a, a)) + 0.8 * rng.normal(size=(3 * a, 1))
    wanted = rng.uniform(-0.8, 1.8, a) if number else rng.uniform(0.2, 0.8, a)
    lower, upper = np.zeros(a), np.ones(a)
    if number >= 4:
        lower, upper = rng.uniform(-0.5, -0.1, a), rng.uniform(0.3, 1.5, a)
    return dict(h=jacobian.T @ jacobian, g=jacobian.T @ jacobian @ wanted, lower=lower, upper=upper)


def truth(h, g, lower, upper):
    """The exact minimum by an active-set method (Stark & Parker 1995), on the Cholesky factor of h."""
    factor = np.linalg.cholesky(h).T
    return lsq_linear(factor, np.linalg.solve(factor.T, g), (lower, upper), method="bvls", tol=1e-14).x


def parse(answer, case: Case) -> np.ndarray:
    """x (A,)."""
    if isinstance(answer, np.ndarray) and answer.shape == (len(case["g"]), 1):
        raise Wrong("x has the wrong shape: a column (A, 1) came back, a vector (A,) is expected")
    return as_array(answer, (len(case["g"]),), "x")


def faults(answer, case: Case) -> list[str]:
    """The bounds must hold."""
    for name, excess in (("upper", answer - case["upper"]), ("lower", case["lower"] - answer)):
        if excess.max() > 1e-6:
            k = int(excess.argmax())
            return [
                f"the {name} bound is broken: x[{k}] = {answer[k]:.3g}, its bounds are "
                f"{case['lower'][k]:.3g} and {case['upper'][k]:.3g}"
            ]
    return []


def near(a, b, case: Case) -> bool:
    """Same coefficients to 1e-4."""
    return bool(np.abs(a - b).max() < 1e-4)


def describe(answer, expected, case: Case) -> str:
    """Which coefficient could still lower the energy (the optimality conditions of the bounded problem)."""
    slope = case["h"] @ answer - case["g"]
    down, up = answer > case["lower"] + 1e-9, answer < case["upper"] - 1e-9
    gain = np.where((slope > 0) & down, slope, 0) - np.where((slope < 0) & up, slope, 0)
    k = int(gain.argmax())
    where = "lies between its bounds" if down[k] and up[k] else "sits on a bound that it should leave"
    return (
        f"not the minimum: x[{k}] = {answer[k]:.4g} {where}, yet the energy's slope there is {slope[k]:.3g} instead of 0 (the "
        f"minimum has {expected[k]:.4g}); not converged, or a bound that was set is never released"
    )


def make_stages(function) -> Stages:
    """Stages with the learner's solver in the blendshape fit and in the re-solve of the coefficients."""

    def solver(h, g, lower, upper, start=None):
        return as_array(function(h=h, g=g, lower=lower, upper=upper), g.shape, "x")

    return Stages(blendshapes=functools.partial(BlendshapeFit, solver=solver))


def _clipped(h, g, lower, upper):
    return np.clip(np.linalg.solve(h, g), lower, upper)


def _wrong_sign(h, g, lower, upper):
    return truth(h, -g, lower, upper)


def _one_bound(side):
    def answer(h, g, lower, upper):
        free = np.full(len(g), np.inf)
        return np.clip(truth(h, g, *((lower, free) if side == "lower" else (-free, upper))), lower, upper)

    return answer


def _never_released(h, g, lower, upper):
    """Fix what leaves its bounds, solve the others again, until all hold; nothing is ever freed."""
    x, free = np.clip(np.linalg.solve(h, g), lower, upper), np.ones(len(g), bool)
    solution = np.linalg.solve(h, g)
    while True:
        outside = free & ((solution < lower) | (solution > upper))
        if not outside.any():
            x[free] = solution[free]
            return x
        x[outside] = np.clip(solution[outside], lower[outside], upper[outside])
        free &= ~outside
        if free.any():
            solution[free] = np.linalg.solve(h[np.ix_(free, free)], g[free] - h[np.ix_(free, ~free)] @ x[~free])


def _diagonal(h, g, lower, upper):
    return np.clip(g / np.diag(h), lower, upper)


def _zero_to_one(h, g, lower, upper):
    return truth(h, g, np.zeros(len(g)), np.ones(len(g)))


MISTAKES = (
    Mistake(
        "the unbounded solution was clipped instead of bounded: once a coefficient stops at its bound, the others must make up "
        "for it",
        _clipped,
    ),
    Mistake("the sign of g is wrong: the energy is x^T h x / 2 - g^T x, its slope h x - g", _wrong_sign),
    Mistake("the unbounded solution: the bounds do not enter at all", lambda h, g, lower, upper: np.linalg.solve(h, g)),
    Mistake("0 and 1 are used as the bounds, whatever lower and upper say", _zero_to_one),
    Mistake("the upper bound is only clipped at the end; it must hold while the others are solved", _one_bound("lower")),
    Mistake("the lower bound is only clipped at the end; it must hold while the others are solved", _one_bound("upper")),
    Mistake(
        "a coefficient that was set to a bound is never released again: check the slope's sign at the bounds",
        _never_released,
    ),
    Mistake("only the diagonal of h enters: the coefficients interact", _diagonal),
    Mistake(
        "the half is missing: the slope of x^T h x / 2 is h x, not 2 h x",
        lambda h, g, lower, upper: truth(2 * h, g, lower, upper),
    ),
    Mistake(
        "something was added to the diagonal of h: the ridge is in h already",
        lambda h, g, lower, upper: truth(h + np.diag(np.diag(h)), g, lower, upper),
    ),
)

BOUNDED_LEAST_SQUARES = Exercise(
    "bounded_least_squares",
    "04_blendshape_fit",
    task=(
        "bounded_least_squares(h, g, lower, upper): h (A, A) symmetric positive definite, g, lower, upper (A,) -> x (A,) that "
        "minimises x^T h x / 2 - g^T x with lower <= x <= upper."
    ),
    hints=(
        "Hold all coefficients but one. Where is the minimum over that one, and where is its best allowed value?",
        "Go through the coefficients one by one, move each to the minimum over it alone and from there to the nearest bound. "
        "Repeat until none moves any more.",
        "x_i <- clip(x_i + (g_i - h_i . x) / h_ii, lower_i, upper_i), for all i, again and again.",
    ),
    mistakes=MISTAKES,
    cases=cases,
    truth=truth,
    parse=parse,
    near=near,
    describe=describe,
    make_stages=make_stages,
    faults=faults,
    iterative=True,
)
