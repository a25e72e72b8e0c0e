"""The graders on planted wrong answers, written without the package's own list, and on right ones of other kinds."""

from __future__ import annotations

import ast
import csv
import dataclasses
import json
import time
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import cho_factor, cho_solve, expm, polar
from scipy.optimize import lsq_linear
from scipy.spatial.transform import Rotation

from adaptiveface import __version__, cli, exercises
from adaptiveface.errors import ParameterError
from adaptiveface.evaluation import active_share
from adaptiveface.exercises import (
    ACTIVE_SHARE,
    BOUNDED_LEAST_SQUARES,
    EM_STEP,
    KALMAN_STEP,
    POINT_TO_PLANE_STEP,
    RIGHT_HAND_SIDE,
)

SOLUTIONS = Path(__file__).resolve().parents[1] / "notebooks" / "solutions"


def cross_matrix(r):
    return np.array([[0, -r[2], r[1]], [r[2], 0, -r[0]], [-r[1], r[0], 0]])


def icp(sign=1.0, cross=1.0, weigh=lambda w: w, matrix=expm, origin=False, keep_centre=True, transpose=False, plane=True):
    """A point-to-plane step by normal equations with a choice of faults."""

    def step(points, targets, normals, weights):
        c = np.zeros(3) if origin else (weights @ points) / weights.sum()
        if not plane:
            points, targets, weights = np.repeat(points, 3, 0), np.repeat(targets, 3, 0), np.repeat(weights, 3)
            normals = np.tile(np.eye(3), (len(normals), 1))
        jacobian = np.hstack([cross * np.cross(points - c, normals), normals])
        distance = ((points - targets) * normals).sum(axis=1)
        w = weigh(weights)[:, None]
        solved = sign * np.linalg.solve(jacobian.T @ (w * jacobian), -jacobian.T @ (w[:, 0] * distance))
        rotation = matrix(cross_matrix(solved[:3]))
        translation = c + solved[3:] - rotation @ c if keep_centre else solved[3:]
        return (rotation.T if transpose else rotation), translation

    return step


def mirrored(**case):
    rotation, translation = icp()(**case)
    return rotation @ np.diag([1.0, 1.0, -1.0]), translation


def in_degrees(**case):
    rotation, translation = icp()(**case)
    centre = case["points"].mean(axis=0)
    turned = Rotation.from_rotvec(np.degrees(Rotation.from_matrix(rotation).as_rotvec())).as_matrix()
    return turned, rotation @ centre + translation - turned @ centre


WRONG_STEPS = {
    "sign": (icp(sign=-1.0), "sign"),
    "transposed": (icp(transpose=True), "transpose"),
    "cross product reversed": (icp(cross=-1.0), "transpose"),
    "weights left out": (icp(weigh=np.ones_like), "weight is missing"),
    "weights squared": (icp(weigh=np.square), "squared"),
    "first-order rotation": (icp(matrix=lambda k: np.eye(3) + k), "not orthonormal"),
    "mirror": (mirrored, "improper rotation"),
    "centre forgotten": (icp(keep_centre=False), "about the origin"),
    "point to point": (icp(plane=False), "point-to-point"),
    "degrees": (in_degrees, "energy"),
    "rotation vector": (lambda **c: (np.zeros(3), np.zeros(3)), "wrong shape"),
    "one array of six": (lambda **c: np.zeros(6), "rotation vector"),
    "nan": (lambda **c: (np.full((3, 3), np.nan), np.zeros(3)), "NaN"),
    "nothing moves": (lambda **c: (np.eye(3), np.zeros(3)), "energy"),
}


def clipped(h, g, lower, upper):
    return np.minimum(np.maximum(np.linalg.inv(h) @ g, lower), upper)


def sweeps(count, sign=1.0, release=True, bounds=None, omega=1.0):
    """Projected Gauss-Seidel with a choice of faults."""

    def solve(h, g, lower, upper):
        low, high = bounds or (lower, upper)
        low, high = np.broadcast_to(low, g.shape), np.broadcast_to(high, g.shape)
        x, held = np.clip(np.zeros(len(g)), low, high), np.zeros(len(g), bool)
        for _ in range(count):
            for i in range(len(g)):
                if held[i]:
                    continue
                value = x[i] + omega * (sign * g[i] - h[i] @ x) / h[i, i]
                x[i] = min(max(value, low[i]), high[i])
                held[i] = not release and x[i] != value
        return x

    return solve


