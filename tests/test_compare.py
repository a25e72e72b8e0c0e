"""Results and other trackers scored by the same measures; intervals over performers; differences of parameters."""

from __future__ import annotations

import csv
import dataclasses

import numpy as np
import pytest
from export_scene import save_run, tracked_result

from adaptiveface import cli
from adaptiveface.errors import AdaptiveFaceError, FileFormatError
from adaptiveface.evaluation import GroundTruth, bootstrap_interval, score_other, score_result
from adaptiveface.model.face_model import embedded_face_model
from adaptiveface.parameters import Parameters

MODEL = embedded_face_model()


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    """A folder with actor.npz, result.npz and ground_truth.npz, whose truth the result meets exactly; the result."""
    actor, result, _ = tracked_result(frames=6)
    folder = save_run(tmp_path_factory.mktemp("scene"), actor, result)
    performance, neutral = np.array([-1, 0, 0, 0, 1, 1], np.int8), actor.neutral.astype(np.float32)
    truth = dict(vertices=result.vertices, rigid=result.head_pose, neutral=neutral, performance=performance)
    np.savez(folder / "ground_truth.npz", **truth)
    return folder, actor, result


def other(folder, **arrays):
    path = folder / "other.npz"
    np.savez(path, **arrays)
    return path


def landmarks(result, slots) -> np.ndarray:
    corners, weights = MODEL.feature_triangles[slots], MODEL.feature_weights[slots]
    return np.einsum("fk,nfkd->nfd", weights, result.vertices[:, corners]).astype(np.float32)


def test_a_result_is_scored_as_it_was_while_it_was_tracked(scene):
    folder, actor, result = scene
    evaluation = score_result(result, GroundTruth.load(folder / "ground_truth.npz"), actor)
    assert evaluation.stages == ("v4",) and len(evaluation.index) == 6
    assert evaluation.summary("v4", 1)["active_share"] < 1e-4
    with pytest.raises(AdaptiveFaceError, match="6 frames, the truth 5"):
        score_result(result, GroundTruth(actor.neutral, lambda k: None, 5), actor)


def test_another_mesh_of_the_same_surface_has_no_error_and_a_shifted_one_its_shift(scene, tmp_path):
    folder, _, result = scene
    truth = GroundTruth.load(folder / "ground_truth.npz")
    order = np.random.default_rng(0).permutation(len(MODEL.mean))  # another numbering: only the surface counts
    triangles = np.argsort(order)[MODEL.triangles]
    same = score_other(other(tmp_path, vertices=result.vertices[:, order], triangles=triangles), truth)
    assert same["surface_p95"] < 1e-3 and same["lost"] == 0
    shifted = result.vertices[:, order] + np.float32([0, 0, 2.0])
    tracked = np.array([1, 1, 0, 1, 1, 1], bool)
    moved = score_other(other(tmp_path, vertices=shifted, triangles=triangles, tracked=tracked), truth)
    assert 1.0 < moved["surface_median"] <= 2.0 and moved["lost"] == pytest.approx(0.2)


def test_landmarks_are_compared_by_their_numbers(scene, tmp_path):
    folder, _, result = scene
    truth, slots = GroundTruth.load(folder / "ground_truth.npz"), [30, 3, 12]
    points, ids = landmarks(result, slots), MODEL.feature_ids[slots]
    exact = score_other(other(tmp_path, landmarks=points, landmark_ids=ids), truth)
    assert exact["landmark_mean"] < 1e-3
    off = score_other(other(tmp_path, landmarks=points + np.float32([3, 0, 4]), landmark_ids=ids), truth)
    assert off["landmark_mean"] == pytest.approx(5.0, abs=1e-3)
    swapped = score_other(other(tmp_path, landmarks=points, landmark_ids=ids[::-1].copy()), truth)
    assert swapped["landmark_mean"] > 5


@pytest.mark.parametrize(
    ("arrays", "words"),
    [
        ({}, "none"),
        ({"vertices": np.zeros((6, 4, 3), np.float32)}, "triangles"),
        ({"landmarks": np.zeros((6, 2, 3), np.float32)}, "landmark_ids"),
        ({"landmarks": np.zeros((5, 2, 3), np.float32), "landmark_ids": np.array([48, 54])}, "6 frames"),
        ({"landmarks": np.zeros((6, 2, 3), np.float32), "landmark_ids": np.array([3, 4])}, "landmark_ids"),
        ({"vertices": np.zeros((6, 4, 3), np.float32), "triangles": np.array([[0, 1, 4]])}, "triangles"),
    ],
)
def test_files_of_another_form_are_refused(scene, tmp_path, arrays, words):
    truth = GroundTruth.load(scene[0] / "ground_truth.npz")
    with pytest.raises(FileFormatError, match=words):
        score_other(other(tmp_path, **arrays), truth)


def test_the_command_scores_several_and_says_what_differs(scene, tmp_path, capsys):
    folder, actor, result = scene
    second = tmp_path / "second"
    second.mkdir()
    actor.save(second / "actor.npz")
    changed = dataclasses.replace(result, parameters=Parameters().replace(laplacian__w2=9.0).to_json())
    changed.save(second / "result.npz")
    truth = str(folder / "ground_truth.npz")
    call = ["evaluate", str(folder / "result.npz"), truth, str(second / "result.npz"), truth, "--csv", str(tmp_path / "t.csv")]
    assert cli.main(call) == 0
    text = capsys.readouterr().out
    assert "mean over 2 runs" in text and "laplacian.w2" in text and "9.0" in text
    with open(tmp_path / "t.csv", newline="") as stream:
        assert [row["result"] for row in csv.DictReader(stream)] == [call[1], call[3]]
    assert cli.main(["evaluate", str(folder / "result.npz")]) == 2
    assert "needs its truth" in capsys.readouterr().err
    np.savez(tmp_path / "lone.npz", landmarks=landmarks(result, [5]), landmark_ids=MODEL.feature_ids[[5]])
    assert cli.main(["evaluate", str(tmp_path / "lone.npz"), truth]) == 0
    assert "landmark_mean 0.000" in capsys.readouterr().out


def test_the_interval_of_the_mean_covers_it_as_often_as_it_says():
    rng = np.random.default_rng(5)
    hits = 0
    for trial in range(200):
        low, high = bootstrap_interval(rng.normal(1.0, 0.3, 20), seed=trial)
        hits += low <= 1.0 <= high
    assert 0.88 <= hits / 200 <= 0.99
    assert np.isnan(bootstrap_interval([1.0])).all() and bootstrap_interval([2.0, 2.0]) == (2.0, 2.0)


def test_parameters_say_what_differs():
    changed = Parameters().replace(laplacian__w2=9.0, adaptive_pca__K=3)
    default = Parameters()
    assert default.diff(changed) == {"laplacian.w2": (default.laplacian.w2, 9.0), "adaptive_pca.K": (default.adaptive_pca.K, 3)}
    assert not default.diff(Parameters())
    assert set(default.diff(Parameters.paper())) >= {"adaptive_pca.K"}
