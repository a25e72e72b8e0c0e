"""Each stage against truth or against an independent solver."""

import dataclasses

import numpy as np
import pytest
import scipy.sparse as sp
from scenes import CAMERA, coefficients, exact_actor, head_pose, posed_shape, render_frame
from scipy.ndimage import maximum_filter, minimum_filter
from scipy.optimize import lsq_linear, minimize
from scipy.sparse.linalg import spsolve

from adaptiveface.geometry.frame import Features2D
from adaptiveface.geometry.mesh import cotangent_laplacian, surface_points, transform_points, vertex_normals
from adaptiveface.parameters import BlendshapeParameters, DepthParameters, KalmanParameters, RigidParameters
from adaptiveface.registration.association import Correspondences, find_correspondences
from adaptiveface.registration.icp import icp, last
from adaptiveface.registration.step import point_to_plane_step, rigid_jacobian
from adaptiveface.registration.surface import _away_from_edges, depth_surface, occluded_share
from adaptiveface.tracking.bounded import bounded_least_squares, sparse_least_squares
from adaptiveface.tracking.detection import pose_from_features
from adaptiveface.tracking.expression import BlendshapeFit, Seen
from adaptiveface.tracking.feature_rows import camera_rows, feature_rows, turns
from adaptiveface.tracking.kalman import CoefficientFilter
from adaptiveface.tracking.laplacian import FeatureTerm, LaplacianDeformation, PrefactoredSystem, feature_term
from adaptiveface.tracking.rigid import RigidTracker


@pytest.fixture(scope="module")
def actor():
    return exact_actor()


def whole_surface(frame, **changes):
    return depth_surface(frame.depth, frame.camera, (0, 0, frame.camera.width, frame.camera.height), DepthParameters(**changes))


def pose_difference(a, b):
    """Rotation (degrees) and translation (mm) between two poses."""
    turn = a[:3, :3] @ b[:3, :3].T
    angle = np.degrees(np.arccos(np.clip((np.trace(turn) - 1) / 2, -1, 1)))
    return angle, np.linalg.norm(a[:3, 3] - b[:3, 3])


# ---- depth surface --------------------------------------------------------------------------------------------------
def test_correspondences_of_the_true_mesh_have_no_distance(actor):
    pose = head_pose((0.05, 0.2, 0.0))
    frame = render_frame(actor, actor.neutral, pose)
    points = transform_points(pose, actor.neutral)
    matches = find_correspondences(whole_surface(frame, smoothing=0.3), points, vertex_normals(points, actor.triangles), 25.0)
    used = (matches.weights > 0) & actor.frontal & actor.depth_valid
    assert used.sum() > 2000
    assert np.median(np.abs(matches.distances[used])) < 0.05
    normals = vertex_normals(points, actor.triangles)[used]
    cosine = (matches.normals[used] * normals).sum(axis=1)
    assert np.degrees(np.arccos(np.clip(np.median(cosine), -1, 1))) < 6.0


def test_depth_is_clean_where_it_spans_little_over_the_measured_neighbours():
    rng = np.random.default_rng(2)
    z = (600.0 + np.cumsum(rng.normal(0.0, 4.0, (40, 50)), axis=1)).astype(np.float32)
    z[rng.uniform(size=z.shape) < 0.1] = 0.0
    measured = np.where(z > 0, z, 1e6)
    span = maximum_filter(z, 3, mode="nearest") - minimum_filter(measured, 3, mode="nearest")
    clean = _away_from_edges(z, np.float32(20.0))
    np.testing.assert_array_equal(clean, (z > 0) & (span <= 20.0))
    assert 0.1 < clean.mean() < 0.9


def test_a_shifted_plane_gives_its_distance():
    camera, shift = CAMERA, 4.0
    depth = np.full((camera.height, camera.width), 600.0, np.float32)
    depth[:100] = 0.0
    surface = depth_surface(depth, camera, (0, 0, 640, 480), DepthParameters())
    pixels = np.array([[320.0, 240.0], [200.3, 300.7], [320.0, 50.0]])
    points = camera.back_project(pixels, np.full(3, 600.0 - shift))
    matches = find_correspondences(surface, points, np.tile([0.0, 0.0, -1.0], (3, 1)), 25.0)
    assert matches.weights[2] == 0.0  # no measurement there
    np.testing.assert_allclose(matches.distances[:2], shift, atol=1e-3)
    np.testing.assert_allclose(matches.normals[:2], [[0, 0, -1]] * 2, atol=1e-6)
    assert find_correspondences(surface, points, np.tile([0.0, 0.0, -1.0], (3, 1)), 3.0).count == 0


