"""What real faces do with their expressions, as a penalty in the re-solve."""

from dataclasses import replace

import numpy as np
import pytest

from adaptiveface.model.face_model import embedded_face_model
from adaptiveface.neutral.capture import build_actor
from adaptiveface.parameters import Parameters
from adaptiveface.tracking.expression_prior import (
    GOOD_FIT,
    LIPS_KNOWN,
    LIPS_REACH,
    expression_statistics,
    habit_penalty,
    habit_trust,
    lips_count,
    lips_nearness,
)
from adaptiveface.tracking.resolve import SparseResolve

MODEL = embedded_face_model()
NAMES = list(MODEL.generic_names)
HABITS = Parameters().blendshapes
NONE = Parameters().replace(**{"blendshapes.expression_prior": 0}).blendshapes


@pytest.fixture(scope="module")
def actor():
    return build_actor(MODEL, MODEL.mean)


def row(**values: float) -> np.ndarray:
    """(A,) coefficients by name."""
    x = np.zeros(len(NAMES))
    for name, value in values.items():
        x[NAMES.index(name)] = value
    return x


def face(actor, misfit: float = 0.0, **values: float) -> np.ndarray:
    """(N, 3) mm, a mesh that the expressions miss by ``misfit`` (root mean square over the vertices, mm)."""
    noise = np.random.default_rng(0).normal(0.0, misfit / np.sqrt(3.0), MODEL.mean.shape)
    return MODEL.mean + np.tensordot(row(**values), actor.blendshapes, axes=1) + noise


def solved(actor, parameters, misfit: float = 0.0, **values: float) -> np.ndarray:
    """(A,) coefficients that the re-solve finds in :func:`face`."""
    return SparseResolve(actor, actor.blendshapes, parameters)(face(actor, misfit, **values))


def cost(**values: float) -> float:
    """Penalty of a combination."""
    x = row(**values)
    return float(x @ habit_penalty(NAMES) @ x)


def test_the_statistics_are_those_of_the_generic_expressions():
    names, moments = expression_statistics()
    assert list(names) == NAMES
    np.testing.assert_array_equal(moments, moments.T)
    assert np.linalg.eigvalsh(habit_penalty(NAMES)).min() > 0


def test_faces_that_people_make_cost_less():
    assert cost(mouthSmileLeft=0.5, mouthSmileRight=0.5) < 0.5 * cost(mouthLeft=0.5, mouthRight=0.5)
    assert cost(eyeBlinkLeft=1.0, eyeBlinkRight=1.0) < cost(eyeBlinkLeft=1.0)
    assert cost(jawOpen=0.5) < 0.5 * cost(jawForward=0.5)


def test_left_and_right_are_alike():
    assert cost(mouthSmileLeft=0.5, jawLeft=0.1) == pytest.approx(cost(mouthSmileRight=0.5, jawRight=0.1), rel=1e-3)


def test_another_rig_has_no_habits():
    assert not habit_penalty(["jawOpen", "frown"]).any()
    assert habit_penalty(["jawOpen", "mouthPucker"]).all()


def test_a_mouth_drawn_to_both_sides_at_once_is_widened_in_another_way(actor):
    drawn = dict(mouthLeft=0.5, mouthRight=0.5, mouthUpperUp=0.4)
    with_habits, without = (solved(actor, p, 0.8, **drawn) for p in (HABITS, NONE))
    sides = [NAMES.index("mouthLeft"), NAMES.index("mouthRight")]
    smile = [NAMES.index("mouthSmileLeft"), NAMES.index("mouthSmileRight")]
    assert with_habits[sides].max() < 0.8 * without[sides].max()
    assert with_habits[smile].min() > without[smile].max()


def test_what_people_do_is_found_nearly_as_before(actor):
    x = dict(jawOpen=0.5, mouthLowerDown=0.3, mouthStretch=0.3, browInnerUp=0.5, browOuterUp=0.4)
    found = solved(actor, HABITS, 0.55, **x)
    assert np.abs(found - row(**x)).max() < 0.2 and np.corrcoef(found, row(**x))[0, 1] > 0.95
    wink = solved(actor, HABITS, 0.55, eyeBlinkLeft=0.8)
    assert wink[NAMES.index("eyeBlinkLeft")] > 0.5 and wink[NAMES.index("eyeBlinkRight")] < 0.1


