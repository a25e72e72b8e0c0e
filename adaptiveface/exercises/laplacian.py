"""Exercise of notebook 05: the right-hand side of the Laplacian deformation (section 4.3, equations 3 to 7)."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from ..tracking.laplacian import LaplacianDeformation
from ..tracking.stages import Stages
from .grading import Case, Exercise, Mistake, as_array, drawn, scale_hint


@dataclass(frozen=True)
class FeaturePull:
    """The 2D features of one frame as r linear rows each.

    corners (f, 3) int: vertices of the triangle a feature lies in; shares (f, 3): its barycentric weights;
    rows (f, r, 3), targets (f, r) mm, weights (f, r) 1/mm^2: the energy is sum weights (rows . motion - targets)^2.
    """

    corners: np.ndarray
    shares: np.ndarray
    rows: np.ndarray
    targets: np.ndarray
    weights: np.ndarray


@drawn(seed=5, count=6)
def cases(rng: np.random.Generator, number: int) -> Case:
    """Random vertices, a fifth without depth, and features that share corners."""
    n, f, r = int(rng.integers(30, 120)), int(rng.integers(5, 40)), int(rng.integers(2, 4))
    normals = rng.normal(size=(n, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    weights = np.where(rng.random(n) < 0.2, 0.0, rng.uniform(0.2, 1.0, n))
    corners = np.array([rng.choice(n // 3, 3, replace=False) for _ in range(f)])
    features = FeaturePull(
        corners,
        rng.dirichlet(np.ones(3), f),
        rng.normal(size=(f, r, 3)),
        rng.normal(size=(f, r)),
        rng.uniform(0.02, 0.3, (f, r)),
    )
    return dict(
        distances=2 * rng.normal(size=n),
        normals=normals,
        weights=weights,
        w1=float(rng.uniform(0.05, 0.5)),
        features=features,
    )


def depth_part(distances, normals, weights, w1) -> np.ndarray:
    """The depth term's share of b: (n, 3)."""
    return -(w1 * weights * distances)[:, None] * normals


def feature_part(n: int, features: FeaturePull, shares=None, weights=None) -> np.ndarray:
    """The features' share of b: every row's pull, spread over the corners of its triangle; (n, 3)."""
    shares = features.shares if shares is None else shares
    weights = features.weights if weights is None else weights
    forces = np.einsum("fr,frd->fd", weights * features.targets, features.rows)
    right = np.zeros((n, 3))
    np.add.at(right, features.corners, shares[:, :, None] * forces[:, None, :])
    return right


def truth(distances, normals, weights, w1, features):
    """The package's answer."""
    return depth_part(distances, normals, weights, w1) + feature_part(len(normals), features)


def parse(answer, case: Case) -> np.ndarray:
    """b (n, 3)."""
    return as_array(answer, case["normals"].shape, "b")


def near(a, b, case: Case) -> bool:
    """Equal to rounding."""
    return bool(np.abs(a - b).max() <= 1e-7 * max(np.abs(b).max(), 1e-12))


def describe(answer, expected, case: Case) -> str:
    """What is off in the depth part and in the features' part, each by itself: people make several mistakes at once."""
    alone = np.ones(len(expected), bool)
    alone[case["features"].corners] = False  # rows that hold the depth part only
    depth = _named(_depth_variants(case), lambda part: _same_rows(answer[alone], part[alone]))
    if depth is None:
        hint = scale_hint(answer[alone], expected[alone])
        return f"something is off in the depth part, which alone is in the rows of vertices at no feature: {hint}"
    words, part = depth
    found = [f"in the depth part {' and '.join(words)}"] if words else []
    features = _named(_feature_variants(case), lambda pull: _same_rows(answer - part, pull))
    if features is None:
        found.append(f"something is off in the features' part ({scale_hint(answer - part, expected - part)})")
    elif features[0]:
        found.append(f"in the features' part {' and '.join(features[0])}")
    return "; ".join(found)


def _same_rows(a, b) -> bool:
    return bool(np.abs(a - b).max() <= 1e-7 * max(np.abs(b).max(), 1e-12))


def _named(variants, fits):
    """The first (words, part) of the variants whose part fits; None where none does."""
    return next(((words, part) for words, part in variants if fits(part)), None)


def _variants(*choices):
    """Every combination of choices (words, value), the right one of each first: (all words, all values)."""
    for combination in sorted(itertools.product(*choices), key=lambda pairs: sum(bool(words) for words, _ in pairs)):
        yield [words for words, _ in combination if words], [value for _, value in combination]


def _depth_variants(case):
    """(words, the depth part (n, 3)) for every combination of what may be wrong with it."""
    w1, weights = case["w1"], case["weights"]
    scales = (("", w1), ("w1 does not enter", 1.0), ("w1 enters squared", w1**2), ("the root of w1 enters", w1**0.5))
    matches = (("", weights), ("the weights of the matches do not enter", np.ones_like(weights)))
    for words, (sign, scale, match) in _variants((("", 1.0), ("the sign is wrong", -1.0)), scales, matches):
        yield words, sign * _depth(case, w1=scale, weights=match)