def gradient_descent(h, g, lower, upper):
    x, step = np.clip(np.zeros(len(g)), lower, upper), 1.0 / np.linalg.eigvalsh(h)[-1]
    for _ in range(20000):
        x = np.clip(x + step * (g - h @ x), lower, upper)
    return x


def spoiler(h, g, lower, upper):
    x = sweeps(3000)(h, g, lower, upper)
    g[:] = 0.0
    return x


WRONG_SOLVERS = {
    "clipped": (clipped, "clipped instead of bounded"),
    "unbounded": (lambda h, g, lower, upper: np.linalg.inv(h) @ g, "bound"),
    "sign": (sweeps(3000, sign=-1.0), "sign"),
    "one sweep": (sweeps(1), "not converged"),
    "never released": (sweeps(3000, release=False), "never released"),
    "zero to one": (sweeps(3000, bounds=(0.0, 1.0)), "bound"),
    "only the lower bound": (sweeps(3000, bounds=(-0.1, np.inf)), "bound is broken"),
    "column": (lambda h, g, lower, upper: sweeps(3000)(h, g, lower, upper)[:, None], "wrong shape"),
    "changes its input": (spoiler, "writes into its input"),
    "raises": (lambda h, g, lower, upper: h @ g[:-1], "raised ValueError"),
}


def pull(depth_sign=1.0, feature_sign=1.0, w=lambda w1: w1, match=lambda m: m, strength=lambda s: s, add=None, along=None):
    """The right-hand side by loops, with a choice of faults."""

    def right(distances, normals, weights, w1, features):
        b = np.zeros_like(normals)
        for i in range(len(b)):
            direction = normals[i] if along is None else along
            b[i] -= depth_sign * w(w1) * match(weights)[i] * distances[i] * direction
        force = (strength(features.weights) * features.targets)[:, :, None] * features.rows
        force = feature_sign * force.sum(axis=1)
        if add is not None:
            add(b, features, force)
            return b
        for f in range(len(force)):
            for k in range(3):
                b[features.corners[f, k]] += features.shares[f, k] * force[f]
        return b

    return right


def buffered(b, features, force):
    b[features.corners] += features.shares[:, :, None] * force[:, None, :]


def whole(b, features, force):
    np.add.at(b, features.corners, np.repeat(force[:, None], 3, axis=1))


WRONG_SIDES = {
    "depth sign": (pull(depth_sign=-1), "sign of the depth part"),
    "feature sign": (pull(feature_sign=-1), "sign of the features' part"),
    "both signs": (pull(-1, -1), "sign of the whole"),
    "no w1": (pull(w=lambda w1: 1.0), "w1 does not enter"),
    "w1 squared": (pull(w=lambda w1: w1**2), "squared"),
    "no match weights": (pull(match=np.ones_like), "weight is missing: the weights of the depth matches"),
    "no feature weights": (pull(strength=np.ones_like), "weight is missing: the weights of the features"),
    "lost additions": (pull(add=buffered), "np.add.at"),
    "no shares": (pull(add=whole), "shares are missing"),
    "along the view": (pull(along=np.array([0.0, 0.0, 1.0])), "is off"),
    "flat": (lambda **c: pull()(**c).ravel(), "wrong shape"),
    "transposed": (lambda **c: pull()(**c).T, "transpose"),
    "thrice": (lambda **c: 3 * pull()(**c), "times 3"),
    "depth sign and no weights": (
        pull(depth_sign=-1, match=np.ones_like, strength=np.ones_like),
        "the sign is wrong and the weights of the matches do not enter; in the features' part the weights do not enter",
    ),
    "no w1, no shares": (pull(w=lambda w1: 1.0, add=whole), "part w1 does not enter; in the features' part the bary"),
    "feature sign, no feature weights": (
        pull(feature_sign=-1, strength=np.ones_like),
        "in the features' part the sign is wrong and the weights do not enter",
    ),
}


def em(y=None, m=None, order=np.linalg.qr):
    """One EM step by pseudo-inverses, with a choice of faults."""

    def step(correctives, samples):
        coefficients = (y or (lambda M, S: np.linalg.pinv(M) @ S))(correctives, samples)
        moved = (m or (lambda M, S, Y: S @ np.linalg.pinv(Y)))(correctives, samples, coefficients)
        return coefficients, order(moved)[0]

    return step


