"""What real faces do with their expressions: how far each goes, and which go together, as a penalty in the re-solve.

Many combinations of expressions make nearly the same face: a smile is a smile, or the mouth drawn to the left and to the
right at once with the upper lip raised. Only people's habits tell which. The statistics are second moments of a real take
(``data_synth/build_expression_statistics.py`` has the source); the penalty is x^T M^-1 x, the negative logarithm of a
zero-mean Gaussian.

What people seldom do, such as a lower lip that is drawn down with the jaw closed, would come out too small under a constant
penalty. So the penalty's weight is the variance of what the expressions leave unexplained (:func:`habit_trust`), as in
any posterior: a mesh from noisy depth is explained by habits, and a mesh that the expressions fit well speaks for itself.
Where the expressions misfit, the lips count more than other vertices (:func:`lips_count`), because 20 of the 40 features
hold them.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from importlib.resources import files

import numpy as np
from scipy.spatial import cKDTree

#: Coefficients that the take moves less than this are not held more tightly: it is the take of one person.
LEAST = 0.05
#: What brows and lids do beside the mouth is the script of the take, and no habit: the two are taken apart.
UPPER = ("brow", "eye")
#: They move few vertices by little, lids fewest, so that depth tells less of them: this share of the penalty holds them.
SHARES = {"brow": 0.1, "eye": 0.03}
#: Expressions that fit this well (root mean square over the vertices, mm) need no habits: what generic expressions leave of
#: performers with good depth is 0.2, and 0.27 in one frame of ten. Three people from a Kinect v2 leave 0.7 to 0.9.
GOOD_FIT = 0.3
#: The variance beyond :data:`GOOD_FIT` is so many times smaller at the lips, which 20 features hold.
LIPS_KNOWN = 3.0
#: A vertex so far from the nearest feature of the lips is held less by it (standard deviation of a Gaussian), mm.
LIPS_REACH = 12.0


@lru_cache(maxsize=1)
def expression_statistics() -> tuple[tuple[str, ...], np.ndarray]:
    """Names (S,) and second moments (S, S) of the generic expressions' coefficients."""
    text = (files("adaptiveface") / "assets" / "expression_statistics.csv").read_text(encoding="utf-8")
    header, *rows = text.splitlines()
    return tuple(header.split(",")), np.array([row.split(",") for row in rows], float)


def habit_penalty(expressions: Sequence[str]) -> np.ndarray:
    """(A, A) symmetric positive semi-definite matrix P of the penalty x^T P x.

    Zeros where one of the ``expressions`` is not among the generic ones: a rig that has others shares out a smile in another
    way.
    """
    names, moments = expression_statistics()
    if not set(expressions) <= set(names):
        return np.zeros((len(expressions), len(expressions)))
    rows = [names.index(name) for name in expressions]
    upper = np.array([name.startswith(UPPER) for name in expressions], bool)
    moments = np.where(upper[:, None] == upper, moments[np.ix_(rows, rows)], 0.0)
    share = np.sqrt([next((part for start, part in SHARES.items() if name.startswith(start)), 1.0) for name in expressions])
    penalty: np.ndarray = np.linalg.inv(moments + LEAST**2 * np.eye(len(rows))) * np.outer(share, share)
    return penalty


def habit_trust(misfit: float, vertices: int) -> float:
    """The weight of :func:`habit_penalty`, mm^2; ``misfit``: the sum over ``vertices`` of their squared distances, mm^2."""
    return max(misfit / vertices - GOOD_FIT**2, 0.0)


def lips_count(trust: float) -> float:
    """By how much more than elsewhere a vertex at the lips counts: 0 for a good fit, and less than ``LIPS_KNOWN`` - 1.

    The two variances' inverse ratio, with ``trust`` from :func:`habit_trust`.
    """
    return (trust + GOOD_FIT**2) / (trust / LIPS_KNOWN + GOOD_FIT**2) - 1.0


def lips_nearness(points: np.ndarray, lips: np.ndarray) -> np.ndarray:
    """(n,) from 0 to 1: how near ``points`` (n, 3) lie to the nearest of the features ``lips`` (m, 3), mm."""
    distances, _ = cKDTree(lips).query(points)
    nearness: np.ndarray = np.exp(-0.5 * (distances / LIPS_REACH) ** 2)
    return nearness