# ---- rigid motion ---------------------------------------------------------------------------------------------------
def test_a_hand_in_front_is_an_occluded_share_and_the_own_nose_is_none(actor):
    for turn in (0.0, 0.3, 0.6):
        pose = head_pose((0.0, turn, 0.0))
        frame = render_frame(actor, actor.neutral, pose)
        points = transform_points(pose, actor.neutral)[actor.frontal]
        normals = (vertex_normals(actor.neutral, actor.triangles) @ pose[:3, :3].T)[actor.frontal]
        assert occluded_share(whole_surface(frame), points, normals, 10.0) < 0.02
    depth, lips = frame.depth.copy(), frame.features.pixels[20:].mean(axis=0).round().astype(int)
    depth[lips[1] - 30 : lips[1] + 30, lips[0] - 40 : lips[0] + 40] = points[:, 2].min() - 40.0
    covered = occluded_share(whole_surface(dataclasses.replace(frame, depth=depth)), points, normals, 10.0)
    assert 0.1 < covered < 0.6
    empty = whole_surface(dataclasses.replace(frame, depth=np.zeros_like(depth)))
    assert occluded_share(empty, points, normals, 10.0) == 0.0


def test_icp_yields_the_start_and_every_step_and_says_why_it_stops():
    def run(converged=0.0, least=1):
        searches = []

        def associate(pose):
            searches.append(pose[0, 3])
            return int(pose[0, 3])

        def step(pose, matches):
            moved = pose.copy()
            moved[0, 3] /= 2
            return moved, moved[0, 3]

        start = np.eye(4)
        start[0, 3] = 8.0
        iterates = list(icp(start, associate, step, lambda matches: matches, least, 5, converged))
        assert searches == [i.pose[0, 3] for i in iterates], "one search per iterate"
        assert start[0, 3] == 8.0 and last(iter(iterates)) is iterates[-1]
        return [(i.pose[0, 3], i.matches, i.starved) for i in iterates]

    whole = [(8.0, 8, False), (4.0, 4, False), (2.0, 2, False), (1.0, 1, False)]
    assert run() == [*whole, (0.5, 0, True)], "without matches there is no step"
    assert run(least=0) == [*whole, (0.5, 0, False), (0.25, 0, False)], "five steps"
    assert run(converged=3.0) == whole[:3], "the step that moves by less is the last"


