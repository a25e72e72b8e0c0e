"""Exercise of notebook 03: one linearised point-to-plane step of the rigid ICP (section 4.1; Chen & Medioni 1991)."""

from __future__ import annotations

import functools

import cv2
import numpy as np

from ..geometry.mesh import rigid_alignment, rotation_vector_matrix
from ..tracking.rigid import RigidTracker
from ..tracking.stages import Stages
from .grading import Case, Exercise, Mistake, Wrong, as_array, drawn

_TURNED_BACK = "the rotation turns the wrong way: it is the transpose, or the cross product is n x v instead of v x n"


@drawn(seed=3, count=6)
def cases(rng: np.random.Generator, number: int) -> Case:
    """Bulging patches in front of the camera, moved a little, with noise, slid targets and outliers of zero weight."""
    n = int(rng.integers(60, 300))
    normals = rng.normal(size=(n, 3)) - [0, 0, 1.5]
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    points = normals * [75, 100, 60] + rng.normal(size=(n, 3)) + [rng.uniform(-80, 80), rng.uniform(-50, 50), 600]
    centre = points.mean(axis=0)
    turn, shift = 0.004 * rng.normal(size=3), 0.7 * rng.normal(size=3)
    moved = (points - centre) @ rotation_vector_matrix(turn).T + centre + shift
    slide = 3.0 * np.cross(normals, rng.normal(size=(n, 3)))
    outlier = rng.random(n) < 0.2
    along = np.where(outlier, rng.uniform(5, 15, n), 0.3 * rng.normal(size=n))
    weights = np.where(outlier, 0.0, np.exp(rng.normal(size=n)))
    weights[rng.random(n) < 0.05] = 0.0
    along += np.where(weights < np.median(weights), 0.5, 0.0)  # the lightly weighted half is biased
    return dict(points=points, targets=moved + slide + along[:, None] * normals, normals=normals, weights=weights)


def solve(points, targets, normals, weights, centre=None, power: float = 0.5) -> tuple[np.ndarray, np.ndarray]:
    """Rotation vector about ``centre`` and translation of the linearised problem; rows scaled by weights**power."""
    centre = points.mean(axis=0) if centre is None else centre
    jacobian = np.hstack([np.cross(points - centre, normals), normals])
    distances = np.einsum("nd,nd->n", normals, points - targets)
    scale = weights**power
    step = np.linalg.lstsq(jacobian * scale[:, None], -distances * scale, rcond=None)[0]
    return step[:3], step[3:]