@pytest.mark.parametrize("name", ["mouthLowerDown", "chinRaise", "jawForward", "mouthRoll", "mouthUpperUp"])
def test_what_people_seldom_do_alone_keeps_its_size_where_the_expressions_fit(actor, name):
    np.testing.assert_array_equal(solved(actor, HABITS, 0.2, **{name: 0.8}), solved(actor, NONE, 0.2, **{name: 0.8}))
    assert solved(actor, HABITS, 0.8, **{name: 0.8})[NAMES.index(name)] < solved(actor, NONE, 0.8, **{name: 0.8}).max()


def test_habits_count_as_much_as_the_expressions_misfit():
    assert habit_trust(0.0, 100) == habit_trust(100 * GOOD_FIT**2, 100) == 0.0
    assert habit_trust(100 * (GOOD_FIT**2 + 0.5), 100) == pytest.approx(0.5)


def test_lips_count_more_as_the_expressions_misfit():
    counts = [lips_count(trust) for trust in (0.0, 0.1, 0.5, 1e9)]
    assert counts[0] == 0.0 and counts == sorted(counts)
    assert counts[-1] == pytest.approx(LIPS_KNOWN - 1.0)
    lips = np.array([[0.0, 0.0, 0.0], [50.0, 0.0, 0.0]])
    near = lips_nearness(np.array([[0.0, 0.0, 0.0], [50.0, LIPS_REACH, 0.0], [0.0, 1e3, 0.0]]), lips)
    np.testing.assert_allclose(near, [1.0, np.exp(-0.5), 0.0], atol=1e-12)


def test_landmarks_after_the_features_change_nothing(actor):
    """Without depth, the actor's features are followed by landmarks."""
    more = replace(
        actor,
        feature_triangles=np.concatenate([actor.feature_triangles, actor.triangles[:60]]),
        feature_weights=np.concatenate([actor.feature_weights, np.full((60, 3), 1 / 3)]),
    )
    mesh = face(actor, 0.8, mouthSmileLeft=0.5, jawOpen=0.3)
    few, many = (SparseResolve(a, actor.blendshapes, HABITS)(mesh) for a in (actor, more))
    np.testing.assert_array_equal(few, many)


def test_cheeks_that_a_scream_raises_are_no_smile(actor):
    """Cheeks move as in a smile while the lips do not: with the lips known better, less of a smile is seen."""
    smile = np.tensordot(row(mouthSmileLeft=0.5, mouthSmileRight=0.5), actor.blendshapes, axes=1)
    lips = np.einsum("fk,fkd->fd", actor.feature_weights[20:], actor.neutral[actor.feature_triangles[20:]])
    cheeks = (1.0 - lips_nearness(actor.neutral, lips))[:, None]
    mesh = face(actor, 0.8, jawOpen=0.6) + cheeks * smile
    resolve = SparseResolve(actor, actor.blendshapes, HABITS)
    found = resolve(mesh)
    resolve._lips_gram, resolve._lips = 0.0 * resolve._lips_gram, 0.0 * resolve._lips
    alike = resolve(mesh)
    sides = [NAMES.index("mouthSmileLeft"), NAMES.index("mouthSmileRight")]
    assert found[sides].mean() < 0.9 * alike[sides].mean()


def test_some_expressions_of_a_rig_are_solved_by_their_own_names(actor):
    names = ["jawOpen", "mouthSmileRight", "mouthSmileLeft"]
    mesh = MODEL.mean + np.tensordot(row(jawOpen=0.6), actor.blendshapes, axes=1)
    by_name = habit_penalty(NAMES)[np.ix_([NAMES.index(n) for n in names], [NAMES.index(n) for n in names])]
    assert not np.allclose(habit_penalty(names), by_name)  # the others' part is not known
    assert SparseResolve.of(actor, names, HABITS)(mesh) == pytest.approx([0.6, 0.0, 0.0], abs=0.05)


def test_the_paper_has_no_habits():
    assert HABITS.expression_prior > 0.0
    assert Parameters.paper().blendshapes.expression_prior == 0.0


def test_other_meshes_of_the_expressions_are_resolved_as_by_a_new_solver(actor):
    changed = actor.blendshapes * np.random.default_rng(1).uniform(0.8, 1.2, (len(NAMES), 1, 1))
    mesh = face(actor, 0.8, jawOpen=0.5, browInnerUp=0.4)
    found = SparseResolve(actor, actor.blendshapes, HABITS).with_basis(changed)(mesh)
    np.testing.assert_array_equal(found, SparseResolve(actor, changed, HABITS)(mesh))
