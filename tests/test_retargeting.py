"""Retargeting: coefficients initial and re-solved, smoothing, transfer of the correctives, all against known truth."""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from export_scene import tracked_result
from scenes import exact_actor, posed_shape

from adaptiveface.errors import FileFormatError, ParameterError
from adaptiveface.geometry.mesh import transform_points
from adaptiveface.model.actor import Actor
from adaptiveface.model.blendshapes import deformation_transfer
from adaptiveface.model.face_model import embedded_face_model
from adaptiveface.parameters import BlendshapeParameters, Parameters
from adaptiveface.retargeting.arkit import ARKIT_NAMES, arkit_weights
from adaptiveface.retargeting.character import Character
from adaptiveface.retargeting.correctives import carried_correctives, transferred_correctives
from adaptiveface.retargeting.loading import load_character
from adaptiveface.retargeting.resolve import blendshape_parameters
from adaptiveface.retargeting.retarget import driving_coefficients, increasing, retarget
from adaptiveface.retargeting.smoothing import (
    COMPARED,
    FILTERS,
    KalmanSmoothing,
    OneEuro,
    jitter,
    smoothing_costs,
    step_lag,
)
from adaptiveface.synthetic.performer import Performer
from adaptiveface.synthetic.script import performance
from adaptiveface.tracking.expression import BlendshapeFit
from adaptiveface.tracking.resolve import SparseResolve

sys.path.insert(0, str(Path(__file__).parents[1] / "data_synth"))
from evaluate_retargeting import SameStyle, coefficient_errors, performances  # noqa: E402


@pytest.fixture(scope="module")
def scene():
    return tracked_result()


# ---- coefficients ----


def test_initial_and_resolved_drive_the_curves(scene):
    _, result, _ = scene
    table = arkit_weights(result.expression_names)
    resolved, initial = retarget(result), retarget(result, "initial")
    np.testing.assert_allclose(resolved.curves, table.curves(result.coefficients), atol=1e-12)
    np.testing.assert_allclose(initial.curves, table.curves(result.coefficients_initial), atol=1e-12)
    assert np.abs(resolved.curves - initial.curves).max() > 0.01
    assert resolved.fps == pytest.approx(30) and not resolved.unknown
    with pytest.raises(ParameterError, match="resolved, initial"):
        retarget(result, "best")


def test_plain_resolve_is_exact_on_a_blendshape_mesh():
    actor = exact_actor()
    x = np.random.default_rng(0).uniform(0, 0.9, 23)
    solved = SparseResolve.of(actor, actor.expression_names, BlendshapeParameters(sparsity=0.0, ridge=1e-6))(
        posed_shape(actor, x)
    )
    np.testing.assert_allclose(solved, x, atol=1e-4)


def test_sparse_resolve_keeps_the_expressions_that_are_there_and_drops_the_rest():
    actor = exact_actor()
    x = np.zeros(23)
    x[[0, 5, 20]] = 0.6, 0.8, 0.5
    noise = np.random.default_rng(1).normal(0, 0.3, actor.neutral.shape)
    lasso = SparseResolve.of(
        actor, actor.expression_names, BlendshapeParameters(expression_prior=0.0)
    )  # habits have their own tests
    solved = lasso(posed_shape(actor, x) + noise)
    size = np.linalg.norm(actor.blendshapes[:, actor.frontal].reshape(23, -1), axis=1)
    assert (np.abs(solved - x) < 2.5 * np.sqrt(actor.frontal.sum() / 3500) / size + 0.02).all()  # the lasso's shrinkage
    assert (solved[x == 0] == 0).mean() > 0.9


def test_resolve_minimises_its_energy():
    actor = exact_actor()
    rng = np.random.default_rng(2)
    mesh = posed_shape(actor, rng.uniform(0, 0.5, 23)) + rng.normal(0, 0.5, actor.neutral.shape)
    x = SparseResolve.of(actor, actor.expression_names, BlendshapeParameters(sparsity=2.5, ridge=10.0, expression_prior=0.0))(
        mesh
    )
    basis = actor.blendshapes[:, actor.frontal].reshape(23, -1)
    wanted = (mesh - actor.neutral)[actor.frontal].ravel()
    scale = 2.5 * np.sqrt(actor.frontal.sum() / 3500)

    def energy(x):
        rest = x @ basis - wanted
        return rest @ rest + 10.0 * x @ x + 2 * scale * np.linalg.norm(basis, axis=1) @ x

    best = energy(x)
    for _ in range(200):
        assert energy(np.clip(x + rng.normal(0, 0.02, 23), 0, 1)) >= best - 1e-6 * abs(best)


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"sparsity": 0.0},
        {"sparsity": 60.0},
        {"ridge": 5000.0},
        {"upper": 0.3},
        {"lower": -0.5},
        {"lower": -1.0, "sparsity": 0.0, "ridge": 0.0},
    ],
)
def test_export_solves_with_the_parameters_of_the_run(scene, changes):
    """With the actor's rig beside it, a result gives the coefficients that its own tracker found."""
    actor, result, _ = scene
    parameters = Parameters().replace(**{f"blendshapes.{name}": value for name, value in changes.items()})
    fit = BlendshapeFit(actor, parameters.blendshapes)
    meshes = result.head_vertices
    meshes[0] = 2 * actor.neutral - meshes[3]  # an expression the other way
    vertices = np.stack([transform_points(m, v) for m, v in zip(result.head_pose.astype(float), meshes, strict=True)])
    tracked = np.stack([fit.resolve(v4, np.zeros(23)) for v4 in meshes])
    run = replace(
        result, vertices=vertices.astype(np.float32), parameters=parameters.to_json(), coefficients=tracked.astype(np.float32)
    )
    np.testing.assert_allclose(driving_coefficients(run, actor=actor), tracked, atol=1e-3)
    assert ((tracked < -0.02).any()) == ("lower" in changes)