def about(centre: np.ndarray, rotation: np.ndarray, shift: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A rotation about ``centre`` followed by ``shift`` as (rotation, translation) about the origin."""
    return rotation, centre + shift - rotation @ centre


def truth(points, targets, normals, weights):
    """The package's answer."""
    turn, shift = solve(points, targets, normals, weights)
    return about(points.mean(axis=0), rotation_vector_matrix(turn), shift)


def parse(answer, case: Case) -> tuple[np.ndarray, np.ndarray]:
    """(rotation (3, 3), translation (3,))."""
    if isinstance(answer, np.ndarray) and answer.shape == (4, 4):
        answer = answer[:3, :3], answer[:3, 3]
    if isinstance(answer, np.ndarray) and answer.shape == (6,):
        raise Wrong(
            "six numbers came back: turn the rotation vector into a matrix (adaptiveface.geometry.mesh.rotation_vector_matrix) "
            "and return (rotation, translation)"
        )
    if not isinstance(answer, (tuple, list)) or len(answer) != 2:
        raise Wrong("a pair (rotation, translation) is expected")
    rotation = np.asarray(answer[0])
    if rotation.shape == (3,):
        raise Wrong(
            "the rotation has the wrong shape (3,): this looks like a rotation vector, its matrix is expected "
            "(adaptiveface.geometry.mesh.rotation_vector_matrix)"
        )
    return as_array(rotation, (3, 3), "the rotation"), as_array(answer[1], (3,), "the translation")


def faults(answer, case: Case) -> list[str]:
    """A rotation matrix must be orthonormal with determinant +1."""
    rotation = answer[0]
    error = np.abs(rotation.T @ rotation - np.eye(3)).max()
    if error > 1e-7:
        return [
            f"the rotation is not orthonormal (R^T R differs from the identity by {error:.2g}): I + [r]x is only its first "
            "order; use the exact matrix of the rotation vector, or the face shears a little in every step"
        ]
    if np.linalg.det(rotation) < 0:
        return ["an improper rotation (determinant -1): it mirrors the face"]
    return []


def near(a, b, case: Case) -> bool:
    """Whether two steps move the points alike, up to the second order that the linearisation leaves free."""
    points = case["points"]
    first, second = (points @ rotation.T + translation for rotation, translation in (a, b))
    motion = np.linalg.norm(second - points, axis=1).mean()
    return bool(np.linalg.norm(first - second, axis=1).mean() < 0.06 * motion + 1e-6)


def describe(answer, expected, case: Case) -> str:
    """The weighted energy that is left, against the least possible; or a rotation that is the right one turned back."""
    if np.abs(answer[0] - expected[0].T).max() < 0.1 * np.abs(expected[0] - expected[0].T).max():
        return _TURNED_BACK
    energies = [_energy(step, **case) for step in ((np.eye(3), np.zeros(3)), answer, expected)]
    before, after, least = energies
    grows = "; it grows: a sign, or a turn about another centre than the one that was solved about?" if after > before else ""
    return f"the energy goes from {before:.3g} to {after:.3g}; the right step reaches {least:.3g}{grows}"


def _energy(step, points, targets, normals, weights) -> float:
    moved = points @ step[0].T + step[1]
    return float(weights @ np.einsum("nd,nd->n", normals, moved - targets) ** 2)


def make_stages(function) -> Stages:
    """Stages whose rigid step is the learner's function: points, foot points of the matches, normals and weights."""

    def step(points, correspondences, centre, vertex_weights):
        """As the tracker's, by the learner's function."""
        c = correspondences
        targets = points - c.distances[:, None] * c.normals
        # Points without a match have a zero normal and zero weight: they are left out, as in the exercise's cases.
        used = c.weights > 0
        answer = function(
            points=points[used],
            targets=targets[used],
            normals=c.normals[used],
            weights=(c.weights * vertex_weights)[used],
        )
        rotation, translation = parse(answer, {})
        turn = cv2.Rodrigues(rotation)[0].ravel()
        return np.concatenate([turn, rotation @ centre + translation - centre])

    return Stages(rigid=functools.partial(RigidTracker, solve=step))


def _negative(**case):
    turn, shift = solve(**case)
    return about(case["points"].mean(axis=0), rotation_vector_matrix(-turn), -shift)


def _turned_back(**case):
    turn, shift = solve(**case)
    return about(case["points"].mean(axis=0), rotation_vector_matrix(-turn), shift)


def _transposed(**case):
    rotation, translation = truth(**case)
    return rotation.T, translation


def _power(power):
    def answer(**case):
        """Rotation (3, 3) and translation (3,) mm."""
        turn, shift = solve(**case, power=power)
        return about(case["points"].mean(axis=0), rotation_vector_matrix(turn), shift)

    return answer


def _centre_forgotten(**case):
    turn, shift = solve(**case)
    return rotation_vector_matrix(turn), shift


def _translation_only(**case):
    scale = np.sqrt(case["weights"])
    distances = np.einsum("nd,nd->n", case["normals"], case["points"] - case["targets"])
    return np.eye(3), np.linalg.lstsq(case["normals"] * scale[:, None], -distances * scale, rcond=None)[0]


def _point_to_point(use_weights):
    def answer(points, targets, normals, weights):
        """Rotation (3, 3) and translation (3,) mm."""
        pose = rigid_alignment(points, targets, weights if use_weights else None)
        return pose[:3, :3], pose[:3, 3]

    return answer


_POINT_TO_POINT = "this is the point-to-point solution: only the distance along the normal counts, n_i . (v_i - p_i)"
MISTAKES = (
    Mistake("the sign is wrong: the step moves the points away from the planes; J step = -distances", _negative),
    Mistake(_TURNED_BACK, _turned_back),
    Mistake("the rotation is the transpose of the right one (points @ rotation.T, not points @ rotation)", _transposed),
    Mistake("a weight is missing: weights do not enter, so bad correspondences pull as hard as good ones", _power(0.0)),
    Mistake("the weight enters squared: scale rows by sqrt(w), or use J^T W J with w once", _power(1.0)),
    Mistake(
        "the rotation was solved about the centre of the points but is applied about the origin: "
        "translation = centre + shift - rotation @ centre",
        _centre_forgotten,
    ),
    Mistake("the rotation is missing: only a translation was solved", _translation_only),
    Mistake(_POINT_TO_POINT, _point_to_point(True)),
    Mistake(_POINT_TO_POINT + "; and the weights are missing", _point_to_point(False)),
    Mistake(
        "the translation is missing: only a rotation came back",
        lambda **case: about(case["points"].mean(axis=0), truth(**case)[0], np.zeros(3)),
    ),
)

POINT_TO_PLANE_STEP = Exercise(
    "point_to_plane_step",
    "03_rigid_tracking",
    task=(
        "point_to_plane_step(points, targets, normals, weights): points v_i (n, 3), the depth points p_i (n, 3) with unit "
        "normals n_i (n, 3), weights w_i (n,) -> (rotation (3, 3), translation (3,)) such that points @ rotation.T + "
        "translation minimises sum w_i (n_i . (v_i - p_i))^2, linearised in the rotation."
    ),
    hints=(
        "A small rotation moves a point p by r x p, which is linear in r. Which six numbers are unknown?",
        "Write the signed distance after the step as distance + row . (r, t), one row per correspondence, and solve the "
        "weighted least squares. Turn about the points' centre, so that rotation and translation do not mix.",
        "row_i = [(v_i - c) x n_i, n_i], J^T W J step = -J^T W d with d_i = n_i . (v_i - p_i); R = exp([r]x), translation = c "
        "+ t - R c.",
    ),
    mistakes=MISTAKES,
    cases=cases,
    truth=truth,
    parse=parse,
    near=near,
    describe=describe,
    make_stages=make_stages,
    faults=faults,
)
