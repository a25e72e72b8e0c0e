"""The measures on cases whose answer is known, and the scoring of constructed runs."""

import importlib
import sys
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import trimesh

from adaptiveface import evaluation as ev
from adaptiveface.errors import AdaptiveFaceError, FileFormatError
from adaptiveface.geometry.mesh import rotation_vector_matrix, transform_points, vertex_normals
from adaptiveface.model.actor import Actor
from adaptiveface.model.face_model import embedded_face_model
from adaptiveface.synthetic.sensor import SyntheticSensor
from adaptiveface.tracking.tracker import FaceTracker
from adaptiveface.tracking.types import SampleState, TrackedFrame


def grid(n: int = 12, spacing: float = 4.0) -> tuple[np.ndarray, np.ndarray]:
    """A flat square of n x n vertices in the plane z = 0."""
    x, y = np.meshgrid(np.arange(n) * spacing, np.arange(n) * spacing)
    vertices = np.stack([x.ravel(), y.ravel(), np.zeros(n * n)], axis=1)
    corner = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).ravel()
    lower = np.stack([corner, corner + 1, corner + n], axis=1)
    upper = np.stack([corner + 1, corner + n + 1, corner + n], axis=1)
    return vertices, np.concatenate([lower, upper])


def pose(rotation=(0.1, -0.2, 0.05), translation=(20.0, -10.0, 600.0)) -> np.ndarray:
    transform = np.eye(4)
    transform[:3, :3] = np.diag([1.0, -1.0, -1.0]) @ rotation_vector_matrix(np.array(rotation))
    transform[:3, 3] = translation
    return transform


def test_surface_distance_of_known_offsets():
    vertices, triangles = grid()
    inner = (vertices[:, :2] > 5).all(1) & (vertices[:, :2] < 39).all(1)
    assert ev.surface_distance(vertices, vertices, triangles).max() == 0
    lifted = vertices + [0.0, 0.0, 0.7]
    assert np.allclose(ev.surface_distance(lifted, vertices, triangles, inner), 0.7)
    slid = vertices + [1.3, -0.9, 0.0]
    assert np.allclose(ev.surface_distance(slid, vertices, triangles, inner), 0, atol=1e-12)
    outside = np.array([[-3.0, -4.0, 0.0], [-3.0, 20.0, 4.0]])  # past a corner, past an edge
    assert np.allclose(ev.TrueSurface(vertices, triangles).distance(outside), [5.0, 5.0])


def test_surface_distance_equals_the_search_over_all_triangles():
    model = embedded_face_model()
    rng = np.random.default_rng(3)
    points = (model.mean + rng.normal(0, 1.5, model.mean.shape))[model.depth_valid][::40]
    corners = model.mean[model.triangles]
    exact = []
    for point in points:
        closest = trimesh.triangles.closest_point(corners, np.broadcast_to(point, (len(corners), 3)))
        exact.append(np.linalg.norm(closest - point, axis=1).min())
    assert np.allclose(ev.TrueSurface(model.mean, model.triangles).distance(points), exact, atol=1e-9)


def test_split_by_normal():
    normals = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0]])
    normal, tangential = ev.split_by_normal(np.array([[3.0, 4.0, -2.0], [0.0, 0.5, 0.0]]), normals)
    assert np.allclose(normal, [-2.0, 0.5]) and np.allclose(tangential, [5.0, 0.0])


def test_active_share_ignores_what_does_not_move():
    motion = np.array([[0.0, 1.9, 4.0], [6.0, 0.0, 2.0]])
    error = np.array([[9.0, 9.0, 1.0], [2.0, 9.0, 9.0]])
    assert ev.active_share(error, motion) == pytest.approx(3.0 / 10.0)
    assert ev.active_share(motion, motion) == 1.0
    assert np.isnan(ev.active_share(error, np.zeros_like(motion)))


