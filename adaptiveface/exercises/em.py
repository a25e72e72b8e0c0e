"""Exercise of notebook 06: one EM step of the incremental PCA, with its QR (section 5; Roweis 1998)."""

from __future__ import annotations

import functools

import numpy as np

from ..parameters import Parameters
from ..tracking.adaptive_pca import AdaptiveModel, e_step, m_step
from ..tracking.stages import Stages
from .grading import Case, Exercise, Mistake, Wrong, as_array, drawn, scale_hint


@drawn(seed=6, count=6)
def cases(rng: np.random.Generator, number: int) -> Case:
    """Samples with a decaying spectrum and a mean, guesses of M that are orthonormal in every other case."""
    d, k, s = 3 * int(rng.integers(20, 80)), int(rng.integers(2, 8)), int(rng.integers(12, 40))
    shapes = np.linalg.qr(rng.normal(size=(d, s)))[0]
    samples = shapes @ (rng.normal(size=(s, s)) * np.geomspace(20, 2, s)[:, None]) + 3 * shapes[:, :1]
    guess = samples[:, :k] + rng.normal(size=(d, k))
    return dict(correctives=guess if number % 2 == 0 else np.linalg.qr(guess)[0], samples=samples)


def truth(correctives, samples):
    """The package's answer."""
    y = e_step(correctives, samples)
    return y, np.linalg.qr(m_step(samples, y))[0]


def parse(answer, case: Case) -> tuple[np.ndarray, np.ndarray]:
    """(Y (k, s), M (d, k))."""
    if not isinstance(answer, (tuple, list)) or len(answer) != 2:
        raise Wrong("a pair (Y, M) is expected")
    (d, k), s = case["correctives"].shape, case["samples"].shape[1]
    return as_array(answer[0], (k, s), "Y"), as_array(answer[1], (d, k), "M")


def faults(answer, case: Case) -> list[str]:
    """M's columns must be orthonormal: EM alone does not keep them so."""
    gram = answer[1].T @ answer[1]
    if np.abs(np.diag(gram) - 1).max() > 1e-6:
        return [
            f"M is not orthonormal: its columns have lengths up to {np.sqrt(np.diag(gram).max()):.3g} instead of 1; end with a "
            "QR factorisation"
        ]
    if np.abs(gram - np.eye(len(gram))).max() > 1e-6:
        return ["M is not orthonormal: its columns have length 1 but are not at right angles; end with a QR factorisation"]
    return []


def same_span(a: np.ndarray, b: np.ndarray) -> bool:
    """Whether the columns of a and of b span the same space (order, signs and rotations do not matter)."""
    a, b = (np.linalg.qr(m)[0] for m in (a, b))
    return bool(np.linalg.norm(a - b @ (b.T @ a)) < 1e-5)


def near(a, b, case: Case) -> bool:
    """Same coefficients, same span."""
    return bool(np.linalg.norm(a[0] - b[0]) <= 1e-6 * np.linalg.norm(b[0])) and same_span(a[1], b[1])


def describe(answer, expected, case: Case) -> str:
    """Which of the two is wrong, by its own distance."""
    if np.linalg.norm(answer[0] - expected[0]) > 1e-6 * np.linalg.norm(expected[0]):
        return f"Y is wrong (E-step): {scale_hint(answer[0], expected[0])}"
    cosines = np.linalg.svd(np.linalg.qr(answer[1])[0].T @ expected[1], compute_uv=False)
    angle = np.degrees(np.arccos(np.clip(cosines.min(), 0, 1)))
    return f"M spans another space (M-step): the largest angle between the two spaces is {angle:.3g} degrees"


def make_stages(function) -> Stages:
    """Stages with the learner's step instead of the tracker's iterations, which never leave the space of the samples.

    The tracker hands over S^T S and M^T S only. Any C with C^T C = S^T S holds the samples in isometric coordinates, in
    which a step is the same step: M's coordinates follow from C, and Z with C Z = M goes back.
    """

    def em_in_sample_space(gram, coefficients, steps):
        """As the tracker's, by the learner's step on isometric coordinates."""
        values, vectors = np.linalg.eigh(gram)
        keep = values > 1e-12 * values[-1]
        samples = np.sqrt(values[keep])[:, None] * vectors[:, keep].T
        correctives = np.linalg.lstsq(samples.T, coefficients.T, rcond=None)[0]
        case = dict(correctives=correctives, samples=samples)
        for _ in range(steps):
            _, case["correctives"] = parse(function(**case), case)
        return np.linalg.lstsq(samples, case["correctives"], rcond=None)[0]

    return Stages(adaptive_pca=functools.partial(AdaptiveModel, em=em_in_sample_space))