def centred(M, S):
    return np.linalg.pinv(M) @ (S - S.mean(axis=1, keepdims=True))


WRONG_EM = {
    "no QR": (em(order=lambda a: (a,)), "not orthonormal"),
    "only lengths": (em(order=lambda a: (a / np.linalg.norm(a, axis=0),)), "not orthonormal"),
    "no inverse": (em(y=lambda M, S: M.T @ S), "(M^T M)^-1"),
    "sign": (em(y=lambda M, S: -np.linalg.pinv(M) @ S), "sign"),
    "Y transposed": (
        lambda correctives, samples: (em()(correctives, samples)[0].T, em()(correctives, samples)[1]),
        "transpose",
    ),
    "M transposed": (
        lambda correctives, samples: (em()(correctives, samples)[0], em()(correctives, samples)[1].T),
        "transpose",
    ),
    "no M-step": (em(m=lambda M, S, Y: M), "has not changed"),
    "batch PCA": (em(m=lambda M, S, Y: np.linalg.svd(S)[0][:, : M.shape[1]]), "batch PCA"),
    "mean taken away": (
        em(y=centred, m=lambda M, S, Y: (S - S.mean(axis=1, keepdims=True)) @ np.linalg.pinv(Y)),
        "mean",
    ),
    "new coefficients": (lambda correctives, samples: ((q := em()(correctives, samples)[1]).T @ samples, q), "new M"),
    "only M": (lambda correctives, samples: em()(correctives, samples)[1], "pair"),
    "another space": (em(m=lambda M, S, Y: M + 0.1 * S[:, : M.shape[1]]), "another space"),
}
PLANTED = [
    *((POINT_TO_PLANE_STEP, name, *planted) for name, planted in WRONG_STEPS.items()),
    *((BOUNDED_LEAST_SQUARES, name, *planted) for name, planted in WRONG_SOLVERS.items()),
    *((RIGHT_HAND_SIDE, name, *planted) for name, planted in WRONG_SIDES.items()),
    *((EM_STEP, name, *planted) for name, planted in WRONG_EM.items()),
]


@pytest.mark.parametrize("exercise, name, function, words", PLANTED, ids=[f"{e.name}-{n}" for e, n, *_ in PLANTED])
def test_planted_wrong_answers_are_caught_with_the_right_words(exercise, name, function, words):
    grade = exercise.grade(function)
    assert not grade.passed and grade.started
    assert words in " ".join(grade.findings), str(grade)
    assert " ".join(grade.findings[0].split()) in " ".join(str(grade).split())
    assert max(map(len, str(grade).splitlines())) <= 100, "JupyterLab breaks longer lines within words"


def rodrigues(k):
    r = np.array([k[2, 1], k[0, 2], k[1, 0]])
    return Rotation.from_rotvec(r).as_matrix()


def cayley(k):
    return np.linalg.solve(np.eye(3) - k / 2, np.eye(3) + k / 2)


def bvls(h, g, lower, upper):
    factor = np.linalg.cholesky(h).T
    return lsq_linear(factor, np.linalg.solve(factor.T, g), (lower, upper), tol=1e-13).x


def by_matrices(distances, normals, weights, w1, features):
    """The right-hand side as A^T W a of stacked rows."""
    n, (f, r) = len(normals), features.targets.shape
    pick = np.zeros((f, n))
    for k in range(3):
        pick[np.arange(f), features.corners[:, k]] += features.shares[:, k]
    rows = np.einsum("frd,fn->frnd", features.rows, pick).reshape(f * r, 3 * n)
    right = rows.T @ (features.weights * features.targets).ravel()
    return right.reshape(n, 3) - w1 * (weights * distances)[:, None] * normals


def em_by_cholesky(correctives, samples):
    y = cho_solve(cho_factor(correctives.T @ correctives), correctives.T @ samples)
    return y, np.linalg.svd(samples @ y.T, full_matrices=False)[0]


