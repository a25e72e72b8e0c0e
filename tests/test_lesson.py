"""The performance of notebook 06, shortened: what the text says of K, S, the startup and the two thresholds holds."""

from __future__ import annotations

import numpy as np
import pytest

from adaptiveface import views
from adaptiveface.studies import learning
from adaptiveface.studies.measures import model_features
from adaptiveface.studies.session import Session
from adaptiveface.synthetic import lesson
from adaptiveface.tracking.types import SampleState
from adaptiveface.views import pca_study

#: Frames of the lesson: the laugh, the rage, the faulty ones with some before them.
LAUGH, RAGE, FAULT = range(4, 42, 2), range(50, 86, 2), range(230, 241)
#: The same of the smirk, which only one test needs.
SMIRK = range(100, 128, 2)
HOLD_OF_LAUGH, HOLD_OF_RAGE = slice(8, 14), slice(len(LAUGH) + 7, len(LAUGH) + 13)
FAULTY = slice(-3, None)


@pytest.fixture(scope="module")
def session() -> Session:
    sensor = lesson.LessonSensor()
    start = sensor.neutral_frames
    frames = [sensor.read(start + k) for k in (*LAUGH, *RAGE, *FAULT)]
    return Session("lesson", sensor.camera, [sensor.read(k) for k in range(start)], frames)


def replay_with(session: Session, **changes) -> views.Replay:
    """All frames tracked under other parameters of the adaptive PCA."""
    parameters = views.Parameters().replace(**{f"adaptive_pca__{name}": value for name, value in changes.items()})
    replay = views.Replay(session.frames, session.actor, parameters)
    replay.run()
    return replay


@pytest.fixture(scope="module")
def default(session) -> views.Replay:
    return replay_with(session)


def left_over(replay: views.Replay, frames: slice) -> float:
    """What the adaptive space leaves over, as a share of what the anchor space leaves over."""
    return replay.series("adaptive_distance")[frames].mean() / replay.series("anchor_distance")[frames].mean()


def test_new_expressions_drop_out_within_a_few_frames(default):
    assert left_over(default, HOLD_OF_LAUGH) < 0.3 and left_over(default, HOLD_OF_RAGE) < 0.4


def test_k(session, default):
    assert left_over(replay_with(session, K=0), HOLD_OF_LAUGH) == 1
    one = replay_with(session, K=1)
    assert left_over(one, HOLD_OF_LAUGH) < 0.4, "one shape explains the laugh"
    assert left_over(one, HOLD_OF_RAGE) > 0.75, "but not the rage"
    assert left_over(replay_with(session, K=5), HOLD_OF_RAGE) < 0.5


def test_five_correctives_explain_all_three_expressions(session):
    sensor = lesson.LessonSensor()
    frames = [*session.frames[: len(LAUGH) + len(RAGE)], *(sensor.read(sensor.neutral_frames + k) for k in SMIRK)]
    with_smirk = Session("lesson", session.camera, session.neutral, frames, _actor=session.actor)
    one, five = (replay_with(with_smirk, K=K) for K in (1, 5))
    hold_of_smirk = slice(-7, None)
    assert left_over(one, hold_of_smirk) > 0.5
    assert max(left_over(five, frames) for frames in (HOLD_OF_LAUGH, HOLD_OF_RAGE, hold_of_smirk)) < 0.4


def test_s(session):
    """A short memory follows the present expression, far from the batch PCA of what it saw before."""
    last = len(LAUGH) + len(RAGE) - 1
    wide, short = replay_with(session, K=3), replay_with(session, K=3, S=6)
    samples = wide.model_after(last).buffer()
    angles = [learning.angle_to_batch(one.model_after(last), samples) for one in (wide, short)]
    assert angles[0] < 5 < 10 < angles[1]


def test_full_buffer_learns_late(session):
    late = replay_with(session, startup="full-buffer", S=30)
    first = next(k for k, r in enumerate(late.results) if r.corrective_updates)
    learned = [r.sample_state == SampleState.LEARNED for r in late.results]
    assert sum(learned[: first + 1]) == 30
    assert left_over(late, HOLD_OF_RAGE) > 1.3 * left_over(replay_with(session), HOLD_OF_RAGE)


def test_valid_min(session, default):
    """Above the rage's energy and below the laugh's, only the laugh is learned."""
    one = replay_with(session, valid_min=17.0)
    assert {r.sample_state for r in one.results[HOLD_OF_RAGE]} == {SampleState.IN_ANCHOR_SPACE}
    assert SampleState.LEARNED in {r.sample_state for r in one.results[HOLD_OF_LAUGH]}
    assert left_over(one, HOLD_OF_RAGE) > 0.75 and left_over(one, HOLD_OF_LAUGH) < 0.5


def test_valid_max(session, default):
    """Below the fault's energy it is an outlier; above, it is learned as if it were an expression."""
    strict = replay_with(session, valid_max=40.0)
    assert {r.sample_state for r in strict.results[FAULTY]} == {SampleState.OUTLIER}
    assert SampleState.LEARNED in {r.sample_state for r in default.results[FAULTY]}
    assert left_over(default, FAULTY) < 0.8 * left_over(strict, FAULTY)
    assert SampleState.OUTLIER not in {r.sample_state for r in strict.results[:-3]}, "no expression is lost"


def test_the_hand_is_not_learned_from():
    sensor = lesson.LessonSensor()
    clean, covered = (sensor.read(sensor.neutral_frames + k).depth for k in (lesson.HAND.start - 1, lesson.HAND.start))
    assert (covered > 0).mean() > 0.05 and covered[covered > 0].min() < clean[clean > 0].min() - 30