def test_point_to_plane_step_equals_numpy_least_squares():
    rng = np.random.default_rng(3)
    points, normals = 50 * rng.normal(size=(200, 3)), rng.normal(size=(200, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    matches = Correspondences(rng.normal(size=200), normals, rng.uniform(size=200) * (rng.uniform(size=200) > 0.3))
    centre, vertex_weights = points.mean(axis=0), rng.uniform(0.5, 1, size=200)
    root = np.sqrt(matches.weights * vertex_weights)
    expected = np.linalg.lstsq(root[:, None] * rigid_jacobian(points, normals, centre), -root * matches.distances, rcond=None)[
        0
    ]
    np.testing.assert_allclose(point_to_plane_step(points, matches, centre, vertex_weights), expected, rtol=1e-5, atol=1e-9)


@pytest.mark.parametrize("turn, shift", [((0, 0, 0), (6, 0, 0)), ((0.03, 0.02, -0.03), (3, -3, 5)), ((0, 0.06, 0), (0, 0, -8))])
def test_icp_recovers_a_known_motion(actor, turn, shift):
    truth = head_pose(np.array([0.05, 0.15, 0.0]) + turn, np.array([10.0, -5.0, 620.0]) + shift)
    start = head_pose((0.05, 0.15, 0.0), (10.0, -5.0, 620.0))
    frame = render_frame(actor, actor.neutral, truth, noise=0.8)
    used = np.flatnonzero(actor.frontal & actor.depth_valid)
    normals = vertex_normals(actor.neutral, actor.triangles)[used]
    tracker = RigidTracker(np.ones(len(used)), RigidParameters(iterations=8))
    fit = tracker.align(whole_surface(frame), actor.neutral[used], normals, start)
    angle, distance = pose_difference(fit.pose, truth)
    assert angle < 0.3 and distance < 0.5
    assert fit.residual < 0.6


def test_icp_reports_no_match_as_infinite_residual(actor):
    frame = render_frame(actor, actor.neutral, head_pose())
    used = np.flatnonzero(actor.frontal)
    normals = vertex_normals(actor.neutral, actor.triangles)[used]
    far = head_pose(translation=(0, 0, 900.0))
    assert (
        RigidTracker(np.ones(len(used)), RigidParameters())
        .align(whole_surface(frame), actor.neutral[used], normals, far)
        .residual
        == np.inf
    )


def test_pose_from_features_with_and_without_depth(actor):
    truth = head_pose((0.1, -0.3, 0.05), (20.0, 10.0, 650.0))
    frame = render_frame(actor, actor.neutral, truth, pixel_noise=0.3)
    points = np.einsum("fk,fkd->fd", actor.feature_weights, actor.neutral[actor.feature_triangles])
    angle, distance = pose_difference(pose_from_features(frame, points), truth)
    assert angle < 3.0 and distance < 15.0
    blind = type(frame)(np.zeros_like(frame.depth), frame.camera, features=frame.features)
    angle, distance = pose_difference(pose_from_features(blind, points), truth)
    assert angle < 6.0 and distance < 40.0


# ---- blendshapes ----------------------------------------------------------------------------------------------------
def test_bounded_least_squares_equals_scipy():
    rng = np.random.default_rng(5)
    for _ in range(20):
        a, b = rng.normal(size=(60, 23)) @ rng.normal(size=(23, 23)), rng.normal(size=60) * 5
        expected = lsq_linear(a, b, (0.0, 1.0), tol=1e-12).x
        got = bounded_least_squares(a.T @ a, a.T @ b, np.zeros(23), np.ones(23), sweeps=20000, tolerance=1e-13)
        np.testing.assert_allclose(got, expected, atol=1e-5)


@pytest.mark.parametrize(
    "lower, upper, price",
    [(-1.0, 1.0, 3.0), (-0.3, 0.5, 10.0), (-1.0, 3.0, 0.0), (-0.2, 0.2, 300.0), (-1e-3, 1.0, 5.0), (0.0, 1.0, 4.0)],
)
def test_sparse_least_squares_equals_scipy_on_both_sides_of_zero(lower, upper, price):
    """|x| as the sum of a positive and a negative part: a plain bounded problem of twice the size."""
    rng = np.random.default_rng(5)
    for _ in range(20):
        a, b = rng.normal(size=(60, 12)), 8 * rng.normal(size=60)
        penalty = price * rng.uniform(0.5, 2, 12)
        h, g = a.T @ a, a.T @ b
        got = sparse_least_squares(h, g, penalty, np.full(12, lower), np.full(12, upper), sweeps=20000, tolerance=1e-13)

        def energy(z, h=h, g=g, penalty=penalty):
            x = z[:12] - z[12:]
            slope = h @ x - g
            return 0.5 * x @ h @ x - g @ x + penalty @ (z[:12] + z[12:]), np.concatenate([slope + penalty, penalty - slope])

        limits = [(0, upper)] * 12 + [(0, -lower)] * 12
        best = minimize(energy, np.zeros(24), jac=True, bounds=limits, options={"maxiter": 5000, "ftol": 1e-15, "gtol": 1e-10})
        np.testing.assert_allclose(got, best.x[:12] - best.x[12:], atol=2e-5)
        started = sparse_least_squares(h, g, penalty, np.full(12, lower), np.full(12, upper), rng.uniform(lower, upper, 12))
        np.testing.assert_allclose(started, got, atol=1e-6)


@pytest.mark.parametrize("lower", [0.0, -0.1, -0.5, -1.0])
def test_a_neutral_mesh_needs_no_coefficients(lower):
    """The price on an expression must not pay for negative coefficients, whatever the first guess."""
    actor = exact_actor()
    fit = BlendshapeFit(actor, BlendshapeParameters(lower=lower))
    for start in (np.zeros(23), np.full(23, 0.3), np.full(23, lower)):
        np.testing.assert_allclose(fit.resolve(actor.neutral, start), 0.0, atol=1e-7)
    truth = np.zeros(23)
    truth[[2, 7]] = max(lower, -0.4), 0.6
    found = fit.resolve(posed_shape(actor, truth), np.zeros(23))
    assert np.abs(found - truth).max() < 0.05 and (np.abs(found) <= np.abs(truth) + 0.01).all(), "drawn towards zero"


def test_clipping_the_unbounded_solution_is_wrong():
    h = np.array([[1.0, 0.8], [0.8, 1.0]])
    unbounded = np.array([0.5, 1.5])
    bounded = bounded_least_squares(h, h @ unbounded, np.zeros(2), np.ones(2))
    # With the second coefficient held at 1, the first makes up for it: 0.5 + 0.8 * 0.5.
    np.testing.assert_allclose(bounded, [0.9, 1.0], atol=1e-7)
    assert np.abs(bounded - np.clip(unbounded, 0, 1)).max() > 0.3


@pytest.mark.parametrize("joint", [True, False])
def test_blendshape_fit_recovers_known_coefficients(actor, joint):
    truth = coefficients(actor, jawOpen=0.4, mouthSmileLeft=0.6, browInnerUp=0.7)
    pose = head_pose((0.0, 0.1, 0.0))
    frame = render_frame(actor, posed_shape(actor, truth), pose)
    fit = BlendshapeFit(actor, BlendshapeParameters(ridge=0.0, temporal=0.0, iterations=8, joint_pose=joint))
    normals = vertex_normals(actor.neutral, actor.triangles)[fit.depth_vertices]
    found_pose, x = fit.fit(whole_surface(frame, smoothing=0.3), frame.features, CAMERA, pose, np.zeros(23), normals)
    assert np.abs(x - truth).max() < 0.12
    np.testing.assert_allclose(fit.shape(x)[actor.frontal], posed_shape(actor, truth)[actor.frontal], atol=1.5)
    assert pose_difference(found_pose, pose)[0] < 0.3
    if not joint:
        np.testing.assert_array_equal(found_pose, pose)


def test_the_rounds_of_the_fit_end_when_one_moves_the_face_little(actor, monkeypatch):
    """From the last frame's solution; far from it, all rounds are needed. ``min_step`` 0, as in the paper, takes all."""
    truth, pose = coefficients(actor, jawOpen=0.4, mouthSmileLeft=0.6), head_pose((0.0, 0.1, 0.0))
    surface = whole_surface(frame := render_frame(actor, posed_shape(actor, truth), pose), smoothing=0.3)
    solve, rounds, shapes = BlendshapeFit.solve, [], {}
    monkeypatch.setattr(BlendshapeFit, "solve", lambda *given: rounds.append(given) or solve(*given))
    for min_step in (BlendshapeParameters().min_step, 0.0):
        fit = BlendshapeFit(actor, BlendshapeParameters(ridge=0.0, temporal=0.0, iterations=20, min_step=min_step))
        normals, x, taken = vertex_normals(actor.neutral, actor.triangles)[fit.depth_vertices], np.zeros(23), []
        for _ in range(2):
            rounds.clear()
            pose, x = fit.fit(surface, frame.features, CAMERA, pose, x, normals)
            taken.append(len(rounds))
        shapes[min_step] = transform_points(pose, fit.shape(x))[actor.frontal]
        assert taken == [20, 20] if min_step == 0.0 else 1 == taken[1] < taken[0] < 20
    first, second = shapes.values()
    assert np.sqrt(((first - second) ** 2).sum(axis=1).mean()) < 0.2  # mm


@pytest.mark.parametrize("lag", [0.9, 0.5, 0.0])
def test_the_pose_is_solved_for_the_coefficients_that_the_filter_leaves(actor, lag):
    """A filter that lags takes away a part of the expression; the pose is the best one for what is left."""
    truth = coefficients(actor, jawOpen=0.5, mouthSmileLeft=0.6, browInnerUp=0.7)
    frame = render_frame(actor, posed_shape(actor, truth), head_pose((0.0, 0.1, 0.0)))
    fit = BlendshapeFit(actor, BlendshapeParameters(ridge=0.0, temporal=0.0))
    normals = vertex_normals(actor.neutral, actor.triangles)[fit.depth_vertices]
    start = head_pose((0.01, 0.1, 0.0))
    arguments = (whole_surface(frame, smoothing=0.3), frame.features, CAMERA, start, np.zeros(23), normals)
    asked = []
    pose, x = fit.fit(*arguments, settle=lambda x: asked.append(x) or lag * x)
    raw_pose, raw = fit.fit(*arguments)
    assert len(asked) == 1
    np.testing.assert_array_equal(asked[0], raw)
    np.testing.assert_array_equal(x, lag * raw)

    seen = Seen(arguments[0], camera_rows(frame.features, CAMERA), normals)

    def left(pose):
        """How far one more update of the pose would move the head at x, mm."""
        update = fit.solve(fit._assemble(seen, pose, x, x)[0], x)[1](x)
        return np.linalg.norm(update[:3]) * 100 + np.linalg.norm(update[3:])

    assert left(pose) < 0.25 * left(raw_pose)


def test_a_filter_that_leaves_coefficients_alone_changes_no_bit(actor):
    """kalman.model = off; and without the joint pose, the paper's way, no filter touches the pose."""
    truth = coefficients(actor, jawOpen=0.4)
    frame = render_frame(actor, posed_shape(actor, truth), head_pose((0.0, 0.1, 0.0)), noise=0.5)
    for joint in (True, False):
        fit = BlendshapeFit(actor, BlendshapeParameters(joint_pose=joint))
        normals = vertex_normals(actor.neutral, actor.triangles)[fit.depth_vertices]
        start = head_pose((0.01, 0.1, 0.0))
        arguments = (whole_surface(frame), frame.features, CAMERA, start, np.zeros(23), normals)
        plain, same = fit.fit(*arguments), fit.fit(*arguments, settle=lambda x: x)
        np.testing.assert_array_equal(plain[0], same[0])
        np.testing.assert_array_equal(plain[1], same[1])
        if not joint:
            np.testing.assert_array_equal(fit.fit(*arguments, settle=lambda x: 0.5 * x)[0], start)


def test_resolve_returns_the_coefficients_of_a_blendshape_mesh(actor):
    truth = coefficients(actor, jawOpen=0.3, mouthPucker=0.5, eyeBlinkLeft=1.0)
    fit = BlendshapeFit(actor, BlendshapeParameters(ridge=0.0, sparsity=0.0))
    np.testing.assert_allclose(fit.resolve(posed_shape(actor, truth), np.zeros(23)), truth, atol=1e-4)


def test_feature_rows_are_zero_at_the_truth_and_follow_the_projection(actor):
    pose = head_pose((0.1, 0.2, 0.0))
    frame = render_frame(actor, actor.neutral, pose)
    rows = feature_rows(frame.features, CAMERA, pose)
    points = np.einsum("fk,fkd->fd", actor.feature_weights, actor.neutral[actor.feature_triangles])
    value = np.einsum("fij,fj->fi", rows.rows, points) + rows.offsets
    np.testing.assert_allclose(value, 0.0, atol=1e-6)
    moved = points + [1.0, -2.0, 3.0]
    in_camera = transform_points(pose, moved)
    expected = (CAMERA.project(in_camera) - frame.features.pixels) * in_camera[:, 2:]
    np.testing.assert_allclose(np.einsum("fij,fj->fi", rows.rows, moved) + rows.offsets, expected, atol=1e-6)


def test_turns_are_cross_products():
    levers, directions = np.random.default_rng(5).normal(size=(7, 3)), np.random.default_rng(6).normal(size=(7, 2, 3))
    np.testing.assert_array_equal(turns(levers, directions), np.cross(levers[:, None], directions))


# ---- Kalman ---------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("model, gain", [("variance", 0.90), ("acceleration", 0.06)])
def test_kalman_readings_have_the_documented_gain(model, gain):
    """The steady response to one step of the measurement, for both readings of the paper's noises."""
    kalman = CoefficientFilter(KalmanParameters(model=model))
    for _ in range(600):
        kalman.update(np.zeros(3))
    np.testing.assert_allclose(kalman.update(np.ones(3)), gain, atol=0.01)


def test_kalman_off_and_reset():
    kalman = CoefficientFilter(KalmanParameters(model="off"))
    np.testing.assert_array_equal(kalman.update(np.array([0.3, 0.7])), [0.3, 0.7])
    kalman = CoefficientFilter(KalmanParameters(model="acceleration"))
    for value in (0.0, 0.5):
        kalman.update(np.full(2, value))
    kalman.reset()
    np.testing.assert_array_equal(kalman.update(np.full(2, 0.9)), [0.9, 0.9])


# ---- Laplacian deformation ------------------------------------------------------------------------------------------
def rig(actor):
    return actor.neutral, actor.triangles, actor.frontal, actor.feature_triangles, actor.feature_weights


def dense_reference(actor, w1, w2, matches, normals, term):
    """The energy of laplacian.py assembled and solved directly with all 3n unknowns coupled."""
    n = int(actor.frontal.sum())
    rows = cotangent_laplacian(actor.neutral, actor.triangles)[:, np.flatnonzero(actor.frontal)]
    system = sp.kron(w2 * rows.T @ rows, sp.identity(3)).tolil().tocsr()
    index = 3 * np.arange(n)
    selector = sp.csr_matrix((normals.ravel(), (np.repeat(np.arange(n), 3), np.arange(3 * n))), (n, 3 * n))
    strength = sp.diags(w1 * matches.weights)
    system = system + selector.T @ strength @ selector
    right = selector.T @ (-w1 * matches.weights * matches.distances)
    place = np.cumsum(actor.frontal) - 1
    for k, f in enumerate(term.index):
        for r in range(term.rows.shape[1]):
            row = np.zeros(3 * n)
            for c in range(3):
                vertex = actor.feature_triangles[f, c]
                if actor.frontal[vertex]:
                    row[index[place[vertex]] : index[place[vertex]] + 3] += actor.feature_weights[f, c] * term.rows[k, r]
            row = sp.csr_matrix(row)
            system = system + term.weights[k, r] * row.T @ row
            right = right + term.weights[k, r] * term.targets[k, r] * row.toarray().ravel()
    return spsolve(system.tocsc(), right).reshape(-1, 3)


def laplacian_case(actor, seed=7):
    rng = np.random.default_rng(seed)
    n = int(actor.frontal.sum())
    normals = vertex_normals(actor.neutral, actor.triangles)[actor.frontal]
    matches = Correspondences(rng.normal(size=n), normals, rng.uniform(size=n) * (rng.uniform(size=n) > 0.2))
    pose = head_pose((0.0, 0.1, 0.0))
    frame = render_frame(actor, actor.neutral, pose, pixel_noise=2.0)
    return matches, normals, pose, frame.features


def features_of(actor, features, pose, weight, hold_depth):
    rig = actor.neutral, actor.feature_triangles, actor.feature_weights
    return feature_term(features, CAMERA, pose, *rig, weight, hold_depth)


@pytest.mark.parametrize("hold_depth", [False, True])
def test_feature_term_is_equation_2_divided_by_the_focal_length(actor, hold_depth):
    _, _, pose, features = laplacian_case(actor)
    features.pixels[3], features.confidence[7], features.confidence[9] = np.nan, 0.0, 0.4
    term = features_of(actor, Features2D(features.pixels, features.confidence), pose, 0.09, hold_depth)
    rows = feature_rows(Features2D(features.pixels, features.confidence), CAMERA, pose)
    points = surface_points(actor.neutral, actor.feature_triangles, actor.feature_weights)[rows.index]
    np.testing.assert_array_equal(term.index, rows.index)
    np.testing.assert_allclose(term.rows[:, :2], rows.rows / CAMERA.fx, atol=1e-14)
    value = np.einsum("fij,fj->fi", rows.rows, points) + rows.offsets
    np.testing.assert_allclose(term.targets[:, :2], -value / CAMERA.fx, atol=1e-11)
    np.testing.assert_allclose(term.weights, np.repeat(0.09 * rows.weights[:, None], 2 + hold_depth, axis=1))
    if hold_depth:
        np.testing.assert_allclose(term.rows[:, 2], np.broadcast_to(pose[2, :3], (len(term.index), 3)))
        np.testing.assert_array_equal(term.targets[:, 2], 0.0)
    assert features_of(actor, None, pose, 0.09, hold_depth).rows.shape == (0, 2 + hold_depth, 3)


def test_laplacian_deformation_converges_to_the_coupled_solution(actor):
    matches, normals, pose, features = laplacian_case(actor)
    term = features_of(actor, features, pose, 0.09, hold_depth=False)
    solver = LaplacianDeformation(*rig(actor), w1=0.1, w2=5.0)
    expected = dense_reference(actor, 0.1, 5.0, matches, normals, term)
    got = solver.deform(matches, normals, term, np.zeros_like(normals), steps=60)
    np.testing.assert_allclose(got, expected, atol=1e-6)
    two = solver.deform(matches, normals, term, expected + 0.05 * np.random.default_rng(1).normal(size=expected.shape), steps=2)
    assert np.abs(two - expected).mean() < 0.03


def test_final_deformation_is_exact_in_one_step(actor):
    _, normals, pose, features = laplacian_case(actor)
    term = features_of(actor, features, pose, 0.05, hold_depth=True)
    n = len(normals)
    nothing = Correspondences(np.zeros(n), normals, np.zeros(n))
    expected = dense_reference(actor, 0.0, 5.0, nothing, normals, term)
    got = LaplacianDeformation(*rig(actor), w1=0.0, w2=5.0).deform_to_features(term)
    np.testing.assert_allclose(got, expected, atol=1e-6)
    assert np.abs(got).max() > 0.2


def test_no_features_no_depth_means_no_deformation(actor):
    n = int(actor.frontal.sum())
    empty = FeatureTerm(np.zeros(0, int), np.zeros((0, 2, 3)), np.zeros((0, 2)), np.zeros((0, 2)))
    nothing = Correspondences(np.zeros(n), np.zeros((n, 3)), np.zeros(n))
    solver = LaplacianDeformation(*rig(actor), w1=0.1, w2=5.0)
    np.testing.assert_array_equal(solver.deform(nothing, np.zeros((n, 3)), empty, np.zeros((n, 3)), 2), 0.0)
    np.testing.assert_array_equal(solver.deform_to_features(empty), 0.0)


def test_printed_equation_7_makes_the_weights_vanish(actor):
    """The printed pseudoinverse K^T (K K^T)^-1 G^-1 a does not depend on w1 and w2; the energy form does.

    a holds the constraints' right-hand sides scaled like their rows, as eq. (7) stacks them (w1 I times I dv = w1 d).
    """
    chosen = np.flatnonzero(actor.frontal)[:150]
    rows = cotangent_laplacian(actor.neutral, actor.triangles)[chosen][:, chosen].toarray()
    rng = np.random.default_rng(0)
    target = rng.normal(size=150)
    features = np.eye(150)[:5]

    def printed(w1, w2):
        k = np.vstack([features, np.eye(150), rows])
        g = np.concatenate([np.ones(5), np.full(150, w1), np.full(150, w2)])
        a = np.concatenate([np.zeros(5), w1 * target, np.zeros(150)])
        return k.T @ np.linalg.pinv(k @ k.T) @ (a / g)

    def weighted(w1, w2):
        h = features.T @ features + w1 * np.eye(150) + w2 * rows.T @ rows
        return np.linalg.solve(h, w1 * target)

    np.testing.assert_allclose(printed(0.1, 100.0), printed(10.0, 0.01), atol=1e-8)
    assert np.abs(weighted(0.1, 100.0) - weighted(10.0, 0.01)).max() > 0.5


def test_prefactored_system_equals_a_fresh_solve(actor):
    system = PrefactoredSystem(actor.neutral, actor.triangles, actor.frontal, 0.1, 5.0)
    right = np.random.default_rng(2).normal(size=(int(actor.frontal.sum()), 3))
    matrix = (system.smoothing + 0.1 * sp.identity(len(right))).tocsc()
    np.testing.assert_allclose(system.solve(right), spsolve(matrix, right), atol=1e-9)
    single = system.precondition(right)
    assert 0.0 < np.abs(single - system.solve(right)).max() < 1e-4 * np.abs(single).max()
    strength, normals = np.random.default_rng(4).random(len(right)), right[::-1].copy()
    pull = (strength * (normals * right).sum(axis=1))[:, None] * normals
    np.testing.assert_allclose(system.apply(right, strength, normals), system.smoothing @ right + pull, atol=1e-9)


def test_other_weights_on_the_same_surface_equal_a_new_system(actor):
    changed = LaplacianDeformation(*rig(actor), w1=0.1, w2=5.0).reweighted(0.3, 0.7)
    fresh = LaplacianDeformation(*rig(actor), w1=0.3, w2=0.7)
    right = np.random.default_rng(3).normal(size=(int(actor.frontal.sum()), 3))
    np.testing.assert_array_equal(changed.system.solve(right), fresh.system.solve(right))
    np.testing.assert_array_equal(changed.system.precondition(right), fresh.system.precondition(right))
    np.testing.assert_array_equal(changed._compliance, fresh._compliance)
    assert changed.w1 == 0.3
