"""Exercise of notebook 05: the cotangent Laplacian (equation 6; Pinkall & Polthier 1993)."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

from ..geometry.mesh import cotangent_laplacian, vertex_areas
from .grading import Case, Exercise, Mistake, as_array, drawn
from .pairs import close


@drawn(seed=15, count=5)
def cases(rng: np.random.Generator, number: int) -> Case:
    """Bumpy patches with a border and some obtuse angles."""
    rows, columns = int(rng.integers(3, 7)), int(rng.integers(3, 7))
    x, y = np.meshgrid(np.arange(columns), np.arange(rows))
    vertices = np.stack([3.0 * x.ravel(), 4.0 * y.ravel(), np.zeros(x.size)], axis=1) + 0.7 * rng.normal(size=(x.size, 3))
    corner = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)).ravel()
    lower = np.stack([corner, corner + 1, corner + columns], axis=1)
    upper = np.stack([corner + 1, corner + columns + 1, corner + columns], axis=1)
    return dict(vertices=vertices, triangles=np.concatenate([lower, upper]))


def truth(vertices, triangles):
    """The package's answer, dense."""
    return cotangent_laplacian(vertices, triangles).toarray()


def parse(answer, case: Case) -> np.ndarray:
    """L (N, N), dense."""
    n = len(case["vertices"])
    return as_array(answer.toarray() if sp.issparse(answer) else answer, (n, n), "L")


def faults(answer, case: Case) -> list[str]:
    """Constants have no Laplacian, and every edge is seen from both ends."""
    size = np.abs(answer).max(initial=1e-9)
    if np.abs(answer - answer.T).max() > 1e-7 * size and np.abs(answer.sum(axis=1)).max() > 1e-7 * size:
        return ["L is not symmetric, and its rows do not add up to 0: every edge adds to four entries, ii, jj, ij and ji"]
    return []


def _matrix(vertices, triangles, weight, add=True, half=0.5, opposite=True):
    """The matrix from ``weight`` of two edge vectors at an angle and of the edge; by the switches, what goes wrong."""
    n = len(vertices)
    w = np.zeros((n, n))
    for k in range(3):
        i, j, o = (triangles[:, (k + step) % 3] for step in (1, 2, 0))
        apex, first, second = (o, i, j) if opposite else (i, j, o)
        u, v = vertices[first] - vertices[apex], vertices[second] - vertices[apex]
        value = half * weight(u, v, vertices[i] - vertices[j])
        for a, b in ((i, j), (j, i)):
            if add:
                np.add.at(w, (a, b), value)
            else:
                w[a, b] = value
    return np.diag(w.sum(axis=1)) - w


def _sine_cosine(u, v):
    return np.linalg.norm(np.cross(u, v), axis=1), (u * v).sum(axis=1)


def _cotangent(u, v, edge):
    sine, cosine = _sine_cosine(u, v)
    return cosine / sine


def _tangent(u, v, edge):
    sine, cosine = _sine_cosine(u, v)
    return sine / cosine


def _cosine(u, v, edge):
    return (u * v).sum(axis=1) / (np.linalg.norm(u, axis=1) * np.linalg.norm(v, axis=1))


def _by(weight=_cotangent, **options):
    return lambda vertices, triangles: _matrix(vertices, triangles, weight, **options)


def _uniform(vertices, triangles):
    w = np.zeros((len(vertices), len(vertices)))
    for a, b in ((0, 1), (1, 2), (2, 0)):
        w[triangles[:, a], triangles[:, b]] = w[triangles[:, b], triangles[:, a]] = 1.0
    return np.diag(w.sum(axis=1)) - w


def _without_diagonal(**case):
    right = truth(**case)
    return right - np.diag(np.diag(right))


def _positive(**case):
    right = truth(**case)
    return 2 * np.diag(np.diag(right)) - right


def _by_area(vertices, triangles):
    return truth(vertices, triangles) / vertex_areas(vertices, triangles)[:, None]


def _normalised(**case):
    right = truth(**case)
    return right / np.diag(right)[:, None]


def _clipped(vertices, triangles):
    return cotangent_laplacian(vertices, triangles, non_negative=True).toarray()


def _clipped_first(vertices, triangles):
    return _matrix(vertices, triangles, lambda u, v, edge: np.maximum(_cotangent(u, v, edge), 0.0))


MISTAKES = (
    Mistake("the sign is wrong: the diagonal is positive, so that f^T L f is an energy", lambda **c: -truth(**c)),
    Mistake("the half is missing: w_ij is half the sum of the two cotangents", _by(half=1.0)),
    Mistake("all weights are 1: that is the graph's Laplacian, which knows no shape", _uniform),
    Mistake("the diagonal is missing: L_ii is the sum of the weights of row i", _without_diagonal),
    Mistake("the weights have the wrong sign off the diagonal: (L f)_i = sum_j w_ij (f_i - f_j)", _positive),
    Mistake("tangents instead of cotangents", _by(_tangent)),
    Mistake("cosines instead of cotangents: divide by the sine, which is the length of the cross product", _by(_cosine)),
    Mistake("the angle at an end of the edge is taken: it must lie opposite the edge", _by(opposite=False)),
    Mistake(
        "only one of an edge's two triangles counts: L[i, j] = ... overwrites what the other wrote, += adds", _by(add=False)
    ),
    Mistake("the rows are divided by the vertices' areas: equation (6) has no areas", _by_area),
    Mistake("the rows are divided by their diagonal: then L is not symmetric any more", _normalised),
    Mistake("negative weights of edges were set to 0: obtuse pairs of triangles have them", _clipped),
    Mistake("negative cotangents were set to 0 one by one: an obtuse angle has a negative one", _clipped_first),
    Mistake(
        "inverse lengths of the edges are the weights",
        _by(lambda u, v, edge: 1 / np.linalg.norm(edge, axis=1), half=1.0, add=False),
    ),
)

COTANGENT_MATRIX = Exercise(
    "cotangent_matrix",
    "05_laplacian_deformation",
    task=(
        "cotangent_matrix(vertices, triangles): vertices (N, 3), triangles (T, 3) -> L (N, N), dense or sparse, with (L f)_i "
        "= sum_j w_ij (f_i - f_j) and w_ij = (cot alpha + cot beta) / 2, where alpha and beta lie opposite the edge ij in its "
        "two triangles. An edge at the border has one triangle and one cotangent."
    ),
    hints=(
        "Work triangle by triangle. Each of its three angles lies opposite one of its edges.",
        "For each corner o with the edge ij opposite: add half the cotangent of its angle to the weight of ij, then fill "
        "L_ij, L_ji, L_ii and L_jj.",
        "cot = u.v / |u x v| with u = x_i - x_o, v = x_j - x_o; take cot / 2 away from L_ij and L_ji, add it to L_ii and L_jj.",
    ),
    mistakes=MISTAKES,
    cases=cases,
    truth=truth,
    parse=parse,
    near=close,
    faults=faults,
)
