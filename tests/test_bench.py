"""The bench prints what it claims, and its peers solve the tracker's own problems."""

import numpy as np
import pytest

from adaptiveface.bench import bandwidth, colour, growth, peers, run, run_bench
from adaptiveface.bench.decimation import decimated
from adaptiveface.bench.paper import PAPER_MS, PAPER_SUM_MS
from adaptiveface.bench.peers import Comparison
from adaptiveface.bench.scene import bench_scene
from adaptiveface.bench.sizes import feature_points, model_of_size
from adaptiveface.geometry.mesh import boundary_loops, edges, surface_points, triangle_normals, vertex_normals
from adaptiveface.model.face_model import embedded_face_model
from adaptiveface.parameters import Parameters
from adaptiveface.synthetic.subdivision import loop_subdivision
from adaptiveface.tracking.tracker import FaceTracker
from adaptiveface.tracking.types import STAGE_NAMES


@pytest.fixture(scope="module")
def scene():
    return bench_scene(60)


@pytest.fixture(scope="module")
def recorded(scene):
    return peers.record(*scene, 6)


def test_paper_figures_add_up():
    assert PAPER_SUM_MS == pytest.approx(22.4) and set(PAPER_MS) <= set(STAGE_NAMES)


def test_stages_are_recorded_once_per_frame(recorded):
    rounds = recorded.tracker.parameters.blendshapes.iterations
    assert len(recorded.align) == len(recorded.fit) == 6 and 6 < len(recorded.solve) < 6 * rounds  # some end early
    assert len(recorded.learn) == 60
    calls = len(recorded.align)
    recorded.tracker.rigid.align(*recorded.align[0])
    assert len(recorded.align) == calls  # what the comparisons call is not recorded


def test_bounded_problems_given_to_scipy_have_our_solution(recorded):
    for compare in (peers.bounded_solve, peers.blendshape_fit):
        entry = compare(recorded, 3)
        assert entry.peer_ms > 0 and entry.ours_ms > 0
        assert float(entry.agreement.split()[0]) < 1e-4


def test_incremental_pca_learns_the_same_samples(recorded):
    pytest.importorskip("sklearn")
    entry = peers.incremental_pca(recorded, 5)
    assert entry.ours_ms > 0 and entry.peer_ms > 0


def test_optional_peers_agree_where_installed(recorded):
    pytest.importorskip("igl")
    assert float(peers.prefactored_solve(recorded, 3).agreement.split()[0]) < 1e-9


def test_point_clouds_of_the_icp_peer_are_the_tracked_surface(recorded):
    o3d = pytest.importorskip("open3d")
    surface, shape, normals, pose = recorded.align[0]
    source, target = peers._clouds(o3d, surface, shape @ pose[:3, :3].T + pose[:3, 3])
    near = np.asarray(source.compute_point_cloud_distance(target))
    assert np.median(near) < 1.5 and (np.asarray(target.normals)[:, 2] < 0).mean() > 0.99


def test_missing_peers_are_named_with_the_way_to_install_them(recorded, monkeypatch):
    monkeypatch.setattr(peers, "_optional", lambda name: None)
    entries = [peers.rigid_icp(recorded, 2), peers.prefactored_solve(recorded, 2), peers.incremental_pca(recorded, 2)]
    assert all(entry.peer_ms is None for entry in entries)
    assert run.peer_table(entries).count("pip install 'adaptiveface[bench]'") == 3


def test_tables_of_known_timings():
    stage_ms = np.tile([1.0, 2.0, 3.0, 4.0, 0.0, 5.0, 6.0, 7.0, 8.0], (100, 1))  # no colour: no skin
    stage_ms[:10] *= 10
    timings = run.Timings(stage_ms, np.linspace(30.0, 40.0, 101), np.full(100, 36.0), 90, 7053, 3501)
    lines = {line.split("  ")[0]: line.split() for line in run.stage_table(timings).splitlines()}
    assert lines["rigid"][1:] == ["2.00", "20.00", "20.00", "3.2", "62%"]
    assert lines["sum of stages"][3:] == ["36.00", "360.00", "360.00", "22.4", "161%"]
    assert lines["whole frame"][2:] == ["35.00", "39.50", "39.90", "-", "-"]
    slow, fast = Comparison("rigid", "a", 2.0, 1.0), Comparison("laplacian", "b", 1.0, 3.0)
    assert "ABOVE a third" in run.verdict(timings, [])
    assert "slower than its peer: rigid" in run.verdict(timings, [slow, fast])
    quick = run.Timings(stage_ms / 10, np.full(100, 3.7), np.full(100, 3.6), 90, 7053, 3501)
    assert "within a third" in run.verdict(quick, [fast]) and "1 of 1" in run.verdict(quick, [fast])
    assert "3.0x" in run.peer_table([fast])


@pytest.mark.slow
def test_bench_prints_every_stage_and_peer(capsys, monkeypatch):
    monkeypatch.setattr(run, "FRAMES", 30)
    monkeypatch.setattr(run, "RECORDED", 4)
    assert run_bench() == 0
    text = capsys.readouterr().out
    for name in (*STAGE_NAMES, "sum of stages", "whole frame", "bounded solve", "prefactored solve", "30 frames, learning on"):
        assert name in text