def test_singular_values_grow_with_the_expressions(session, default):
    in_laugh, after_laugh, after_rage = len(LAUGH) // 2, len(LAUGH) - 1, len(LAUGH) + len(RAGE) - 1
    alone = views.Replay(session.frames, session.actor, views.Parameters().replace(personal_blendshapes__on=False))
    alone.run()
    ends = (after_laugh, after_rage, in_laugh)
    seen, without = ([learning.singular_values(replay.model_after(k)) for k in ends] for replay in (default, alone))
    assert without[0][0] > 4 * without[0][1] and without[1][1] > 2 * without[0][1]
    assert 3 * seen[0][1] < seen[0][0] < without[0][0], "personal blendshapes learn a part of the laugh, too"
    assert seen[1][1] > seen[0][1]
    chart = pca_study.CorrectiveView(session).values
    assert max(values[0] for values in seen) < chart._high, "no bar is cut off"
    assert len(learning.singular_values(default.model_after(0))) == 0


def test_energy_chart(session, default):
    """Each tracked frame is marked once, with the energy that was compared with the thresholds; the lines steer sliders."""
    chart, source = pca_study.energy_chart(session)
    lines = source(default)
    state = {name: state for state, (name, _) in pca_study.MARKS.items()}
    for name, (frames, energies) in lines.items():
        assert all(default.results[k].sample_state == state[name] for k in frames)
        if name == "learned":
            assert energies.min() > 1 and energies.max() < 100
    assert sum(len(frames) for frames, _ in lines.values()) == sum(r.tracked for r in default.results)
    chart.update(3, **lines)

    class Bench:
        said: list[dict] = []

        def set(self, **values):
            self.said.append(values)

    chart.steer(Bench())
    chart.show(views.Parameters().replace(adaptive_pca__valid_max=60.0).adaptive_pca)
    assert Bench.said == [] and chart._image.high == 60.0, "following a slider moves no slider"
    chart._image.high = 40.0
    assert Bench.said == [{"adaptive_pca__valid_max": 40.0}]


def with_weights(session: Session, **changes) -> list:
    """The first frames, of the laugh, tracked with other weights."""
    replay = views.Replay(session.frames[:14], session.actor, views.Parameters().replace(**changes))
    return replay.run()


def feature_error(session: Session, results: list, stage: str) -> float:
    """Mean over the frames of the median distance between the model's and the measured features, pixels."""
    errors = []
    for frame, result in zip(session.frames, results, strict=False):
        points = model_features(session, getattr(result, stage), result.head_pose)
        distances = np.linalg.norm(frame.camera.project(points) - frame.features.pixels, axis=1)
        errors.append(np.nanmedian(distances))
    return float(np.mean(errors))


def roughness(session: Session, results: list) -> float:
    """Mean length of the Laplacian of what the deformation added, v2 - v1, over the frontal region, mm."""
    inside = session.actor.frontal[session.actor.triangles].all(axis=1)
    edges = np.vstack([session.actor.triangles[inside][:, pair] for pair in ([0, 1], [1, 2], [2, 0])])
    moved = [(r.v2 - r.v1) for r in results]
    return float(np.mean([np.linalg.norm(m[edges[:, 0]] - m[edges[:, 1]], axis=1).mean() for m in moved]))


def moved_by(results: list) -> float:
    """Mean length of v2 - v1, mm."""
    return float(np.mean([np.linalg.norm(r.v2 - r.v1, axis=1).mean() for r in results]))


def test_w(session):
    """w weighs the 2D features against the depth in the blendshape fit: without it they are missed, with much the depth is."""
    little, default, large = (with_weights(session, blendshapes__w=w) for w in (1e-7, 5e-5, 1e-2))
    missed = [feature_error(session, results, "v1") for results in (little, default, large)]
    assert missed[0] > 1.1 * missed[1] > 1.21 * missed[2]
    residuals = [np.mean([result.residual for result in results]) for results in (little, default, large)]
    assert residuals[2] > 1.3 * residuals[1] and residuals[0] < 1.05 * residuals[1]


def test_w1_and_w2(session):
    """w1 pulls to the depth and w2 smooths: much w1 does what little w2 does, rough skin; much w2 leaves v1 as it is."""
    default, much_w1, little_w2, much_w2 = (
        with_weights(session, **changes)
        for changes in ({}, {"laplacian__w1": 10.0}, {"laplacian__w2": 0.015}, {"laplacian__w2": 1e5})
    )
    assert roughness(session, much_w1) > 2 * roughness(session, default)
    assert roughness(session, little_w2) > 2 * roughness(session, default)
    assert moved_by(much_w2) < 0.1 * moved_by(default)


def test_charts_compare_with_the_samples_that_are_in_the_buffer(session):
    """A full buffer of distinct samples does not hold the newest ones; EM stays near the PCA of those that it holds."""
    last = len(LAUGH) + len(RAGE) - 1
    few = replay_with(session, K=3, S=8)
    model = few.model_after(last)
    assert model.count == 8 < model.seen and model.ages[:8].min() < model.seen - 8
    assert learning.angle_to_batch(model) < 15
    of_all = np.linalg.svd(model.buffer().astype(float), compute_uv=False) / np.sqrt(model.buffer().size / 3)
    np.testing.assert_allclose(learning.singular_values(model)[:2], of_all[:2], rtol=0.05)