def test_a_results_own_parameters_are_read_whatever_else_stands_there(scene):
    _, result, _ = scene
    stages = {"blendshapes": {"sparsity": 1.5}, "adaptive_pca": {"valid_min": 9, "valid_max": 1}, "later": {"x": 1}}
    assert blendshape_parameters(replace(result, parameters=json.dumps(stages))).sparsity == 1.5
    assert blendshape_parameters(replace(result, parameters="{}")) == Parameters().blendshapes
    for text in ("", "[1]", '{"blendshapes": 3}', '{"blendshapes": {"sparsity": -1}}', '{"blendshapes": {"new": 1}}'):
        with pytest.raises(ParameterError):
            blendshape_parameters(replace(result, parameters=text))


def test_resolve_refuses_another_actor(scene):
    with pytest.raises(FileFormatError, match="wiggleEars"):
        SparseResolve.of(scene[0], ["jawOpen", "wiggleEars"])


@pytest.mark.slow
def test_resolved_coefficients_beat_the_initial_ones_on_a_performer_with_known_coefficients():
    actor, _, (sensor, result), truth = performances(1000, 45, "structured-light")
    errors = coefficient_errors(sensor, truth, result, actor)
    assert errors["re-solved"] < 0.9 * errors["initial"], errors


# ---- correctives ----


@pytest.fixture(scope="module")
def pairs():
    """Of performers A: frames alone by coefficients and with transfer, and the truth, all on another head B."""
    model = embedded_face_model()
    out = []
    for seed in (1000, 1001, 1003):
        a = Performer(seed)
        other = np.clip(np.random.default_rng([seed, 7]).normal(0, 0.9, len(a.identity)), -2.2, 2.2)
        b = SameStyle(seed, other)
        script = performance(seed, a.expression_names, 100)[4::12]
        truth = np.stack([b.shape(row) for row in script])
        v4 = np.stack([a.shape(row) for row in script])
        rig = [deformation_transfer(model.mean, head.neutral, model.triangles, model.generic_expressions) for head in (a, b)]
        actor = replace(exact_actor(), neutral=a.neutral, blendshapes=rig[0])
        resolve = SparseResolve.of(actor, actor.expression_names)
        x = np.stack([resolve(shape) for shape in v4])
        v1 = a.neutral + np.tensordot(x, rig[0], axes=1)
        alone = b.neutral + np.tensordot(x, rig[1], axes=1)
        added = transferred_correctives(a.neutral, v1, v4, b.neutral, model.triangles)
        assert np.linalg.norm(a.neutral - b.neutral, axis=1)[model.frontal].mean() > 1.5
        out.append((b.neutral, truth, alone, alone + added, model.frontal))
    return out


def active_share(neutral, truth, shapes, front) -> float:
    """Error over vertices that truly move by more than 2 mm, as a share of their motion."""
    motion = np.linalg.norm(truth - neutral, axis=2)[:, front]
    error = np.linalg.norm(shapes - truth, axis=2)[:, front]
    return float(error[motion > 2].sum() / motion[motion > 2].sum())


def test_transfer_of_correctives_halves_the_targets_error(pairs):
    alone = [active_share(b, truth, plain, front) for b, truth, plain, _, front in pairs]
    added = [active_share(b, truth, rich, front) for b, truth, _, rich, front in pairs]
    assert np.mean(added) < 0.5 * np.mean(alone), (alone, added)
    assert all(rich < plain for rich, plain in zip(added, alone, strict=True))


def test_transfer_to_the_same_head_is_exact(scene):
    actor, result, v4 = scene
    x = result.coefficients.astype(float)
    v1 = actor.neutral + np.tensordot(x, actor.blendshapes, axes=1)
    added = transferred_correctives(actor.neutral, v1[:4], v4[:4], actor.neutral, actor.triangles)
    np.testing.assert_allclose(v1[:4] + added, v4[:4], atol=1e-3)


