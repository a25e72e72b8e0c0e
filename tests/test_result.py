"""Result files: the arrays of the contract, gaps filled without NaN, damaged files refused."""

from __future__ import annotations

import numpy as np
import pytest
from recordings import refusals

from adaptiveface.errors import FileFormatError
from adaptiveface.geometry.frame import FEATURE_IDS
from adaptiveface.model.actor import Actor
from adaptiveface.parameters import Parameters
from adaptiveface.result import Result, ResultBuilder
from adaptiveface.tracking.types import STAGE_NAMES, SampleState, TrackedFrame

N, A = 30, 5


@pytest.fixture
def actor() -> Actor:
    """A rig of 30 vertices with the layout of a real one."""
    rng = np.random.default_rng(0)
    return Actor(
        neutral=rng.normal(0, 60, (N, 3)),
        blendshapes=rng.normal(0, 5, (A, N, 3)),
        triangles=rng.integers(0, N, (50, 3)).astype(np.int32),
        frontal=np.arange(N) < 20,
        expression_names=tuple("abcde"),
        feature_triangles=rng.integers(0, N, (40, 3)).astype(np.int32),
        feature_weights=rng.dirichlet([1, 1, 1], 40),
        depth_valid=np.arange(N) < 15,
    )


def tracked_frame(actor: Actor, index: int, tracked: bool = True) -> TrackedFrame:
    rng = np.random.default_rng(index)
    pose = np.eye(4)
    pose[:3, 3] = [index, 2, 600]
    shapes = [actor.neutral + rng.normal(size=(N, 3)) for _ in range(4)]
    state = SampleState.LEARNED if tracked else SampleState.UNTRACKED
    distances = (0.5, 0.2, 0.1) if tracked else (np.nan,) * 3
    stage_ms = {name: float(k) for k, name in enumerate(STAGE_NAMES)} if tracked else {"rigid": 1.0}
    return TrackedFrame(
        index,
        index / 30,
        tracked,
        pose,
        *shapes,
        rng.random(A),
        rng.random(A),
        state,
        index,
        *distances,
        stage_ms,
        "" if tracked else "the head was not found",
    )


def build(actor: Actor, pattern: str, keep_stages: bool = False):
    """A run by letters: t tracked, u untracked, s skipped."""
    builder = ResultBuilder(actor, Parameters(), len(pattern) + 2, keep_stages)
    frames = [tracked_frame(actor, k, letter == "t") for k, letter in enumerate(pattern)]
    for k, letter in enumerate(pattern):
        if letter == "s":
            builder.skip(k / 30, f"depth/{k:05d}.png: missing")
        else:
            builder.add(frames[k])
    return builder.finish(), frames


def test_every_array_of_the_contract_is_written(actor, tmp_path):
    result, frames = build(actor, "ttt", keep_stages=True)
    result.save(tmp_path / "result.npz")
    with np.load(tmp_path / "result.npz", allow_pickle=False) as data:
        arrays = dict(data)
    for name in ("vertices", "v1", "v2", "v3"):
        assert (arrays[name].shape, arrays[name].dtype) == ((3, N, 3), np.float32)
    expected = {
        "triangles": ((50, 3), np.int32),
        "frontal": ((N,), bool),
        "tracked": ((3,), bool),
        "skipped": ((3,), bool),
        "timestamps": ((3,), np.float64),
        "rigid": ((3, 4, 4), np.float32),
        "coefficients": ((3, A), np.float32),
        "coefficients_initial": ((3, A), np.float32),
        "feature_vertices": ((40,), np.int32),
        "feature_ids": ((40,), np.int32),
        "corrective_updates": ((3,), np.int32),
        "sample_state": ((3,), np.int8),
        "stage_ms": ((3, len(STAGE_NAMES)), np.float32),
    }
    for name, (shape, dtype) in expected.items():
        assert (arrays[name].shape, arrays[name].dtype) == (shape, dtype), name
    assert arrays["expression_names"].tolist() == list("abcde") and arrays["stage_names"].tolist() == list(STAGE_NAMES)
    assert arrays["parameters"].shape == () and Parameters.from_json(str(arrays["parameters"])) == Parameters()
    np.testing.assert_array_equal(arrays["feature_ids"], FEATURE_IDS)
    for k, frame in enumerate(frames):
        np.testing.assert_allclose(arrays["vertices"][k], frame.v4 + frame.head_pose[:3, 3], atol=1e-3)
        np.testing.assert_allclose(arrays["v1"][k], frame.v1 + frame.head_pose[:3, 3], atol=1e-3)
    assert not list(tmp_path.glob("*.part"))


def test_a_result_is_read_back_as_it_was(actor, tmp_path):
    result, _ = build(actor, "utst", keep_stages=True)
    result.save(tmp_path / "result.npz")
    loaded = Result.load(tmp_path / "result.npz")
    for name in Result.__dataclass_fields__:
        np.testing.assert_array_equal(getattr(loaded, name), getattr(result, name), err_msg=name)


