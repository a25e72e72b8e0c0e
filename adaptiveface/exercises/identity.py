"""Exercise of notebook 01: a Gauss-Newton step of the maximum a posteriori identity fit (Blanz & Vetter 1999)."""

from __future__ import annotations

import numpy as np

from .grading import Case, Exercise, Mistake, as_array, drawn, switched
from .pairs import close


@drawn(seed=12, count=6)
def cases(rng: np.random.Generator, number: int) -> Case:
    """Few or many distances, so that the prior decides much or little."""
    k = int(rng.integers(4, 20))
    m = int(rng.integers(k // 2, 6 * k))
    return dict(
        jacobian=rng.normal(size=(m, k)),
        distances=rng.normal(size=m),
        identity=rng.normal(size=k),
        sigma=float(rng.choice([0.4, 0.7, 1.6, 2.5])),
    )


def identity_step(jacobian, distances, sigma, identity, prior=1.0, pull=1.0, data=None, sign=-1.0, whole=False):
    """The package's answer, and by its switches what goes wrong."""
    data = 1.0 / sigma**2 if data is None else data(sigma)
    h = data * jacobian.T @ jacobian + prior * np.eye(len(identity))
    g = sign * data * jacobian.T @ distances - pull * identity
    change = np.linalg.lstsq(h, g, rcond=None)[0]
    return identity + change if whole else change


def parse(answer, case: Case) -> np.ndarray:
    """The change (k,)."""
    return as_array(answer, case["identity"].shape, "the change")


def _scaled_prior(jacobian, distances, sigma, identity):
    return identity_step(jacobian, distances, sigma, identity, prior=sigma**2, pull=sigma**2)


_by = switched(identity_step)
MISTAKES = (
    Mistake("the prior is missing: where the scan says little, coefficients grow without bound", _by(prior=0.0, pull=0.0)),
    Mistake(
        "the prior pulls the change to 0 instead of the coefficients: identity must enter the right-hand side",
        _by(pull=0.0),
    ),
    Mistake("the prior is on the right-hand side only: it must be added to the matrix too", _by(prior=0.0)),
    Mistake("the sign of the prior's pull is wrong: it drives the coefficients away from 0", _by(pull=-1.0)),
    Mistake("sigma enters once instead of squared", _by(data=lambda s: 1.0 / s)),
    Mistake("sigma does not enter: the distances count as if their deviation were 1 mm", _by(data=lambda s: 1.0)),
    Mistake("the distances are multiplied by sigma^2 instead of divided", _by(data=lambda s: s**2)),
    Mistake("the sign of the data is wrong: the step must make the distances smaller", _by(sign=1.0)),
    Mistake("the new coefficients came back: the change is asked for", _by(whole=True)),
    Mistake("both halves have the wrong sign: the step goes uphill", lambda **c: -identity_step(**c)),
    Mistake("the prior is divided by the data's variance a second time", _scaled_prior),
    Mistake(
        "only the diagonal of the matrix enters: the modes are not independent on a scan",
        lambda **c: (
            -(c["jacobian"].T @ c["distances"] / c["sigma"] ** 2 + c["identity"])
            / ((c["jacobian"] ** 2).sum(axis=0) / c["sigma"] ** 2 + 1.0)
        ),
    ),
)

IDENTITY_STEP = Exercise(
    "identity_step",
    "01_neutral_scan",
    task=(
        "identity_step(jacobian, distances, sigma, identity): jacobian (m, k) of m point-to-plane distances (m,) mm by k "
        "identity coefficients, sigma the standard deviation of a distance in mm, identity (k,) the present coefficients in "
        "standard deviations -> the change (k,) that minimises |distances + jacobian change|^2 / sigma^2 + |identity + "
        "change|^2."
    ),
    hints=(
        "Both terms are squares that are linear in the change. What is the derivative of each?",
        "Set the derivative of the sum to zero. The prior speaks about identity + change, so it adds to the matrix and to the "
        "right-hand side.",
        "(J^T J / sigma^2 + I) change = -(J^T distances / sigma^2 + identity).",
    ),
    mistakes=MISTAKES,
    cases=cases,
    truth=identity_step,
    parse=parse,
    near=close,
)