def test_a_decimated_mesh_is_the_same_surface_on_fewer_of_its_vertices():
    model = embedded_face_model()
    kept, triangles = decimated(model.mean, model.triangles, 3000)
    assert len(kept) == 3000 == len(np.unique(triangles)) and (np.diff(kept) > 0).all()
    loops = [len(boundary_loops(t, n)) for t, n in ((triangles, 3000), (model.triangles, len(model.mean)))]
    euler = [n - len(edges(t)) + len(t) for t, n in ((triangles, 3000), (model.triangles, len(model.mean)))]
    assert loops[0] == loops[1] and euler[0] == euler[1]
    outside = vertex_normals(model.mean, model.triangles)[kept][triangles].sum(axis=1)
    facing = (triangle_normals(model.mean[kept], triangles) * outside).sum(axis=1) > 0
    assert facing.mean() > 0.99  # lips and lids are thin and bent


def test_a_model_of_another_size_carries_its_tables_over():
    model = embedded_face_model()
    matrix, _ = loop_subdivision(model.triangles, len(model.mean))
    other, kept = model_of_size(model, 22_000)
    np.testing.assert_allclose(other.mean, (matrix @ model.mean)[kept])
    np.testing.assert_allclose(other.expressions[3], (matrix @ model.expressions[3])[kept])
    old = kept < len(model.mean)
    np.testing.assert_array_equal(other.frontal[old], model.frontal[kept[old]])
    np.testing.assert_array_equal(other.depth_valid[old], model.depth_valid[kept[old]])
    assert abs(other.frontal.mean() - model.frontal.mean()) < 0.05
    placed = surface_points(other.mean, other.feature_triangles, other.feature_weights)
    assert np.linalg.norm(placed - feature_points(model, matrix), axis=1).max() < 0.5
    with pytest.raises(ValueError, match="27764"):
        model_of_size(model, 30_000)


def test_what_the_pca_moves_is_counted_and_the_machine_s_rate_measured(recorded):
    model = recorded.tracker.model
    size, count = len(model.anchors), model.count
    moved = bandwidth.learned_step_bytes(model)
    assert 2 * count * size * 4 < moved < 2 * (count + 2 * model.anchors.shape[1]) * size * 4
    assert 1e8 < bandwidth.stream_rate(1) < 1e13
    assert f"{moved / 1e6:.1f} MB" in bandwidth.traffic_line(model, 1.0)


def test_growth_is_judged_against_n_log_n():
    n = np.array([1000.0, 2000.0, 4000.0])
    linear, square = growth.Growth("a", n, n / 1000), growth.Growth("b", n, n**2)
    assert linear.power == pytest.approx(1.0) and not linear.steep
    assert square.power == pytest.approx(2.0) and square.steep
    text = growth.growth_table("ms", [linear, square, growth.Growth("c", n, n * np.nan)])
    assert [line.endswith("steeper") for line in text.splitlines()] == [False, False, True, False]


def test_growth_shows_every_stage_and_its_peers(scene, recorded):
    actor, frames = scene
    sets = [Parameters().replace(**{"adaptive_pca.S": 8, "adaptive_pca.K": K}) for K in (2, 4)]
    stages = growth.stage_growth([FaceTracker(actor, p) for p in sets], (2, 4), frames[:16])
    assert [entry.name for entry in stages] == [*STAGE_NAMES, "sum of stages"]
    learning = next(entry for entry in stages if entry.name == "adaptive_pca")
    assert (learning.ms > 0).all() and (learning.ms < stages[-1].ms).all()
    compared = growth.peer_growth([recorded, recorded], (2, 4), (peers.bounded_solve, peers.incremental_pca))
    assert [entry.name.strip() for entry in compared][::2] == ["bounded solve", "adaptive_pca"]
    assert (compared[1].ms > 0).all()


def test_the_colour_bench_times_the_same_frames_without_and_with_skin(capsys):
    """Dense skin costs something in its own line, and nothing there where it is off; the sums are those of the stages."""
    actor, frames = colour.colour_scene(24)
    assert actor.skin is not None and actor.appearance is not None and all(frame.colour is not None for frame in frames)
    trackers = [FaceTracker(actor, Parameters().replace(skin__on=on)) for on in (False, True)]
    without, with_skin = colour.time_in_turns(trackers, frames)
    skin = STAGE_NAMES.index("skin")
    assert without.shape == with_skin.shape == (24, len(STAGE_NAMES))
    assert (without[:, skin] < 0.05 * with_skin[:, skin]).all()  # the timer alone
    table = colour.colour_table(without, with_skin).splitlines()
    assert table[-1].split()[3:] == [
        f"{np.percentile(ms.sum(axis=1), q):.2f}" for ms in (without, with_skin) for q in (50, 95)
    ] + [f"{np.median(with_skin.sum(axis=1)) / np.median(without.sum(axis=1)):.2f}x"]
