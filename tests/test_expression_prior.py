"""What real faces do with their expressions, as a penalty in the re-solve."""

import numpy as np
import pytest

from adaptiveface.model.face_model import embedded_face_model
from adaptiveface.neutral.capture import build_actor
from adaptiveface.parameters import Parameters
from adaptiveface.tracking.expression_prior import expression_statistics, habit_penalty
from adaptiveface.tracking.resolve import SparseResolve

MODEL = embedded_face_model()
NAMES = list(MODEL.generic_names)
NONE = Parameters().blendshapes
HABITS = Parameters().replace(**{"blendshapes.habits": 90}).blendshapes


@pytest.fixture(scope="module")
def actor():
    return build_actor(MODEL, MODEL.mean)


def row(**values: float) -> np.ndarray:
    """(A,) coefficients by name."""
    x = np.zeros(len(NAMES))
    for name, value in values.items():
        x[NAMES.index(name)] = value
    return x


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
    mesh = MODEL.mean + np.tensordot(row(mouthLeft=0.5, mouthRight=0.5, mouthUpperUp=0.4), actor.blendshapes, axes=1)
    with_habits, without = (SparseResolve(actor, actor.blendshapes, p)(mesh) for p in (HABITS, NONE))
    sides = [NAMES.index("mouthLeft"), NAMES.index("mouthRight")]
    smile = [NAMES.index("mouthSmileLeft"), NAMES.index("mouthSmileRight")]
    assert with_habits[sides].max() < 0.8 * without[sides].max()
    assert with_habits[smile].min() > without[smile].max()


def test_what_people_do_is_found_nearly_as_before(actor):
    x = row(jawOpen=0.5, mouthLowerDown=0.3, mouthStretch=0.3, browInnerUp=0.5, browOuterUp=0.4)
    mesh = MODEL.mean + np.tensordot(x, actor.blendshapes, axes=1)
    found = SparseResolve(actor, actor.blendshapes, HABITS)(mesh)
    assert np.abs(found - x).max() < 0.2 and np.corrcoef(found, x)[0, 1] > 0.95
    wink = SparseResolve(actor, actor.blendshapes, HABITS)(
        MODEL.mean + np.tensordot(row(eyeBlinkLeft=0.8), actor.blendshapes, axes=1)
    )
    assert wink[NAMES.index("eyeBlinkLeft")] > 0.5 and wink[NAMES.index("eyeBlinkRight")] < 0.1


def test_some_expressions_of_a_rig_are_solved_by_their_own_names(actor):
    names = ["jawOpen", "mouthSmileRight", "mouthSmileLeft"]
    mesh = MODEL.mean + np.tensordot(row(jawOpen=0.6), actor.blendshapes, axes=1)
    by_name = habit_penalty(NAMES)[np.ix_([NAMES.index(n) for n in names], [NAMES.index(n) for n in names])]
    assert not np.allclose(habit_penalty(names), by_name)  # the others' part is not known
    assert SparseResolve.of(actor, names, HABITS)(mesh) == pytest.approx([0.6, 0.0, 0.0], abs=0.05)


def test_habits_are_off_unless_asked_for():
    assert NONE.habits == 0.0
    assert Parameters.paper().blendshapes.habits == 0.0