def test_frames_without_a_face_repeat_the_last_one_and_hold_no_nan(actor):
    result, frames = build(actor, "uttusstu")
    assert len(result) == 8
    assert result.tracked.tolist() == [False, True, True, False, False, False, True, False]
    assert result.skipped.tolist() == [False] * 4 + [True, True] + [False] * 2
    shown = [1, 1, 2, 2, 2, 2, 6, 6]
    for k, source in enumerate(shown):
        np.testing.assert_allclose(result.vertices[k], frames[source].vertices, atol=1e-3)
        np.testing.assert_allclose(result.head_pose[k], frames[source].head_pose)
        np.testing.assert_allclose(result.coefficients[k], frames[source].coefficients, atol=1e-6)
    states = [0, 2, 2, 0, 0, 0, 2, 0]
    assert result.sample_state.tolist() == states
    assert result.corrective_updates.tolist() == [0, 1, 2, 3, 3, 3, 6, 7]
    assert result.reasons[4] == "depth/00004.png: missing" and result.reasons[0] == "the head was not found"
    assert result.reasons[1] == ""
    for name in Result.__dataclass_fields__:
        value = np.asarray(getattr(result, name))
        assert value.dtype.kind != "f" or np.isfinite(value).all(), name


def test_a_run_that_never_found_the_face_shows_the_neutral(actor):
    result, _ = build(actor, "us")
    np.testing.assert_allclose(result.vertices[0], actor.neutral, atol=1e-4)
    np.testing.assert_array_equal(result.head_pose[1], np.eye(4))
    assert not result.tracked.any() and "0 tracked" in result.summary()


def test_fewer_expressions_than_the_rig_has(actor):
    parameters = Parameters().replace(**{"blendshapes.A": 3})
    builder = ResultBuilder(actor, parameters, 1)
    frame = tracked_frame(actor, 0)
    object.__setattr__(frame, "coefficients", frame.coefficients[:3])
    object.__setattr__(frame, "coefficients_initial", frame.coefficients_initial[:3])
    builder.add(frame)
    result = builder.finish()
    assert result.expression_names == ("a", "b", "c") and result.coefficients.shape == (1, 3)


def test_correctives_go_to_the_frontal_vertices(actor, tmp_path):
    builder = ResultBuilder(actor, Parameters(), 1)
    builder.add(tracked_frame(actor, 0))
    shapes = np.random.default_rng(1).normal(size=(60, 2))
    result = builder.finish(shapes)
    assert result.correctives.shape == (2, N, 3) and (result.correctives[:, 20:] == 0).all()
    np.testing.assert_allclose(result.correctives[1, :20].ravel(), shapes[:, 1], atol=1e-6)
    result.save(tmp_path / "result.npz")
    np.testing.assert_array_equal(Result.load(tmp_path / "result.npz").correctives, result.correctives)


def test_the_summary_counts(actor):
    result, _ = build(actor, "tttu" + 7 * "s")
    text = result.summary()
    assert "11 frames: 3 tracked, 1 without a face, 7 broken" in text and "learned from 3" in text
    assert "00004.png: missing" in text and "2 more" in text and "rigid 1.0" in text


def rewrite(path, **arrays):
    with np.load(path) as data:
        content = dict(data) | arrays
    np.savez(path, **{name: value for name, value in content.items() if value is not None})


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (dict(vertices=np.zeros((3, N - 1, 3), np.float32)), "shape"),
        (dict(vertices=np.full((3, N, 3), np.nan, np.float32)), "'vertices' holds NaN"),
        (dict(rigid=np.zeros((2, 4, 4), np.float32)), "'rigid'"),
        (dict(tracked=None), "'tracked' is missing"),
        (dict(triangles=np.full((50, 3), N, np.int32)), "'triangles' points outside"),
        (dict(feature_vertices=np.full(40, -1, np.int32)), "'feature_vertices' points outside"),
        (dict(sample_state=np.full(3, 9, np.int8)), "'sample_state'"),
        (dict(parameters=np.array(1.0)), "'parameters' has dtype"),
        (dict(expression_names=np.array([b"a"] * A)), "'expression_names' has dtype"),
        (dict(vertices=np.array([None] * 3)), "'vertices' holds Python objects"),
    ],
)
def test_wrong_arrays_are_named(actor, tmp_path, change, reason):
    path = tmp_path / "result.npz"
    build(actor, "ttt")[0].save(path)
    rewrite(path, **change)
    with pytest.raises(FileFormatError) as caught:
        Result.load(path)
    assert str(path) in str(caught.value) and reason in str(caught.value)


def test_damaged_files_raise_nothing_else(actor, tmp_path):
    path = tmp_path / "result.npz"
    build(actor, "ttt")[0].save(path)
    assert refusals(path, Result.load, 150) > 75