def test_pose_error_of_a_known_turn_and_shift():
    truth, alignment = pose(), np.eye(4)
    turned = truth @ np.block([[rotation_vector_matrix(np.radians([0, 2.0, 0])), np.zeros((3, 1))], [np.eye(4)[3:]]])
    shift, angle = ev.pose_error(turned, truth, alignment, np.zeros(3))
    assert shift == pytest.approx(0, abs=1e-9) and angle == pytest.approx(2.0)
    moved = truth.copy()
    moved[:3, 3] += [0.0, 3.0, 4.0]
    assert ev.pose_error(moved, truth, alignment, np.ones(3)) == pytest.approx((5.0, 0.0), abs=1e-6)


def test_regions_are_disjoint_frontal_and_symmetric():
    model = embedded_face_model()
    regions = ev.actor_regions(model)
    assert tuple(regions) == ev.REGIONS
    total = np.sum(list(regions.values()), axis=0)
    assert total.max() == 1 and not total[~model.frontal].any()
    for name, mask in regions.items():
        assert mask.sum() > 50, name
        assert abs(model.mean[mask][:, 0].mean()) < 1.0, name
    assert model.mean[regions["brows"], 1].mean() > model.mean[regions["eyes"], 1].mean()
    assert model.mean[regions["chin"], 1].max() < model.mean[regions["lips"], 1].mean()


# ---- constructed runs: a face that smiles while the head turns


@dataclass
class Truth:
    vertices: np.ndarray
    head_pose: np.ndarray
    performance: int


class Sensor:
    """Two neutral frames, then the same smile twice, with a moving head."""

    def __init__(self):
        self.model = embedded_face_model()
        units = dict(zip(self.model.expression_names, self.model.expressions, strict=True))
        self.smile = units["mouthSmileLeft"] + units["jawOpen"]
        self.amount = [0.0, 0.0, 0.4, 1.0, 0.4, 1.0]
        self.number = [ev.NEUTRAL, ev.NEUTRAL, ev.FIRST, ev.FIRST, ev.REPEAT, ev.REPEAT]

    def __len__(self):
        return len(self.amount)

    def rigid(self, i):
        return pose(rotation=(0.05 * i, 0.02 * i, 0.0))

    def ground_truth(self, i):
        head = self.model.mean + self.amount[i] * self.smile
        return Truth(transform_points(self.rigid(i), head), self.rigid(i), self.number[i])


def tracked(i, rigid, head, is_tracked=True) -> TrackedFrame:
    stages = head if isinstance(head, tuple) else (head,) * 4
    return TrackedFrame(i, i / 30, is_tracked, rigid, *stages, np.zeros(23), np.zeros(23), SampleState.LEARNED, i)


@pytest.fixture(scope="module")
def sensor():
    return Sensor()


def test_perfect_run_scores_zero_even_in_another_head_frame(sensor):
    other = pose(rotation=(0.02, 0.01, -0.03), translation=(1.0, 2.0, -3.0))
    back = np.linalg.inv(other)
    actor = Actor.untransferred(sensor.model, transform_points(back, sensor.model.mean))
    frames = [
        tracked(i, sensor.rigid(i) @ other, transform_points(back, sensor.model.mean + sensor.amount[i] * sensor.smile))
        for i in range(len(sensor))
    ]
    result = ev.evaluate_run(frames, sensor, actor)
    assert result.surface.max() < 1e-3 and np.abs(result.normal).max() < 1e-3 and result.tangential.max() < 1e-3
    assert result.pose_shift.max() < 1e-6 and result.pose_angle.max() < 1e-4
    assert result.summary("v4", ev.REPEAT)["active_share"] < 1e-3


def test_face_that_never_moves_scores_one(sensor):
    actor = Actor.untransferred(sensor.model, sensor.model.mean)
    frames = [tracked(i, sensor.rigid(i), sensor.model.mean) for i in range(len(sensor))]
    result = ev.evaluate_run(frames, sensor, actor)
    for performance in (ev.FIRST, ev.REPEAT, None):
        assert result.active_share("v4", performance) == pytest.approx(1.0, abs=1e-6)