def _with(e_step=None, m_step=None):
    """A mistake in the E-step, in the M-step, or in both; each a function of (M, S) or of (M, S, Y)."""

    def answer(correctives, samples):
        """Y and the new M, as the learner returns them."""
        y, m = truth(correctives, samples)
        y = y if e_step is None else e_step(correctives, samples)
        return y, m if m_step is None else m_step(correctives, samples, y)

    return answer


def _plain(m, s):
    return m.T @ s


def _qr(m):
    return np.linalg.qr(m)[0]


def _principal(m, s, y):
    return np.linalg.svd(s, full_matrices=False)[0][:, : m.shape[1]]


def _centred(s):
    return s - s.mean(axis=1, keepdims=True)


_INVERSE = (
    "Y = M^T S holds only while M is orthonormal; in general Y = (M^T M)^-1 M^T S. (M^T M)^-1 is the missing weight here. M's "
    "span does not notice: with the QR at the end, EM is orthogonal iteration"
)
MISTAKES = (
    Mistake(_INVERSE, _with(e_step=_plain)),
    Mistake("the sign of Y is wrong", _with(e_step=lambda m, s: -e_step(m, s))),
    Mistake(
        "Y belongs to the new M: return the coefficients that the M-step used, for the M that came in",
        lambda correctives, samples: (truth(correctives, samples)[1].T @ samples, truth(correctives, samples)[1]),
    ),
    Mistake(
        "M has not changed: the M-step is missing (only the old M was made orthonormal)",
        _with(m_step=lambda m, s, y: _qr(m)),
    ),
    Mistake(
        "this is batch PCA of the samples, where EM would converge to; one EM step starts from the M that came in",
        _with(m_step=_principal),
    ),
    Mistake(
        "the first k samples instead of the M-step: that is how the paper starts, not how it updates",
        _with(m_step=lambda m, s, y: _qr(s[:, : m.shape[1]])),
    ),
    Mistake(
        "the samples' mean was taken away in the M-step: here the origin is the neutral face, nothing is centred",
        _with(m_step=lambda m, s, y: _qr(_centred(s) @ y.T)),
    ),
    Mistake(
        "the samples' mean was taken away: here the origin is the neutral face, nothing is centred",
        lambda correctives, samples: truth(correctives, _centred(samples)),
    ),
    Mistake(
        "two steps instead of one: the coefficients are those of the first, M has moved on",
        _with(m_step=lambda m, s, y: truth(truth(m, s)[1], s)[1]),
    ),
    Mistake(
        "Y is divided by the number of samples: a projection has no mean in it",
        _with(e_step=lambda m, s: e_step(m, s) / s.shape[1]),
    ),
)

# Few shapes, so that the short performance has more samples than shapes: before that, EM only turns the basis.
_FEW_SHAPES = Parameters().replace(adaptive_pca__K=2)
EM_STEP = Exercise(
    "em_step",
    "06_incremental_pca",
    task=(
        "em_step(correctives, samples): M (d, k) and S (d, s) -> (Y, M): the E-step's coefficients Y (k, s) of the samples "
        "for the M that came in, and the M-step's new M (d, k), its columns made orthonormal. M need not be orthonormal when "
        "it comes in."
    ),
    hints=(
        "Two least-squares problems in turn: the best coefficients for the shapes, then the best shapes for the coefficients.",
        "E-step: fit every sample by the columns of M, which need not be orthonormal. M-step: fit the samples by the "
        "coefficients. Then make the columns orthonormal.",
        "Y = (M^T M)^-1 M^T S, M <- S Y^T (Y Y^T)^-1, M <- Q of its QR factorisation.",
    ),
    mistakes=MISTAKES,
    cases=cases,
    truth=truth,
    parse=parse,
    near=near,
    describe=describe,
    make_stages=make_stages,
    faults=faults,
    parameters=_FEW_SHAPES,
)