RIGHT = [
    (POINT_TO_PLANE_STEP, icp()),
    (POINT_TO_PLANE_STEP, icp(origin=True)),
    (POINT_TO_PLANE_STEP, icp(matrix=rodrigues)),
    (POINT_TO_PLANE_STEP, icp(matrix=cayley)),
    (POINT_TO_PLANE_STEP, icp(matrix=lambda k: polar(np.eye(3) + k)[0])),
    (BOUNDED_LEAST_SQUARES, sweeps(3000)),
    (BOUNDED_LEAST_SQUARES, sweeps(1500, omega=1.3)),
    (BOUNDED_LEAST_SQUARES, bvls),
    (BOUNDED_LEAST_SQUARES, gradient_descent),
    (BOUNDED_LEAST_SQUARES, lambda h, g, lower, upper: list(sweeps(3000)(h, g, lower, upper))),
    (RIGHT_HAND_SIDE, pull()),
    (RIGHT_HAND_SIDE, by_matrices),
    (EM_STEP, em()),
    (EM_STEP, em_by_cholesky),
    (EM_STEP, lambda correctives, samples: (lambda y, m: (y, -m[:, ::-1]))(*em()(correctives, samples))),
]


@pytest.mark.parametrize("exercise, function", RIGHT, ids=[f"{e.name}-{i}" for i, (e, _) in enumerate(RIGHT)])
def test_right_answers_of_every_kind_pass(exercise, function):
    grade = exercise.grade(function)
    assert grade.passed, str(grade)
    assert f"right on all {grade.cases} random cases" in str(grade)


@pytest.mark.parametrize(
    "exercise, function",
    [RIGHT[1], RIGHT[7], RIGHT[10], RIGHT[13], (KALMAN_STEP, KALMAN_STEP.truth)],
    ids=lambda value: getattr(value, "name", ""),
)
def test_the_tracker_runs_with_a_right_function(exercise, function):
    calls = []

    def counted(**case):
        calls.append(1)
        return function(**case)

    report = exercise.check(counted, frames=10)
    graded = report.grade.cases
    assert report.passed and report.trial.tracked == 10 and "10 of 10 frames tracked" in str(report)
    assert len(calls) > graded + 5  # the tracker did call it
    assert report.trial.difference < 0.05


@pytest.mark.parametrize(
    "exercise, function",
    [
        (POINT_TO_PLANE_STEP, icp(sign=-1.0)),
        (BOUNDED_LEAST_SQUARES, lambda h, g, lower, upper: upper),
        (RIGHT_HAND_SIDE, pull(depth_sign=-1)),
        (EM_STEP, em(m=lambda M, S, Y: S[:, : M.shape[1]][::-1])),
    ],
    ids=lambda value: getattr(value, "name", ""),
)
def test_a_wrong_function_shows_in_the_tracker(exercise, function):
    trial = exercise.track(function, frames=14)
    assert not trial.passed or trial.difference > 0.1, str(trial)


def test_an_exception_in_the_tracker_is_told_and_later_trackers_are_not_affected():
    def fails_later(h, g, lower, upper):
        raise RuntimeError("no solution today")

    trial = BOUNDED_LEAST_SQUARES.track(fails_later, frames=2)
    assert not trial.passed and "RuntimeError: no solution today" in str(trial)
    assert BOUNDED_LEAST_SQUARES.track(BOUNDED_LEAST_SQUARES.truth, frames=2).passed


@pytest.mark.parametrize("exercise", exercises.EXERCISES, ids=lambda e: e.name)
def test_an_empty_stub_is_answered_kindly(exercise):
    report = exercise.check(lambda **case: None)
    assert not report.passed and not report.grade.started and report.trial is None
    assert "write the function's body" in str(report) and exercise.name in str(report)


@pytest.mark.parametrize("exercise", exercises.EXERCISES, ids=lambda e: e.name)
def test_every_listed_mistake_is_told_apart(exercise):
    assert len(exercise.mistakes) >= 10
    for mistake in exercise.mistakes:
        assert mistake.words in exercise.grade(mistake.answer).findings


def solution_of(exercise) -> Path:
    (path,) = SOLUTIONS.glob(f"{exercise.notebook[:2]}_{exercise.name}.ipynb")
    return path


def cells_of(path: Path) -> list[dict]:
    return json.loads(path.read_text(encoding="utf-8"))["cells"]


