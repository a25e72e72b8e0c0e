"""Exercise of notebook 04: one step of the coefficients' Kalman filter (section 4.2; Welch & Bishop 1995)."""

from __future__ import annotations

import numpy as np

from ..tracking.kalman import CoefficientFilter, FilterState
from ..tracking.stages import Stages
from .grading import Case, Exercise, Mistake, drawn, switched
from .pairs import close, packed


@drawn(seed=14, count=6)
def cases(rng: np.random.Generator, number: int) -> Case:
    """States with velocities, covariances with correlation, noises of different size."""
    a, root = int(rng.integers(3, 24)), rng.normal(size=(2, 2))
    return dict(
        state=rng.normal(size=(2, a)),
        covariance=root @ root.T + 0.1 * np.eye(2),
        measured=rng.normal(size=a),
        process_noise=float(rng.uniform(0.02, 0.2)),
        measurement_noise=float(rng.uniform(0.3, 0.9)),
    )


def kalman_step(
    state,
    covariance,
    measured,
    process_noise,
    measurement_noise,
    move=True,
    spread=True,
    noise=True,
    transpose=False,
    square=False,
    innovate=1.0,
    stale=False,
    update=True,
    blind=False,
    measured_only=False,
):
    """The package's answer, and by its switches what goes wrong."""
    f = np.array([[1.0, 1.0], [0.0, 1.0]])
    f = f.T if transpose else f
    q, r = (process_noise**2, measurement_noise**2) if square else (process_noise, measurement_noise)
    predicted = f @ state if move else state
    p = f @ covariance @ f.T if spread else covariance
    p = p + q * np.eye(2) if noise else p
    gain = p[:, 0] / (p[0, 0] + (0.0 if blind else r))
    gain = gain * [1.0, 0.0] if measured_only else gain
    new = predicted + innovate * np.outer(gain, measured - (state if stale else predicted)[0])
    return new, p - np.outer(gain, p[0]) if update else p


def parse(answer, case: Case) -> np.ndarray:
    """state and covariance, packed."""
    return packed(answer, (("state", case["state"].shape), ("covariance", (2, 2))))


def make_stages(function) -> Stages:
    """Stages with the learner's step in the filter (variances, time in frames)."""

    class Learners(CoefficientFilter):
        """The filter with the learner's step."""

        def correct(self, state, measured):
            """As the package's, by the learner's function."""
            noises = dict(process_noise=self.process_noise, measurement_noise=self.measurement_noise)
            return FilterState(*function(state=state.mean, covariance=state.covariance, measured=measured, **noises))

    return Stages(kalman=Learners)


def _swapped(state, covariance, measured, process_noise, measurement_noise):
    return kalman_step(state, covariance, measured, measurement_noise, process_noise)


_by = switched(kalman_step)
MISTAKES = (
    Mistake("the state is not moved on: predict with the transition before you correct", _by(move=False)),
    Mistake("the covariance is not moved on: it is F P F^T + Q after the prediction", _by(spread=False)),
    Mistake("the process noise is missing: the filter becomes ever surer and stops listening", _by(noise=False)),
    Mistake("the measurement noise is missing: the filter believes every measurement", _by(blind=True)),
    Mistake("process noise and measurement noise are swapped", _swapped),
    Mistake("the noises are squared: they are variances already", _by(square=True)),
    Mistake("the transition is transposed: a velocity moves the coefficient, not the other way round", _by(transpose=True)),
    Mistake("the sign of the correction is wrong: it goes away from the measurement", _by(innovate=-1.0)),
    Mistake("the measurement is compared with the old state instead of the predicted one", _by(stale=True)),
    Mistake("the covariance is not corrected: after a measurement the filter knows more", _by(update=False)),
    Mistake(
        "only the coefficient is corrected: the measurement says something about the velocity too", _by(measured_only=True)
    ),
    Mistake(
        "the measurement came back as the coefficients: the gain is below 1",
        lambda **c: (np.stack([c["measured"], kalman_step(**c)[0][1]]), kalman_step(**c)[1]),
    ),
)

KALMAN_STEP = Exercise(
    "kalman_step",
    "04_blendshape_fit",
    task=(
        "kalman_step(state, covariance, measured, process_noise, measurement_noise): state (2, A), the A coefficients and "
        "their velocities per frame; covariance (2, 2), the same for every coefficient; measured (A,); two variances -> "
        "(state, covariance) after the frame. The transition is [[1, 1], [0, 1]], the process noise is added to both entries "
        "of the covariance's diagonal, and only the coefficient is measured."
    ),
    hints=(
        "A Kalman filter has two halves. The first needs no measurement.",
        "Predict state and covariance with the transition and add the process noise. Then weigh prediction against "
        "measurement by their variances, and correct both state and covariance.",
        "x = F x, P = F P F^T + q I; k = P[:, 0] / (P[0, 0] + r); x <- x + k (z - x[0]), P <- P - k P[0].",
    ),
    mistakes=MISTAKES,
    cases=cases,
    truth=kalman_step,
    parse=parse,
    near=close,
    make_stages=make_stages,
)