def test_constant_error_of_the_neutral_is_removed_but_a_wrong_pose_is_not(sensor):
    rng = np.random.default_rng(5)
    bias = rng.normal(0, 1.0, sensor.model.mean.shape)
    actor = Actor.untransferred(sensor.model, sensor.model.mean + bias)
    heads = [sensor.model.mean + bias + a * sensor.smile for a in sensor.amount]
    result = ev.evaluate_run([tracked(i, sensor.rigid(i), h) for i, h in enumerate(heads)], sensor, actor)
    # rotating the (slightly mis-aligned) neutral leaves a little of the bias: far below the bias itself
    assert result.motion_length("v4").max() < 0.15 and np.median(result.surface) > 0.3
    shift = np.eye(4)
    shift[0, 3] = 1.5
    shifted = [shift @ sensor.rigid(i) for i in range(6)]
    moved = ev.evaluate_run([tracked(i, shifted[i], h) for i, h in enumerate(heads)], sensor, actor)
    assert np.median(moved.motion_length("v4")) == pytest.approx(1.5, abs=0.1)
    assert moved.pose_shift == pytest.approx(1.5, abs=0.1)


def test_a_slid_cheek_moves_no_lip_where_the_neutral_frames_place_the_head(sensor):
    """Vertices of the lower face lie 4 mm along the skin; every frame moves as it should. By the vertices, the head is
    placed wrongly; by where the resting face was tracked, nothing is wrong."""
    slid = sensor.model.mean.copy()
    slid[slid[:, 1] < np.percentile(slid[sensor.model.frontal, 1], 30)] += [4.0, 0.0, 0.0]
    actor = Actor.untransferred(sensor.model, slid)
    frames = [tracked(i, sensor.rigid(i), slid + a * sensor.smile) for i, a in enumerate(sensor.amount)]
    poses, true = np.array([frame.head_pose for frame in frames[:2]]), np.array([sensor.rigid(i) for i in range(2)])
    results = {}
    for name, alignment in (("vertices", None), ("frames", ev.tracked_alignment(poses, true))):
        collector = ev.ErrorCollector(sensor, actor, ("v4",), alignment)
        for frame in frames:
            collector.add(frame)
        results[name] = np.median(collector.finish().motion_length("v4"))
    assert results["frames"] < 1e-4 and results["vertices"] > 0.3


def test_stages_are_told_apart_and_the_normal_offset_is_found(sensor):
    actor = Actor.untransferred(sensor.model, sensor.model.mean)
    frames = []
    for i in range(len(sensor)):
        head = sensor.model.mean + sensor.amount[i] * sensor.smile
        lifted = head + 0.5 * vertex_normals(head, sensor.model.triangles)
        frames.append(tracked(i, sensor.rigid(i), (sensor.model.mean, lifted, lifted, head)))
    result = ev.evaluate_run(frames, sensor, actor)
    assert result.summary("v2", ev.REPEAT)["normal"] == pytest.approx(0.5, abs=1e-3)
    assert result.summary("v2", ev.REPEAT)["tangential"] < 1e-3
    assert result.surface_percentiles("v2", ev.REPEAT)[0] == pytest.approx(0.5, abs=0.02)
    assert result.summary("v1", ev.REPEAT)["lips"] > 2 > result.summary("v2", ev.REPEAT)["lips"]
    assert result.summary("v4", ev.REPEAT)["surface_p95"] < 1e-3
    shares = {stage: result.summary(stage, ev.REPEAT)["lips_share"] for stage in ("v1", "v4")}
    assert shares["v1"] == pytest.approx(1.0, abs=1e-3) and shares["v4"] < 1e-3
    text = result.table()
    assert text.count("repeat") == 4 and "6 frames scored, 0 lost" in text
    heat = result.mean_error_map("v1", ev.REPEAT)
    assert np.isnan(heat[~actor.frontal]).all() and heat[actor.feature_vertices[29]] > 2  # a lower-lip feature


def test_lost_frames_are_counted_not_scored(sensor):
    actor = Actor.untransferred(sensor.model, sensor.model.mean)
    frames = [tracked(i, sensor.rigid(i), sensor.model.mean, is_tracked=i != 3) for i in range(len(sensor))]
    result = ev.evaluate_run(frames, sensor, actor)
    assert result.lost[ev.FIRST] == 1 and len(result.index) == 5 and "1 lost" in result.table()
    with pytest.raises(AdaptiveFaceError, match="no frame was tracked"):
        ev.evaluate_run([tracked(0, sensor.rigid(0), sensor.model.mean, False)], sensor, actor)


