"""Other parameters for a running tracker: as a new one would compute, without losing the head or what was learned."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scenes import coefficients, exact_actor, head_pose, posed_shape, render_frame

from adaptiveface.parameters import Parameters
from adaptiveface.tracking.adaptive_pca import AdaptiveModel
from adaptiveface.tracking.retune import retuned
from adaptiveface.tracking.tracker import FaceTracker

#: Everything is worth learning: the frames are rendered from the rig itself.
START = Parameters().replace(adaptive_pca__valid_min=0.0, adaptive_pca__K=5, adaptive_pca__S=12)


@pytest.fixture(scope="module")
def frames():
    actor = exact_actor()
    shapes = [posed_shape(actor, coefficients(actor, jawOpen=0.02 * i, mouthSmileLeft=0.03 * i)) for i in range(16)]
    return [render_frame(actor, s, head_pose((0.0, 0.01 * i, 0.0)), i, noise=0.5) for i, s in enumerate(shapes)]


@pytest.fixture
def tracker(frames):
    tracker = FaceTracker(exact_actor(), START)
    for frame in frames[:-1]:
        assert tracker.track(frame).tracked
    assert tracker.model.correctives.shape[1] == 5 and tracker.model.count == 12
    return tracker


@pytest.mark.parametrize(
    "change",
    [
        {"laplacian__w2": 3.0},
        {"laplacian__final_w2": 1.0},
        {"blendshapes__w": 3e-6},
        {"blendshapes__vertex_stride": 2},
        {"rigid__iterations": 2},
        {"rigid__half_weight_motion": 3.0},
        {"kalman__model": "off"},
        {"adaptive_pca__valid_max": 3.0},
        {"blendshapes__A": 12},
    ],
)
def test_the_next_frame_is_what_a_new_tracker_put_there_would_make_of_it(tracker, frames, change):
    parameters = START.replace(**change)
    fresh = FaceTracker(tracker.actor, parameters)
    changed = tracker.with_parameters(parameters)
    fresh.personal = changed.copy().personal
    fresh.wear_personal()
    x = tracker.state.coefficients[: len(fresh.state.coefficients)]
    keeps_filter = "kalman__model" not in change and len(x) == len(tracker.state.coefficients)
    fresh.state = replace(
        tracker.state,
        coefficients=x,
        v1=fresh.blendshapes.shape(x),
        filter=tracker.state.filter if keeps_filter else None,
    )
    fresh.model = changed.copy().model
    a, b = changed.track(frames[-1]), fresh.track(frames[-1])
    assert a.tracked and changed.parameters == parameters
    np.testing.assert_allclose(a.v4, b.v4, atol=1e-6)
    assert a.sample_state == b.sample_state


def test_fewer_or_more_correctives_are_the_principal_ones_of_the_buffer(tracker):
    samples = tracker.model.samples()
    assert samples.shape == (12, tracker.model.anchors.shape[0])
    _, _, rows = np.linalg.svd(samples - (samples @ tracker.model.anchors) @ tracker.model.anchors.T, full_matrices=False)
    for k in (2, 4, 8):
        model = tracker.with_parameters(START.replace(adaptive_pca__K=k)).model
        assert model.correctives.shape[1] == k and model.count == 12 and model.updates == tracker.model.updates
        cosines = np.linalg.svd(rows[:k] @ model.correctives, compute_uv=False)
        assert cosines.min() > 0.9999
        np.testing.assert_allclose(model.correctives.T @ model.correctives, np.eye(k), atol=1e-9)
        np.testing.assert_allclose(model.anchors.T @ model.correctives, 0, atol=1e-9)


def test_a_smaller_buffer_keeps_the_newest_samples_and_learning_goes_on(tracker, frames):
    newest = tracker.model.samples()[-8:]
    changed = tracker.with_parameters(START.replace(adaptive_pca__S=8, adaptive_pca__buffer="newest"))
    np.testing.assert_allclose(changed.model.samples(), newest, atol=1e-3)
    assert changed.model.correctives.shape[1] == 5
    before = changed.model.updates
    assert changed.track(frames[-1]).tracked and changed.model.updates == before + 1


def test_other_expressions_keep_head_and_samples(tracker, frames):
    changed = tracker.with_parameters(START.replace(blendshapes__A=6))
    assert np.array_equal(changed.pose, tracker.pose) and changed.model.count > 0
    assert len(changed.track(frames[-1]).coefficients) == 6


def test_relearning_gives_the_subspace_that_em_converges_to(tracker):
    parameters = START.adaptive_pca
    direct = AdaptiveModel(tracker.actor, tracker.blendshapes.basis, parameters)
    direct.learn_all(tracker.model.samples())
    em = tracker.copy().model
    for _ in range(200):
        em._update()
    assert np.linalg.svd(direct.correctives.T @ em.correctives, compute_uv=False).min() > 0.999


def test_nothing_learned_stays_nothing_and_no_correctives_are_possible(tracker):
    empty = FaceTracker(tracker.actor, START)
    assert empty.with_parameters(START.replace(adaptive_pca__K=3)).model.correctives.shape[1] == 0
    assert tracker.with_parameters(START.replace(adaptive_pca__K=0)).model.correctives.shape[1] == 0


def test_the_old_name_still_works_and_says_so(tracker):
    with pytest.warns(DeprecationWarning, match="with_parameters"):
        changed = retuned(tracker, START.replace(laplacian__w2=3.0))
    assert changed.parameters.laplacian.w2 == 3.0 and np.array_equal(changed.pose, tracker.pose)


def test_only_what_changed_is_made_again(tracker):
    stages = ("blendshapes", "kalman", "rigid", "deformation", "final_deformation")
    changes = {
        "laplacian.w2": {"deformation"},
        "laplacian.final_w2": {"final_deformation"},
        "laplacian.cg_iterations": set(),
        "rigid.iterations": {"rigid"},
        "kalman.process_noise": {"kalman"},
        "blendshapes.A": {"blendshapes", "rigid"},
    }
    for name, made in changes.items():
        changed = tracker.with_parameters(START.replace(**{name: 4 if name != "kalman.process_noise" else 0.1}))
        assert {stage for stage in stages if getattr(changed, stage) is not getattr(tracker, stage)} == made