@pytest.mark.parametrize("exercise", exercises.EXERCISES, ids=lambda e: e.name)
def test_solutions_pass(exercise):
    space: dict = {}
    for cell in cells_of(solution_of(exercise)):
        assert not cell.get("outputs")
        source = "".join(cell["source"])
        if cell["cell_type"] == "code":
            exec(source.replace(f"exercises.{exercise.name.upper()}.check({exercise.name})", ""), space)  # noqa: S102
    grade = exercise.grade(space[exercise.name])
    assert grade.passed, str(grade)


def test_there_is_a_solution_for_each_exercise_and_no_other():
    assert {solution_of(exercise).name for exercise in exercises.EXERCISES} == {p.name for p in SOLUTIONS.glob("*.ipynb")}


def variable_of(exercise) -> str:
    return next(name for name in exercises.__all__ if getattr(exercises, name) is exercise)


@pytest.mark.parametrize("notebook", sorted({e.notebook for e in exercises.EXERCISES}))
def test_notebooks_end_with_their_exercises_and_empty_stubs(notebook):
    asked = [exercise for exercise in exercises.EXERCISES if exercise.notebook == notebook]
    cells = cells_of(SOLUTIONS.parent / f"{notebook}.ipynb")[-3 * len(asked) - 1 : -1]
    for k, exercise in enumerate(asked):
        text, stub, check = cells[3 * k : 3 * k + 3]
        linked = "".join(text["source"]).replace("\n", " ").split("(solutions/")[1].split(")")[0]
        assert SOLUTIONS / linked == solution_of(exercise)
        assert f"exercises.{variable_of(exercise)}.hint(1)" in "".join(text["source"])
        assert "".join(check["source"]) == f"exercises.{variable_of(exercise)}.check({exercise.name})"
        space: dict = {}
        exec("".join(stub["source"]), space)  # noqa: S102
        assert not exercise.check(space[exercise.name]).grade.started


# ---- what every grader does ----


@pytest.mark.parametrize("exercise", exercises.EXERCISES, ids=lambda e: e.name)
def test_a_right_function_may_be_called_by_position(exercise):
    def by_other_names(*values):
        return exercise.truth(**dict(zip(exercise.cases()[0], values, strict=True)))

    assert exercise.grade(by_other_names).passed


def test_a_wrong_number_of_parameters_is_told():
    grade = BOUNDED_LEAST_SQUARES.grade(lambda h, g: g)
    assert "must take the 4 arguments (h, g, lower, upper)" in str(grade)


@pytest.mark.parametrize("exercise", exercises.EXERCISES, ids=lambda e: e.name)
def test_hints_come_in_three_steps_and_only_the_last_has_the_formula(exercise):
    assert all(exercise.hint(step).startswith(f"Hint {step} of 3") for step in (1, 2, 3))
    assert len({*exercise.hints}) == 3
    formula = ("=", "<-")
    assert any(mark in exercise.hints[2] for mark in formula) or "sum" in exercise.hints[2]
    assert not any(mark in exercise.hints[0] for mark in formula)
    with pytest.raises(ParameterError, match="1, 2 and 3"):
        exercise.hint(4)


def test_an_endless_loop_is_stopped_and_named():
    exercise = dataclasses.replace(BOUNDED_LEAST_SQUARES, limit=0.3)
    running = []

    def endless(h, g, lower, upper):
        while True:
            running.append(time.perf_counter())

    grade = exercise.grade(endless)
    assert not grade.passed and "did not end within 0.3 seconds" in str(grade)
    time.sleep(0.2)
    count = len(running)
    time.sleep(0.2)
    assert len(running) == count  # nothing goes on in the background


def fails_in_its_third_line(h, g, lower, upper):
    x = np.zeros(len(g))
    return np.linalg.solve(h, np.ones(3 + len(x)))


def test_the_failing_line_of_the_learners_own_code_is_shown():
    text = " ".join(str(BOUNDED_LEAST_SQUARES.grade(fails_in_its_third_line)).split())
    assert "LinAlgError" in text or "ValueError" in text
    assert "in line 3 of your function: return np.linalg.solve(h, np.ones(3 + len(x)))" in text


@pytest.mark.parametrize("steps, words", [(30, "diverges"), (5000, "diverges")])
def test_an_iteration_that_diverges_is_named_so(steps, words):
    def too_long_a_step(h, g, lower, upper):
        x = np.zeros(len(g))
        for _ in range(steps):
            x = x - 3.0 / np.linalg.norm(h, 2) * (h @ x - g)
        return x

    assert words in str(BOUNDED_LEAST_SQUARES.grade(too_long_a_step))


