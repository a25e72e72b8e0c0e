"""Expressions that become the person's own while tracking: what is learned, from which frames, and what never changes."""

from dataclasses import replace

import numpy as np
import pytest
from scenes import coefficients, exact_actor, head_pose, posed_shape, render_frame

from adaptiveface.errors import FileFormatError
from adaptiveface.export.animation import actor_animation
from adaptiveface.model.actor import Actor
from adaptiveface.parameters import Parameters, PersonalBlendshapesParameters
from adaptiveface.result import Result
from adaptiveface.retargeting.retarget import driving_coefficients
from adaptiveface.tracking.personal_blendshapes import PersonalBlendshapes, _solutions
from adaptiveface.tracking.tracker import FaceTracker
from adaptiveface.tracking.types import SampleState
from adaptiveface.views.replay import Replay

ON = Parameters().replace(
    personal_blendshapes__on=True, personal_blendshapes__interval=5, personal_blendshapes__noise=2.0, adaptive_pca__K=0
)


def small_basis(seed=0, expressions=3, vertices=40):
    """(A, n, 3) expressions; the last quarter of the vertices is moved by none of them."""
    basis = 5.0 * np.random.default_rng(seed).normal(size=(expressions, vertices, 3))
    basis[:, -vertices // 4 :] = 0.0
    return basis


def learned(basis, change, frames=400, offset=0.0, seed=1, **parameters):
    """What is learned from frames of a person whose expressions are ``basis + change``; (change, the learner)."""
    settings = PersonalBlendshapesParameters(on=True, **{"interval": 4, "noise": 1.0, "memory": 100000} | parameters)
    learner, rng = PersonalBlendshapes(basis, settings), np.random.default_rng(seed)
    for _ in range(frames):
        x = rng.uniform(0, 1, len(basis)) * (rng.uniform(size=len(basis)) < 0.6)
        learner.learn(x, (np.tensordot(x, basis + change, axes=1) + offset).ravel())
    return learner


def test_a_persons_own_expressions_are_found():
    basis = small_basis()
    change = 0.2 * np.random.default_rng(5).normal(size=basis.shape) * np.linalg.norm(basis, axis=2, keepdims=True)
    error = learned(basis, change).change - change
    assert np.sqrt((error**2).mean()) < 0.03 * np.sqrt((change**2).mean())


def test_the_meshes_are_those_of_the_equation():
    """For each vertex (D G D + noise 1) z = D R, against NumPy; more vertices than are solved for side by side."""
    rng = np.random.default_rng(4)
    rows, moments, deviations = rng.standard_normal((50, 6)), rng.standard_normal((6, 20, 3)), rng.uniform(0, 1, (20, 6))
    gram = rows.T @ rows
    found = _solutions(gram, moments, deviations, 4.0)
    for v, d in enumerate(deviations):
        z = np.linalg.solve(d[:, None] * gram * d + 4.0 * np.eye(6), d[:, None] * moments[:, v])
        np.testing.assert_allclose(found[:, v], (d[:, None] * z)[:-1], rtol=1e-9, atol=1e-12)


def test_expressions_change_only_where_they_move():
    basis = small_basis()
    change = learned(basis, np.ones_like(basis)).change
    assert np.abs(change[:, :30]).max() > 0.5
    np.testing.assert_array_equal(change[:, 30:], 0.0)


def test_what_is_off_at_rest_is_no_expression():
    """A neutral that is wrong by half a millimetre everywhere, in every frame."""
    basis = small_basis()
    assert np.abs(learned(basis, 0.0 * basis, offset=0.5).change).max() < 0.01


def test_a_face_at_rest_forgets_nothing():
    basis = small_basis()
    learner = learned(basis, 0.2 * basis, memory=50)
    before = learner.change.copy()
    for _ in range(500):
        learner.learn(np.zeros(3), np.zeros(basis[0].size))
    np.testing.assert_allclose(learner.change, before, atol=0.02)


@pytest.mark.parametrize(("name", "least", "most"), [("jawOpen", 0.3, 1.0), ("eyeBlinkLeft", 0.0, 0.1)])
def test_lids_hardly_change(name, least, most):
    """Narrow eyes add half a blink to every frame; what was seen of it taught that a blink is small."""
    basis, rng = small_basis(expressions=2), np.random.default_rng(1)
    learner = PersonalBlendshapes(basis, PersonalBlendshapesParameters(on=True, interval=4, noise=2.0), (name, "mouthPucker"))
    for _ in range(30):
        true = rng.uniform(0.0, 0.5, 2)
        learner.learn(true + [0.5, 0.0], np.tensordot(true, basis, axes=1).ravel())
    assert least < -(learner.change[0] * basis[0]).sum() / (basis[0] ** 2).sum() < most


def test_few_frames_change_little():
    basis = small_basis()
    sizes = [np.abs(learned(basis, 0.2 * basis, frames=n, noise=5.0).change).mean() for n in (8, 40, 400)]
    assert sizes[0] < 0.7 * sizes[1] < 0.7 * sizes[2] and sizes[2] < np.abs(0.2 * basis).mean()


def test_copies_learn_each_for_itself():
    basis = small_basis()
    first = learned(basis, 0.2 * basis, frames=50)
    second = first.copy()
    kept = first.change.copy(), first._gram.copy(), first._moments.copy()
    for _ in range(20):
        second.learn(np.ones(3), np.ones(basis[0].size))
    for before, now in zip(kept, (first.change, first._gram, first._moments), strict=True):
        np.testing.assert_array_equal(before, now)
    assert np.abs(second.change - first.change).max() > 0.01


# ---- in the tracker ------------------------------------------------------------------------------------------------
@pytest.fixture(scope="module")
def actor():
    return exact_actor()


@pytest.fixture(scope="module")
def person(actor):
    """The same face with expressions of its own, which go aside by a third of the way."""
    aside = np.cross(actor.blendshapes, [0.1, 0.3, 0.1])
    return replace(actor, blendshapes=actor.blendshapes + aside)


@pytest.fixture(scope="module")
def performance(actor, person):
    """Coefficients (F, A) and the frames in which the person performs them."""
    phase = np.linspace(0, 4 * np.pi, 44)
    x = np.stack(
        [
            coefficients(
                actor,
                jawOpen=0.4 - 0.4 * np.cos(a),
                mouthSmileLeft=0.4 - 0.4 * np.cos(1.5 * a),
                mouthSmileRight=0.4 - 0.4 * np.cos(1.5 * a),
                browInnerUp=0.4 - 0.4 * np.cos(2 * a),
            )
            for a in phase
        ]
    )
    frames = [render_frame(person, posed_shape(person, row), head_pose(), k, noise=0.3) for k, row in enumerate(x)]
    return x, frames


@pytest.fixture(scope="module")
def tracker(actor, performance):
    """A tracker that has seen the performance once."""
    tracker = FaceTracker(actor, ON)
    assert all(tracker.track(frame).tracked for frame in performance[1])
    assert tracker.personal.updates >= 5
    return tracker


def test_known_coefficients_are_met_better(actor, tracker, performance):
    """The repeat of a performance, with the expressions of the rig and with those learned the first time."""
    x, frames = performance
    errors = {}
    for name, rig in (("transferred", actor), ("personal", tracker.personal_actor())):
        again = FaceTracker(rig, Parameters().replace(adaptive_pca__K=0))
        found = np.array([again.track(frame).coefficients for frame in frames[::3]])
        errors[name] = np.sqrt(np.mean((found - x[::3]) ** 2))
    assert errors["personal"] < 0.93 * errors["transferred"]


def test_the_neutral_stays_what_it_is(actor, tracker):
    zero = np.zeros(len(tracker.blendshapes.basis))
    assert np.abs(tracker.blendshapes.basis - actor.blendshapes[: len(zero)]).max() > 0.5
    np.testing.assert_array_equal(tracker.blendshapes.shape(zero), actor.neutral)
    np.testing.assert_array_equal(tracker.personal_actor().neutral, actor.neutral)
    np.testing.assert_array_equal(
        tracker.blendshapes.basis[:, ~actor.frontal],
        actor.blendshapes[: len(zero)][:, ~actor.frontal].astype(np.float32),
    )


def test_a_frame_behind_a_hand_teaches_nothing(tracker, performance):
    frame = performance[1][-1]
    depth = frame.depth.copy()
    rows, columns = np.nonzero(depth)
    near = depth[rows, columns].min() - 60.0
    middle = int(columns.mean())
    depth[rows.min() : rows.max(), middle : middle + 90] = near
    hidden, before = tracker.copy(), tracker.personal._gram.copy()
    result = hidden.track(replace(frame, depth=depth))
    assert result.tracked and result.sample_state is SampleState.HIDDEN
    np.testing.assert_array_equal(hidden.personal._gram, before)
    seen = tracker.copy()
    assert seen.track(frame).tracked and np.abs(seen.personal._gram - before).max() > 0.1


def test_frozen_learning_keeps_the_expressions_as_they_are(tracker, performance):
    frozen = tracker.with_parameters(ON.replace(adaptive_pca__learn=False))
    before = frozen.personal._gram.copy()
    assert all(frozen.track(frame).tracked for frame in performance[1][:6])
    np.testing.assert_array_equal(frozen.personal._gram, before)
    np.testing.assert_array_equal(frozen.blendshapes.basis, tracker.blendshapes.basis)


def test_the_same_frames_give_the_same_bits(actor, tracker, performance):
    again = FaceTracker(actor, ON)
    for frame in performance[1]:
        result = again.track(frame)
    np.testing.assert_array_equal(again.blendshapes.basis, tracker.blendshapes.basis)
    np.testing.assert_array_equal(result.v4, tracker.state.v4)
    again.reset()
    assert again.blendshapes is again.transferred and not again.personal.change.any()


def test_they_are_kept_with_the_actor_when_asked(actor, tracker, tmp_path):
    path = tmp_path / "actor.npz"
    tracker.personal_actor().save(path)
    np.testing.assert_allclose(Actor.load(path).blendshapes[:23], tracker.blendshapes.basis, atol=1e-4)
    np.testing.assert_array_equal(FaceTracker(tracker.given, ON).blendshapes.basis, actor.blendshapes[:23])


def test_other_parameters_keep_what_was_learned(tracker):
    softer = tracker.with_parameters(ON.replace(blendshapes__w=1e-5, laplacian__w2=2.0))
    np.testing.assert_array_equal(softer.blendshapes.basis, tracker.blendshapes.basis)
    off = tracker.with_parameters(ON.replace(personal_blendshapes__on=False))
    assert off.personal is None and off.blendshapes is off.transferred


def test_the_paper_goes_without(actor, performance):
    assert not Parameters.paper().personal_blendshapes.on
    tracker = FaceTracker(actor, Parameters.paper())
    tracker.track(performance[1][0])
    assert tracker.personal is None and tracker.blendshapes is tracker.transferred


def test_results_hold_the_expressions_that_their_coefficients_mean(actor, tracker, performance, tmp_path):
    """Mesh and coefficients of a saved result belong together: exports, reports and retargeting build on that."""
    again, frames = tracker.copy(), performance[1][:4]
    tracked = [again.track(frame) for frame in frames]
    result = Result.of_frames(tracked, actor, ON, again.model.correctives, again.expressions, keep_stages=True)
    result.save(tmp_path / "result.npz")
    loaded = Result.load(tmp_path / "result.npz")
    rig = loaded.rig(actor)
    np.testing.assert_allclose(rig.blendshapes[:23], again.blendshapes.basis, atol=1e-4)
    np.testing.assert_array_equal(rig.blendshapes[23:], actor.blendshapes[23:])
    for index, frame in enumerate(tracked):
        v1 = posed_shape(rig, np.append(frame.coefficients_initial, np.zeros(len(actor.blendshapes) - 23)))
        np.testing.assert_allclose(v1, frame.v1, atol=1e-3)
        np.testing.assert_allclose(frame.in_camera(v1), loaded.v1[index], atol=1e-3)
    resolved = driving_coefficients(loaded, "resolved", actor)
    np.testing.assert_allclose(resolved, loaded.coefficients, atol=2e-3)
    mesh = actor_animation(loaded, actor)
    names = list(mesh.target_names)
    np.testing.assert_allclose(mesh.targets[names.index("jawOpen")], rig.blendshapes[names.index("jawOpen")], atol=1e-4)


def test_a_result_without_learned_expressions_goes_with_the_actors(actor, performance):
    off = FaceTracker(actor, ON.replace(personal_blendshapes__on=False))
    result = Result.of_frames([off.track(performance[1][0])], actor, off.parameters, None, off.expressions)
    assert off.expressions is None and result.expressions is None and result.rig(actor) is actor
    stranger = replace(actor, expression_names=tuple(f"other {k}" for k in range(len(actor.expression_names))))
    with pytest.raises(FileFormatError, match="lacks the expressions jawOpen"):
        result.rig(stranger)
    with pytest.raises(FileFormatError, match="different meshes"):
        result.rig(replace(actor, triangles=actor.triangles[:, [1, 2, 0]]))


def test_trackers_of_the_past_fit_with_the_expressions_of_then(actor, performance):
    """Previews of an early frame must not use what was learned later; kept meshes cost no more for it."""
    frames = performance[1][:24]
    replay = Replay(frames, actor, ON)
    replay.run()
    plain, wanted = FaceTracker(actor, ON), []
    for frame in frames:
        wanted.append(plain.blendshapes.basis)
        plain.track(frame)
    assert plain.personal.updates >= 3
    for index in (1, 9, 17, 23):
        before = replay._history.before(index)
        np.testing.assert_allclose(before.blendshapes.basis, wanted[index], atol=1e-5)
        assert before.personal is None or before.personal._moments.nbytes == 0
        v1 = replay._keeper.meshes(replay.results[index])[0]
        np.testing.assert_array_equal(v1, replay.results[index].v1)
        assert replay.results[index]._parts[0][1].nbytes == 0, "v1 is made of coefficients and expressions"
    softer = ON.replace(laplacian__final_w2=50.0)
    exact = replay.preview(softer, 9)
    replay.preview(softer, 23)
    replay.parameters = softer
    np.testing.assert_allclose(replay._quick_preview(9).v4, exact.v4, atol=1e-6)


def test_forgetting_what_was_learned_forgets_the_expressions_and_not_the_head(tracker, performance):
    other = tracker.copy()
    pose = other.pose
    other.forget_learned()
    assert other.model.count == 0 and other.expressions is None and np.array_equal(other.pose, pose)
    assert tracker.expressions is not None, "the tracker that was copied keeps them"
    assert other.track(performance[1][0]).tracked