def test_truth_of_a_file_equals_that_of_the_sensor(sensor, tmp_path):
    truths = [sensor.ground_truth(i) for i in range(len(sensor))]
    path = tmp_path / "ground_truth.npz"
    np.savez(
        path,
        vertices=np.float32([t.vertices for t in truths]),
        rigid=np.float32([t.head_pose for t in truths]),
        performance=np.int32([t.performance for t in truths]),
    )
    truth = ev.GroundTruth.of(path)
    assert len(truth) == 6 and truth[4].performance == ev.REPEAT
    assert np.allclose(truth.neutral, ev.GroundTruth.of(sensor).neutral, atol=1e-3)
    assert np.allclose(truth[3].vertices, truths[3].vertices, atol=1e-3)
    np.savez(path, vertices=np.zeros((2, 5, 3), np.float32), rigid=np.zeros((3, 4, 4)), performance=np.zeros(2, int))
    with pytest.raises(FileFormatError, match="rigid"):
        ev.GroundTruth.of(path)


def test_damaged_truth_is_refused_by_name_before_memory_is_taken(tmp_path, monkeypatch):
    path = tmp_path / "ground_truth.npz"
    whole = dict(vertices=np.zeros((2, 5, 3)), rigid=np.zeros((2, 4, 4)), performance=np.zeros(2, int))
    for name, value, words in (
        ("performance", None, "'performance' is missing"),
        ("performance", np.zeros(2), "'performance' has dtype"),
        ("vertices", np.full((2, 5, 3), np.nan), "'vertices' holds NaN"),
        ("neutral", np.zeros((4, 3)), "'neutral' has shape"),
    ):
        np.savez(path, **{key: array for key, array in (whole | {name: value}).items() if array is not None})
        with pytest.raises(FileFormatError, match=words) as caught:
            ev.GroundTruth.of(path)
        assert str(path) in str(caught.value)
    np.savez(path, **whole)
    with pytest.raises(FileFormatError, match="no neutral frame"):
        ev.GroundTruth.of(path)
    monkeypatch.setattr("adaptiveface.evaluation.truth._MAX_BYTES", 100)
    with pytest.raises(FileFormatError, match="need more than"):
        ev.GroundTruth.of(path)


def test_truth_is_found_in_the_source_or_in_its_folder(sensor, tmp_path):
    assert ev.truth_of(sensor) is sensor
    folder = SimpleNamespace(path=tmp_path)
    assert ev.truth_of(folder) is None and ev.truth_of(SimpleNamespace()) is None
    (tmp_path / "ground_truth.npz").touch()
    assert ev.truth_of(folder) == tmp_path / "ground_truth.npz"
    with pytest.raises(TypeError, match="ground_truth"):
        ev.GroundTruth.of(folder)


def test_the_old_name_of_the_true_pose_still_works(sensor):
    class Old:
        def __len__(self):
            return 1

        def ground_truth(self, index):
            truth = sensor.ground_truth(index)
            return SimpleNamespace(vertices=truth.vertices, rigid=truth.head_pose, performance=truth.performance)

    with pytest.warns(DeprecationWarning, match="head_pose"):
        truth = ev.GroundTruth.of(Old())
    assert np.allclose(truth.neutral, sensor.model.mean)


def test_truth_of_the_synthetic_sensor():
    sensor = SyntheticSensor(1, neutral_frames=1, frames=2, repeats=2, colour=False)
    truth = ev.GroundTruth.of(sensor)
    assert [truth[i].performance for i in range(len(truth))] == [ev.NEUTRAL, ev.FIRST, ev.FIRST, ev.REPEAT, ev.REPEAT]
    seen = transform_points(np.linalg.inv(truth[0].head_pose), truth[0].vertices)
    assert np.allclose(truth.neutral, seen, atol=1e-6)
    # without a neutral frame the performer's own neutral still serves
    no_neutral = SyntheticSensor(1, neutral_frames=0, frames=2, colour=False)
    assert np.array_equal(ev.GroundTruth.of(no_neutral).neutral, truth.neutral)