def test_the_share_of_the_exercise_is_that_of_the_evaluation():
    for case in ACTIVE_SHARE.cases():
        error = np.linalg.norm(case["tracked"] - case["true"], axis=2)
        motion = np.linalg.norm(case["true"], axis=2)
        assert ACTIVE_SHARE.truth(**case) == pytest.approx(active_share(error, motion, case["threshold"]), rel=1e-12)


# ---- for the teacher ----


def test_the_student_copy_holds_no_solution(tmp_path, capsys):
    target = tmp_path / "students"
    assert cli.main(["exercises", "--student", str(target)]) == 0
    names = {path.name for path in target.rglob("*")}
    assert names == {"README.md", *(path.name for path in SOLUTIONS.parent.glob("*.ipynb"))}
    start = (target / "README.md").read_text(encoding="utf-8")
    assert "--grade" in start and f"=={__version__}" in start
    assert all(f"`exercises.{variable_of(exercise)}.hint(1)`" in start for exercise in exercises.EXERCISES)
    text = "\n".join(path.read_text(encoding="utf-8") for path in target.glob("*.ipynb"))
    assert "solutions/" not in text and "olution is in" not in text
    for exercise in exercises.EXERCISES:
        assert f"def {exercise.name}(" in text
        for cell in cells_of(solution_of(exercise)):
            if cell["cell_type"] == "code" and "check(" not in "".join(cell["source"]):
                body = [line.strip() for line in cell["source"] if line.startswith("    ") and len(line) > 30]
                assert not [line for line in body if json.dumps(line)[1:-1] in text]
    assert cli.main(["exercises", "--student", str(target)]) == 2
    assert "name a new folder" in capsys.readouterr().err


def test_a_class_is_graded_with_points_and_remarks(tmp_path, capsys):
    folder = tmp_path / "class"
    (folder / "anna").mkdir(parents=True)
    for exercise in exercises.EXERCISES:
        (folder / "anna" / solution_of(exercise).name).write_bytes(solution_of(exercise).read_bytes())
    (folder / "ben.py").write_text(
        "import numpy as np\nfrom no_such_package import thing\nprint('hello')\nHALF = 0.5\n"
        "def rigidity(maps):\n    return HALF * np.ones(len(maps))\n"
        "def solve_deformation(laplacian, w1, w2, targets):\n    return targets\n"
    )
    (folder / "cem.ipynb").write_text("{")
    (folder / "dora.py").write_text("import os\ndef rigidity(maps):\n    os._exit(3)\n")
    assert cli.main(["exercises", "--grade", str(folder)]) == 0
    text = capsys.readouterr().out
    count = len(exercises.EXERCISES)
    assert f"anna: {count} of {count}" in text and "ben: 0 of" in text
    rows = json.loads((tmp_path / "class-grades" / "grades.json").read_text(encoding="utf-8"))
    remarks = {(row["student"], row["exercise"]): row["remark"] for row in rows}
    assert len(rows) == 4 * count
    assert "targets themselves came back" in " ".join(remarks["ben", "solve_deformation"].split())
    assert remarks["ben", "em_step"] == "not handed in" and "not a notebook" in remarks["cem", "em_step"]
    assert "status 3" in remarks["dora", "rigidity"]
    scope = json.loads((tmp_path / "class-grades" / "gradescope" / "anna.json").read_text(encoding="utf-8"))
    assert scope["score"] == count and {test["max_score"] for test in scope["tests"]} == {1}
    with open(tmp_path / "class-grades" / "grades.csv", newline="", encoding="utf-8") as stream:
        assert len([*csv.DictReader(stream)]) == 4 * count


def test_otter_test_files_call_the_graders(tmp_path):
    written = exercises.classroom.write_otter_tests(tmp_path / "tests", exercises.EXERCISES)
    assert [path.stem for path in written] == [exercise.name for exercise in exercises.EXERCISES]
    for path in written:
        space = ast.parse(path.read_text(encoding="utf-8"))
        assert any(isinstance(node, ast.FunctionDef) and node.name == f"test_{path.stem}" for node in space.body)