def test_correctives_reach_the_characters_skin_only(scene):
    actor, result, _ = scene
    short = replace(
        result,
        **{name: getattr(result, name)[:3] for name in ("vertices", "head_pose", "coefficients", "coefficients_initial")},
    )
    hag = load_character("hag")
    added = carried_correctives(short, actor, hag)(np.arange(3))
    assert added.shape == (3, len(hag.neutral), 3)
    assert np.linalg.norm(added[:, : hag.skin], axis=2).max() > 0.5
    assert not added[:, hag.skin :].any()
    assert np.linalg.norm(added[:, : hag.skin][:, ~actor.frontal], axis=2).max() < 0.5  # fades out beyond the face
    ball = Character("ball", hag.neutral[:9], hag.triangles[:0], ("jawOpen",), np.zeros((1, 9, 3)))
    with pytest.raises(ParameterError, match="ball"):
        carried_correctives(short, actor, ball)


def test_driving_coefficients_need_a_matching_actor(scene):
    actor, result, _ = scene
    other = Actor(
        actor.neutral,
        actor.blendshapes[:2],
        actor.triangles,
        actor.frontal,
        ("a", "b"),
        actor.feature_triangles,
        actor.feature_weights,
        actor.depth_valid,
    )
    with pytest.raises(FileFormatError, match="lacks"):
        driving_coefficients(result, "resolved", other)


# ---- smoothing ----


def test_one_euro_is_a_first_order_low_pass_at_rest():
    """With beta 0 the filter is linear: the answer to a step is 1 - (1 - a)^n."""
    euro = OneEuro(cutoff=1.5, beta=0.0)
    values = np.concatenate([[[0.0]], np.ones((20, 1))])
    a = 1 / (1 + 30 / (2 * np.pi * 1.5))
    np.testing.assert_allclose(euro.apply(values, np.arange(21) / 30)[1:, 0], 1 - (1 - a) ** np.arange(1, 21), atol=1e-9)


def test_one_euro_trades_jitter_against_lag():
    still = 0.3 + 0.02 * np.random.default_rng(0).normal(size=(300, 5))
    times = np.arange(300) / 30
    plain, quick, slow = jitter(still), OneEuro(2.0, 3.0), OneEuro(0.5, 0.0)
    assert jitter(quick.apply(still, times)) < 0.75 * plain
    assert jitter(slow.apply(still, times)) < 0.4 * plain
    assert step_lag(lambda values, _: values) == pytest.approx(0, abs=1e-6)
    assert step_lag(lambda values, _: np.concatenate([values[:3] * 0, values[:-3]])) == pytest.approx(100, abs=1e-6)
    assert step_lag(quick.apply) < 17 < step_lag(slow.apply)


def test_smoothing_a_performance_keeps_it_in_range(scene):
    smooth = retarget(scene[1], smoothing=OneEuro(1.0, 0.5))
    assert smooth.curves.min() >= 0 and smooth.curves.max() <= 1
    assert np.abs(np.diff(smooth.curves, axis=0)).sum() < np.abs(np.diff(retarget(scene[1]).curves, axis=0)).sum()


@pytest.mark.parametrize("name", FILTERS)
def test_streams_are_filtered_as_recordings_are(name):
    values = np.random.default_rng(4).uniform(size=(40, 5))
    smoothing, state, out = FILTERS[name](), None, []
    for value in values:
        smooth, state = smoothing.step(value, 1 / 30, state)
        out.append(smooth)
    np.testing.assert_allclose(out, smoothing.apply(values, np.arange(40) / 30), atol=1e-12)


def test_kalman_readings_differ_as_documented():
    """Section 4.2's noises read as variances: a gain of 0.9; as white acceleration: a late and smooth answer."""
    quick, slow = KalmanSmoothing(), KalmanSmoothing("acceleration")
    step = np.concatenate([np.zeros((60, 1)), np.ones((60, 1))])
    assert quick.apply(step, np.arange(120) / 30)[60, 0] == pytest.approx(0.9, abs=0.03)
    assert step_lag(quick.apply) < 5 and step_lag(slow.apply) > 200
    assert quick.step(np.zeros(3), 1 / 30, None)[0].shape == (3,)


def test_costs_of_smoothing_hold_every_filter():
    still = 0.3 + 0.02 * np.random.default_rng(0).normal(size=(200, 4))
    rows = smoothing_costs(still)
    assert [row.name for row in rows] == ["none", *COMPARED]
    assert rows[0].jitter == pytest.approx(0.02, rel=0.1) and rows[0].lag == 0
    assert all(row.jitter < rows[0].jitter and row.lag > 0 for row in rows[1:])


@pytest.mark.parametrize("values", [{"cutoff": 0.0}, {"beta": -1.0}, {"cutoff": float("nan")}, {"speed_cutoff": 1e9}])
def test_one_euro_refuses_nonsense(values):
    with pytest.raises(ParameterError):
        OneEuro(**values)


def test_timestamps_become_increasing():
    np.testing.assert_allclose(increasing(np.array([5.0, 5.1, 5.3])), [0, 0.1, 0.3])
    np.testing.assert_allclose(increasing(np.array([0.0, 0.1, 0.1, 0.3])), np.arange(4) * 0.1)
    np.testing.assert_allclose(increasing(np.array([0.0, np.nan, 0.2]))[[0]], 0)
    assert (np.diff(increasing(np.array([1.0, 0.5, 0.2]))) > 0).all()
    assert len(ARKIT_NAMES) == 52
