"""Exercise of notebook 08: a measure that a face which never moves cannot win."""

from __future__ import annotations

import numpy as np

from .grading import Case, Exercise, Mistake, as_array, drawn
from .pairs import close


@drawn(seed=18, count=6)
def cases(rng: np.random.Generator, number: int) -> Case:
    """Faces of which a part moves, in frames that move more or less; the tracker follows with an error."""
    f, n = int(rng.integers(4, 12)), int(rng.integers(20, 60))
    true = rng.normal(size=(f, n, 3)) * rng.uniform(0, 4, (1, n, 1)) * rng.uniform(0.2, 1.5, (f, 1, 1))
    tracked = 0.7 * true + 0.5 * rng.normal(size=true.shape)
    return dict(tracked=tracked, true=true, threshold=2.0)


def lengths(field) -> np.ndarray:
    """Lengths (F, n) of vectors (F, n, 3)."""
    return np.linalg.norm(field, axis=2)


def truth(tracked, true, threshold):
    """The package's answer (:func:`adaptiveface.evaluation.active_share`, on which no exercise may build; a test compares)."""
    return _over(lengths(true) > threshold, lengths(tracked - true), lengths(true))


def parse(answer, case: Case) -> np.ndarray:
    """One number."""
    return as_array(answer, (), "the share")


def _over(chosen, error, motion):
    return np.array(error[chosen].sum() / motion[chosen].sum())


def _measure(function):
    return lambda tracked, true, threshold: function(lengths(tracked - true), lengths(true), tracked, true, threshold)


def _per_frame(error, motion, tracked, true, threshold):
    active = motion > threshold
    shares = [e[a].sum() / m[a].sum() for e, m, a in zip(error, motion, active, strict=True) if a.any()]
    return np.array(np.mean(shares))


MISTAKES = (
    Mistake(
        "all pairs count: resting skin hides how badly the moving skin is followed",
        _measure(lambda e, m, t, g, h: _over(m >= 0, e, m)),
    ),
    Mistake(
        "the pairs are chosen by the tracked motion: a face that never moves would have none",
        _measure(lambda e, m, t, g, h: _over(lengths(t) > h, e, m)),
    ),
    Mistake("the pairs are chosen by the error", _measure(lambda e, m, t, g, h: _over(e > h, e, m))),
    Mistake("the pairs that rest were chosen instead of those that move", _measure(lambda e, m, t, g, h: _over(m <= h, e, m))),
    Mistake(
        "the mean of the shares of single pairs is taken: pairs that hardly move decide it",
        _measure(lambda e, m, t, g, h: np.array(np.mean(e[m > h] / m[m > h]))),
    ),
    Mistake(
        "the mean of the shares of frames is taken: a frame in which little moves counts as much as a laugh",
        _measure(_per_frame),
    ),
    Mistake("lengths were squared before they were added", _measure(lambda e, m, t, g, h: _over(m > h, e**2, m**2))),
    Mistake(
        "the difference of lengths is the error: motion in the wrong direction would count as right",
        _measure(lambda e, m, t, g, h: _over(m > h, np.abs(lengths(t) - m), m)),
    ),
    Mistake("the error is divided by the tracked motion", _measure(lambda e, m, t, g, h: _over(m > h, e, lengths(t)))),
    Mistake("the mean error in mm came back: divide by the motion", _measure(lambda e, m, t, g, h: np.array(e[m > h].mean()))),
    Mistake(
        "the error is divided by the motion of all pairs", _measure(lambda e, m, t, g, h: np.array(e[m > h].sum() / m.sum()))
    ),
    Mistake("how much is followed came back: 1 minus the share", lambda **c: 1.0 - truth(**c)),
    Mistake(
        "the errors of x, y and z are added as absolute values instead of as lengths",
        _measure(lambda e, m, t, g, h: np.array(np.abs(t - g).sum(axis=2)[m > h].sum() / m[m > h].sum())),
    ),
)

ACTIVE_SHARE = Exercise(
    "active_share",
    "08_evaluation",
    task=(
        "active_share(tracked, true, threshold): tracked and true (F, n, 3), the motion of n vertices from the neutral in F "
        "frames, mm -> one number: the summed length of the error over the summed length of the true motion, both over the "
        "pairs of frame and vertex whose true motion is longer than threshold mm. A perfect tracker scores 0. A perfect "
        "neutral that never moves scores 1, though its distance to the true surface may be small: skin slides along itself."
    ),
    hints=(
        "Which pairs of frame and vertex say something about following a motion? Choose them by the truth alone.",
        "Take lengths of error and of true motion over the chosen pairs, add each up, and divide once at the end.",
        "sum |tracked - true| / sum |true| over the pairs with |true| > threshold.",
    ),
    mistakes=MISTAKES,
    cases=cases,
    truth=truth,
    parse=parse,
    near=close,
)
