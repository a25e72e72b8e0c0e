"""Exercise of notebook 05: one Gauss-Newton step of the brightness constancy (Lucas & Kanade 1981), at an edge too."""

from __future__ import annotations

import numpy as np

from .grading import Case, Exercise, Mistake, Wrong, as_array, drawn
from .pairs import close


@drawn(seed=11, count=6)
def random_cases(rng: np.random.Generator, number: int) -> Case:
    """Patches with a shift, noise and outliers of little weight; in every other one all gradients are nearly parallel."""
    n = int(rng.integers(30, 120))
    gradients = rng.normal(0, 6, (n, 2)) * rng.uniform(0.5, 1.5, 2)
    if number % 2:  # an edge: the aperture problem
        angle = rng.uniform(0.3, 1.2)
        gradients = rng.normal(0, 6, (n, 1)) * np.array([np.cos(angle), np.sin(angle)]) + rng.normal(0, 0.02, (n, 2))
    shift, known = rng.uniform(0.4, 1.2, 2) * rng.choice([-1, 1], 2), rng.uniform(80, 160, n)
    picture = known - gradients @ shift + rng.normal(0, 0.5, n)
    weights = rng.uniform(0.3, 1.0, n)
    outliers = rng.random(n) < 0.2
    picture[outliers] += 25.0
    weights[outliers] *= 0.05
    return dict(picture=picture, known=known, gradients=gradients, weights=weights, rest=float(rng.uniform(20, 60)))


def solve(picture, known, gradients, weights, rest) -> np.ndarray:
    """The shift (2,), px."""
    matrix = gradients.T @ (weights[:, None] * gradients) + rest * np.eye(2)
    shift: np.ndarray = np.linalg.solve(matrix, gradients.T @ (weights * (known - picture)))
    return shift


def parse(answer, case: Case) -> np.ndarray:
    """Two numbers."""
    answer = np.asarray(answer)
    if answer.shape == case["picture"].shape:
        raise Wrong(f"{len(answer)} numbers came back: all samples of the patch share one shift (2,)")
    return as_array(answer, (2,), "the shift")


def _with(**changes):
    """The solution on a case in which ``changes``, functions of the whole case, have replaced some of the inputs."""
    return lambda **case: solve(**{**case, **{name: change(case) for name, change in changes.items()}})


def _parts(case):
    g, w = case["gradients"], case["weights"]
    return g, w, case["known"] - case["picture"], case["rest"] * np.eye(2)


def _weights_on_the_left(**case):
    g, w, r, rest = _parts(case)
    return np.linalg.solve(g.T @ (w[:, None] * g) + rest, g.T @ r)


def _weights_on_the_right(**case):
    g, w, r, rest = _parts(case)
    return np.linalg.solve(g.T @ g + rest, g.T @ (w * r))


def _descent(**case):
    g, w, r, _ = _parts(case)
    return g.T @ (w * r)


def _apart(**case):
    g, w, r, rest = _parts(case)
    return (g.T @ (w * r)) / np.diag(g.T @ (w[:, None] * g) + rest)


def _single(**case):
    g, w, r, _ = _parts(case)
    steps = (r / (g**2).sum(axis=1))[:, None] * g
    return np.average(steps, axis=0, weights=w)


def _mean(**case):
    g, w, r, rest = _parts(case)
    return np.linalg.solve(g.T @ (w[:, None] * g) / len(g) + rest, g.T @ (w * r) / len(g))


def _unit(case):
    return case["gradients"] / np.linalg.norm(case["gradients"], axis=1, keepdims=True)


MISTAKES = (
    Mistake(
        "the sign is wrong: where the picture is darker than known and brightens along u, the shift goes along u",
        lambda **case: -solve(**case),
    ),
    Mistake(
        "rest does not enter: along an edge nothing holds the shift, and noise decides it (the aperture problem)",
        _with(rest=lambda case: 0.0),
    ),
    Mistake("rest enters squared, or as a row that is not scaled by its root", _with(rest=lambda case: case["rest"] ** 2)),
    Mistake("rest enters as its square root", _with(rest=lambda case: case["rest"] ** 0.5)),
    Mistake("a weight is missing: outliers pull as hard as skin", _with(weights=lambda case: np.ones(len(case["weights"])))),
    Mistake(
        "the weight enters squared: scale rows by sqrt(w), or use it once", _with(weights=lambda case: case["weights"] ** 2)
    ),
    Mistake("the weights are in the matrix only, not on the right-hand side", _weights_on_the_left),
    Mistake("the weights are on the right-hand side only, not in the matrix", _weights_on_the_right),
    Mistake("u and v are exchanged", lambda **case: solve(**case)[::-1]),
    Mistake("this is a step of gradient descent: the matrix sum w g g^T + rest I is missing", _descent),
    Mistake("u and v are solved apart: the matrix has an off-diagonal", _apart),
    Mistake("every sample was given a shift of its own, and the mean was taken: one sample knows one direction only", _single),
    Mistake("means were taken instead of sums, so that rest weighs n times as much", _mean),
    Mistake("the gradients were scaled to unit length: strong edges know more than weak ones", _with(gradients=_unit)),
    Mistake("half the step came back: the derivative of a square is 2, on both sides", lambda **case: 0.5 * solve(**case)),
)

BRIGHTNESS_STEP = Exercise(
    "brightness_step",
    "05_laplacian_deformation",
    task=(
        "brightness_step(picture, known, gradients, weights, rest): what the picture shows at n samples and what is known of "
        "their skin (n,), the picture's gradients (n, 2) per px along u and v, weights (n,), rest a number -> the shift d "
        "(2,) px that minimises sum_q w_q (picture_q + gradients_q . d - known_q)^2 + rest |d|^2."
    ),
    hints=(
        "How does one sample's difference change when the shift grows by a little along u? That is its row. How many unknowns "
        "do all samples share?",
        "Set the derivative of the energy to zero: a 2 x 2 system, with the sum of weighted outer products of the gradients, "
        "and rest on its diagonal.",
        "(sum w g g^T + rest I) d = sum w g (known - picture).",
    ),
    mistakes=MISTAKES,
    cases=random_cases,
    truth=solve,
    parse=parse,
    near=close,
)