def test_another_mesh_is_refused(sensor):
    vertices, triangles = grid()
    everywhere = np.ones(len(vertices), bool)
    actor = Actor(
        vertices,
        np.zeros((1, len(vertices), 3)),
        triangles,
        everywhere,
        ("a",),
        np.zeros((40, 3), int),
        np.ones((40, 3)) / 3,
        everywhere,
    )
    with pytest.raises(AdaptiveFaceError, match="need the same mesh"):
        ev.evaluate_run([], sensor, actor)


@pytest.mark.slow
def test_ablations_of_a_tracked_smile():
    import scenes

    from adaptiveface.evaluation.ablation import VARIANTS, ablation_table, run_ablations

    actor, frames, truths = scenes.exact_actor(), [], []
    amounts = [0, 0, 0.3, 0.6, 1.0, 0.6, 0.3, 0.6, 1.0]
    for i, amount in enumerate(amounts):
        x = scenes.coefficients(actor, mouthSmileLeft=amount, jawOpen=amount)
        head, rigid = scenes.posed_shape(actor, x), scenes.head_pose(rotation=(0, 0.01 * i, 0))
        frames.append(scenes.render_frame(actor, head, rigid, i, noise=0.5, pixel_noise=0.3))
        truths.append(Truth(transform_points(rigid, head), rigid, -1 if i < 2 else int(i >= 6)))

    class Source:
        ground_truth = staticmethod(truths.__getitem__)
        __len__ = staticmethod(lambda: len(truths))

    results = run_ablations(frames, Source(), actor)
    assert tuple(results) == tuple(variant.name for variant in VARIANTS)
    share = {name: result.active_share(result.stages[0], ev.REPEAT) for name, result in results.items()}
    assert share["full pipeline"] < 0.3 < 0.5 < share["without the blendshape fit"]
    assert share["full pipeline"] < share["without 2D features"]
    # one tracker serves the variants that differ in the stage only: its v1 is that of the full run
    whole = ev.evaluate_run((FaceTracker(actor).track(f) for f in frames[:1]), Source(), actor, ("v1",))
    assert results["blendshapes only"].surface[0, 0] == pytest.approx(whole.surface[0, 0])
    assert ablation_table(results).count("\n") == len(VARIANTS)


# ---- data_synth/evaluate_performers.py


@pytest.fixture(scope="module")
def performers():
    sys.path.insert(0, str(Path(__file__).parents[1] / "data_synth"))
    return importlib.import_module("evaluate_performers")


def test_cached_frames_are_those_of_the_sensor(performers, tmp_path):
    sensor = SyntheticSensor(1, "truedepth", neutral_frames=1, frames=1, repeats=2, colour=False)
    for cached in (performers.CachedFrames(sensor, tmp_path), performers.CachedFrames(sensor, tmp_path)):
        for index in range(len(sensor)):
            live, kept = sensor.read(index), cached.read(index)
            assert np.array_equal(live.depth, kept.depth) and live.timestamp == kept.timestamp
            assert np.array_equal(live.features.pixels, kept.features.pixels, equal_nan=True)
            assert np.array_equal(live.features.confidence, kept.features.confidence)
    other = SyntheticSensor(1, "truedepth", neutral_frames=2, frames=1, repeats=2, colour=False)
    assert performers.CachedFrames(other, tmp_path).folder != cached.folder


def test_verdict_names_the_worst_performer(performers):
    good = dict(
        seed=1000,
        noise="truedepth",
        surface_median=0.2,
        surface_p95=0.8,
        active_share=0.3,
        lips=0.9,
        gain_v1=0.3,
        gain_learning=0.2,
        lost=0.0,
    )
    text, all_hold = performers.verdict([good, good | dict(seed=1001)])
    assert all_hold and text.count("pass") == len(performers.LIMITS)
    text, all_hold = performers.verdict([good, good | dict(seed=1001, gain_learning=0.1, surface_p95=1.2)])
    failed = [line for line in text.splitlines() if line.startswith("FAIL")]
    assert not all_hold and len(failed) == 2 and all("1001 truedepth" in line for line in failed)