def _feature_variants(case):
    """(words, the features' part (n, 3)) for every combination of what may be wrong with it."""
    features = case["features"]
    weights = (("", features.weights), ("the weights do not enter", np.ones_like(features.weights)))
    shares = (("", features.shares), ("the barycentric shares do not enter", np.ones_like(features.shares)))
    for words, (sign, weight, share) in _variants((("", 1.0), ("the sign is wrong", -1.0)), weights, shares):
        yield words, sign * _features(case, weights=weight, shares=share)


def make_stages(function) -> Stages:
    """Stages with the learner's right-hand side in the deformation that uses depth."""

    class Learners(LaplacianDeformation):
        """The deformation with the learner's right-hand side."""

        def right_hand_side(self, matches, normals, term):
            """As the method's, by the learner's function."""
            pull = FeaturePull(self.corners[term.index], self.shares[term.index], term.rows, term.targets, term.weights)
            answer = function(distances=matches.distances, normals=normals, weights=matches.weights, w1=self.w1, features=pull)
            return as_array(answer, normals.shape, "b")

    return Stages(deformation=Learners.of)


def _parts(depth, features):
    """A mistake from its two parts, each a function of the case."""
    return lambda **case: depth(case) + features(case)


def _depth(case, **changed):
    return depth_part(**{key: changed.get(key, case[key]) for key in ("distances", "normals", "weights", "w1")})


def _features(case, **changed):
    return feature_part(len(case["normals"]), case["features"], **changed)


def _lost(case):
    features, right = case["features"], np.zeros_like(case["normals"])
    forces = np.einsum("fr,frd->fd", features.weights * features.targets, features.rows)
    right[features.corners] += features.shares[:, :, None] * forces[:, None, :]
    return right


def _nearest(case):
    shares = case["features"].shares
    return _features(case, shares=(np.arange(3) == shares.argmax(axis=1)[:, None]).astype(float))


MISTAKES = (
    Mistake(
        "the sign of the depth part is wrong: the vertices must move against their distance, b_i = -w1 w_i dist_i n_i",
        _parts(lambda c: -_depth(c), _features),
    ),
    Mistake("the sign of the features' part is wrong", _parts(_depth, lambda c: -_features(c))),
    Mistake("the sign of the whole right-hand side is wrong", _parts(lambda c: -_depth(c), lambda c: -_features(c))),
    Mistake("a weight is missing: w1 does not enter", _parts(lambda c: _depth(c, w1=1.0), _features)),
    Mistake(
        "w1 enters squared: it is an energy weight and multiplies the normal equations once",
        _parts(lambda c: _depth(c, w1=c["w1"] ** 2), _features),
    ),
    Mistake(
        "the square root of w1 enters: that is right for rows of a least-squares system, b = A^T W a has w1 itself",
        _parts(lambda c: _depth(c, w1=c["w1"] ** 0.5), _features),
    ),
    Mistake(
        "a weight is missing: the weights of the depth matches do not enter, so vertices without depth pull too",
        _parts(lambda c: _depth(c, weights=np.ones_like(c["weights"])), _features),
    ),
    Mistake(
        "a weight is missing: the weights of the features do not enter",
        _parts(_depth, lambda c: _features(c, weights=np.ones_like(c["features"].weights))),
    ),
    Mistake(
        "b[corners] += ... adds only once where features share a vertex; use np.add.at (or a loop)",
        _parts(_depth, _lost),
    ),
    Mistake(
        "the barycentric shares are missing: every corner takes the whole pull of its feature",
        _parts(_depth, lambda c: _features(c, shares=np.ones_like(c["features"].shares))),
    ),
    Mistake(
        "only the nearest corner takes the pull of a feature: spread it by the barycentric shares",
        _parts(_depth, _nearest),
    ),
    Mistake("the features' part is missing", _parts(_depth, lambda c: 0.0)),
    Mistake("the depth part is missing", _parts(lambda c: 0.0, _features)),
    Mistake(
        "everything is twice as large as it should be: A and b are half of the energy's derivative",
        _parts(lambda c: 2 * _depth(c), lambda c: 2 * _features(c)),
    ),
)


RIGHT_HAND_SIDE = Exercise(
    "right_hand_side",
    "05_laplacian_deformation",
    task=(
        "right_hand_side(distances, normals, weights, w1, features): b (n, 3) of A d = b, the minimum of w1 sum_i weights_i "
        "(normals_i . d_i + distances_i)^2 + w2 |L d|^2 + sum_f,r features.weights_fr (rows_fr . e_f - targets_fr)^2, where "
        "e_f = sum_k shares_fk d[corners_fk] is how far the feature's point moves. A holds everything that multiplies d; b "
        "the rest."
    ),
    hints=(
        "Half the derivative of each square is its row times its value. Which of them still hold no d?",
        "Depth: each vertex is pulled along its normal. Features: each row pulls the feature's point, and its three corners "
        "share the pull by their barycentric weights. Corners may be shared: add, do not assign.",
        "b_i = -w1 weights_i distances_i normals_i, and b[corner_fk] += shares_fk sum_r weights_fr targets_fr rows_fr.",
    ),
    mistakes=MISTAKES,
    cases=cases,
    truth=truth,
    parse=parse,
    near=near,
    describe=describe,
    make_stages=make_stages,
)
