"""Registration, volume, features, fit and shrink-wrap, each against known truth."""

from dataclasses import replace

import numpy as np
import pytest
from scenes import CAMERA, exact_actor, head_pose, render_frame

from adaptiveface.errors import TrackingError
from adaptiveface.geometry.camera import Camera
from adaptiveface.geometry.frame import DetectedFace, Features2D, RgbdFrame
from adaptiveface.geometry.mesh import rotation_vector_matrix, surface_points, transform_points, vertex_normals
from adaptiveface.model.face_model import embedded_face_model
from adaptiveface.neutral.deformation_graph import carry_matrix, deformation_graph
from adaptiveface.neutral.features import (
    calibrated_features,
    calibrated_landmarks,
    constraints_on,
    feature_constraints,
    neutral_evidence,
)
from adaptiveface.neutral.fit import ScanSearch, fit_identity
from adaptiveface.neutral.fuse import FusedScan, fuse_frames, head_box, in_head_frame, most_frontal
from adaptiveface.neutral.registration import align, depth_view, feature_pose
from adaptiveface.neutral.shrink_wrap import (
    shrink_wrap,
    touching_pairs,
)
from adaptiveface.neutral.volume import TsdfVolume
from adaptiveface.parameters import FitParameters, FusionParameters, ShrinkWrapParameters

MODEL = embedded_face_model()
BOX = head_box(MODEL, 35.0)


def features_on(vertices):
    return surface_points(vertices, MODEL.feature_triangles, MODEL.feature_weights)


def scan_of(vertices, frames=(), poses=(), noise=0.0):
    """A perfect scan of a head: its frontal vertices and triangle centres, with the features of the given frames."""
    skin = MODEL.triangles[MODEL.depth_valid[MODEL.triangles].all(axis=1)]
    normals = vertex_normals(vertices, MODEL.triangles)
    weights = [np.roll([1 - 2 * w, w, w], k) for w in (0.1, 1 / 3, 0.45) for k in range(3)]
    points = np.concatenate([np.einsum("k,tkd->td", w, vertices[skin]) for w in weights])
    planes = np.concatenate([np.einsum("k,tkd->td", w, normals[skin]) for w in weights])
    planes /= np.linalg.norm(planes, axis=1, keepdims=True)
    points = points + noise * np.random.default_rng(0).normal(size=(len(points), 1)) * planes
    return FusedScan(
        points,
        planes,
        np.full(len(points), 10.0),
        np.arange(len(frames)),
        np.array(poses).reshape(-1, 4, 4),
        np.zeros(len(frames)),
        tuple(f.features for f in frames),
        tuple(f.camera for f in frames),
    )


def pose_difference(a, b):
    """Millimetres at the middle of the face, degrees."""
    angle = np.degrees(np.arccos(np.clip((np.trace(a[:3, :3].T @ b[:3, :3]) - 1) / 2, -1, 1)))
    return np.linalg.norm(transform_points(a, np.zeros(3)) - transform_points(b, np.zeros(3))), angle


@pytest.fixture(scope="module")
def actor():
    return exact_actor()


@pytest.fixture(scope="module")
def frame(actor):
    return render_frame(actor, actor.neutral, head_pose((0.05, 0.1, 0.02)))


# --- registration --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(4))
def test_icp_recovers_a_known_motion(actor, frame, seed):
    rng = np.random.default_rng(seed)
    truth = head_pose((0.05, 0.1, 0.02))
    offset = np.eye(4)
    offset[:3, :3] = rotation_vector_matrix(np.radians(4) * rng.normal(size=3) / np.sqrt(3))
    offset[:3, 3] = 5 * rng.normal(size=3)
    skin = actor.frontal
    points, normals = actor.neutral[skin], vertex_normals(actor.neutral, actor.triangles)[skin]
    start = truth @ offset
    result = align(depth_view(frame, start, BOX), points, normals, start, FusionParameters(iterations=40))
    millimetres, degrees = pose_difference(result.pose, truth)
    assert millimetres < 0.3 and degrees < 0.2
    assert result.residual < 0.1 and result.overlap > 0.8


def test_icp_says_when_nothing_meets(actor, frame):
    far = head_pose(translation=(0, 0, 1500.0))
    view = depth_view(frame, head_pose((0.05, 0.1, 0.02)), BOX)
    result = align(view, actor.neutral, vertex_normals(actor.neutral, actor.triangles), far, FusionParameters())
    assert result.residual == np.inf and result.overlap < 0.1
    assert (result.pose == far).all()


def test_the_depth_view_keeps_the_head_only(actor, frame):
    truth = head_pose((0.05, 0.1, 0.02))
    wall = replace(frame, depth=np.where(frame.depth > 0, frame.depth, np.float32(1200.0)))
    view = depth_view(wall, truth, BOX)
    assert view.camera.width < 400 and view.camera.height < 400
    head = transform_points(np.linalg.inv(truth), view.points[view.valid])
    assert (head > BOX[0] - 1e-3).all() and (head < BOX[1] + 1e-3).all()
    assert (view.normals[view.valid][:, 2] < 0.3).all()
    assert depth_view(wall, head_pose(translation=(5000, 0, 600)), BOX) is None
    assert depth_view(wall, head_pose(translation=(0, 0, -600)), BOX) is None


def test_pose_from_features(actor, frame):
    pose = feature_pose(frame, features_on(actor.neutral))
    millimetres, degrees = pose_difference(pose, head_pose((0.05, 0.1, 0.02)))
    assert millimetres < 3 and degrees < 1
    few = Features2D(np.where(np.arange(40)[:, None] < 5, frame.features.pixels, np.nan), np.ones(40))
    assert feature_pose(replace(frame, features=few), features_on(actor.neutral)) is None
    assert feature_pose(replace(frame, features=None), features_on(actor.neutral)) is None


# --- volume --------------------------------------------------------------------------------------------------------


def sphere_view(radius=60.0, distance=500.0):
    camera = Camera(200, 200, 400.0, 400.0, 99.5, 99.5)
    rays = camera.rays()
    a, b, c = (rays**2).sum(2), -2 * distance * rays[..., 2], distance**2 - radius**2
    root = b**2 - 4 * a * c
    depth = np.where(root > 0, (-b - np.sqrt(np.maximum(root, 0))) / (2 * a), 0).astype(np.float32)
    pose = head_pose(translation=(0, 0, distance))
    return depth_view(RgbdFrame(depth, camera), pose, np.array([[-70.0] * 3, [70.0] * 3])), pose


def test_the_volume_holds_the_sphere_it_was_shown():
    view, pose = sphere_view()
    volume = TsdfVolume(np.array([[-70.0, -70, 0], [70, 70, 70]]), 2.0, 10.0)
    for _ in range(3):
        volume.integrate(view, pose, 0.3)
    points, normals, weights = volume.surface()
    assert len(points) > 3000
    assert np.abs(np.linalg.norm(points, axis=1) - 60).max() < 0.4
    assert np.median(np.abs(np.linalg.norm(points, axis=1) - 60)) < 0.05
    outward = points / np.linalg.norm(points, axis=1, keepdims=True)
    assert np.degrees(np.arccos(np.clip((outward * normals).sum(1), -1, 1))).max() < 8
    ray = transform_points(pose, points)
    cosine = -(ray * (outward @ pose[:3, :3].T)).sum(1) / np.linalg.norm(ray, axis=1)
    assert np.abs(weights - 3 * cosine).max() < 0.3
    assert len(volume.surface(min_weight=3.1)[0]) == 0


def test_the_kernel_computes_the_curless_levoy_mean():
    view, pose = sphere_view()
    volume = TsdfVolume(np.array([[-30.0, -30, 40], [30, 30, 70]]), 3.0, 9.0)
    volume.integrate(view, pose, 0.3)
    volume.integrate(view, pose @ np.diag([1.0, 1, 1, 1]), 0.3)
    index = np.stack(np.meshgrid(*(np.arange(n) for n in volume.distance.shape), indexing="ij"), axis=-1)
    moved = transform_points(pose, volume.origin + 3.0 * index)
    column, row = np.floor(np.moveaxis(view.camera.project(moved), -1, 0) + 0.5).astype(int)
    point, normal = view.points[row, column].astype(float), view.normals[row, column].astype(float)
    distance = ((moved - point) * normal).sum(-1) / 9.0
    cosine = -(normal * point).sum(-1) / np.linalg.norm(point, axis=-1)
    seen = view.valid[row, column] & (cosine >= 0.3) & (distance >= -1) & (point[..., 2] - moved[..., 2] >= -18)
    assert seen.any() and not seen.all()
    assert ((volume.weight > 0) == seen).all()
    assert np.abs(volume.distance[seen] - np.minimum(distance[seen], 1)).max() < 1e-5
    assert np.abs(volume.weight[seen] - 2 * cosine[seen]).max() < 1e-5


# --- fusion --------------------------------------------------------------------------------------------------------


def turning_frames(actor, count=6, **noise):
    yaw = np.linspace(-0.25, 0.25, count)
    return [
        render_frame(actor, actor.neutral, head_pose((0, y, 0), (8 * y, 0, 600)), k, **noise) for k, y in enumerate(yaw)
    ], yaw


def test_fusion_averages_the_noise_and_finds_the_motion(actor):
    frames, yaw = turning_frames(actor, 8, noise=0.8, pixel_noise=0.5)
    scan = fuse_frames(frames, MODEL)
    assert (scan.frames == np.arange(8)).all()
    relative = [np.linalg.inv(scan.poses[0]) @ pose for pose in scan.poses]
    turned = [np.degrees(np.arccos((np.trace(r[:3, :3]) - 1) / 2)) for r in relative]
    assert np.abs(turned - np.degrees(yaw - yaw[0])).max() < 0.4
    head = transform_points(np.linalg.inv(head_pose((0, yaw[0], 0), (8 * yaw[0], 0, 600))) @ scan.poses[0], scan.points)
    offset = ScanSearch(scan_of(actor.neutral)).tree.query(head)[0]
    face = offset < 4
    search = scan_of(actor.neutral)
    nearest = ScanSearch(search).tree.query(head[face])[1]
    distance = ((head[face] - search.points[nearest]) * search.normals[nearest]).sum(1)
    assert face.mean() > 0.6
    assert np.median(np.abs(distance)) < 0.25


def test_frames_without_features_are_fused_too(actor):
    frames, _ = turning_frames(actor)
    frames = [frame if k == 3 else replace(frame, features=None) for k, frame in enumerate(frames)]
    scan = fuse_frames(frames, MODEL)
    assert len(scan.frames) == 6
    assert sum(f is not None for f in scan.features) == 1


def test_a_frame_of_something_else_is_left_out(actor):
    frames, _ = turning_frames(actor)
    wall = np.full_like(frames[0].depth, 590.0)
    frames[4] = replace(frames[4], depth=wall, features=None)
    frames[1] = replace(frames[1], depth=np.zeros_like(wall))
    scan = fuse_frames(frames, MODEL)
    assert scan.frames.tolist() == [0, 2, 3, 5]


def test_the_most_frontal_frame_starts(actor):
    frames, yaw = turning_frames(actor, 7)
    number, _ = most_frontal(dict(enumerate(frames)), features_on(MODEL.mean))
    assert number == 3


def test_no_face_is_an_error(actor):
    frames, _ = turning_frames(actor, 2)
    with pytest.raises(TrackingError, match="no face was found in the 2 readable"):
        fuse_frames([replace(frame, features=None) for frame in frames], MODEL)
    with pytest.raises(TrackingError, match="no depth at the face"):
        fuse_frames([replace(frame, depth=np.zeros_like(frame.depth)) for frame in frames], MODEL)


# --- features ------------------------------------------------------------------------------------------------------


def test_feature_constraints_are_the_mean_squared_ray_distance(actor):
    frames, yaw = turning_frames(actor, 5, pixel_noise=1.0)
    poses = [head_pose((0, y, 0), (8 * y, 0, 600)) for y in yaw]
    points = features_on(actor.neutral)
    toward = np.tile([0.0, 0, 1], (40, 1))
    constraints = feature_constraints(scan_of(actor.neutral, frames, poses), points, toward)
    assert constraints.seen.all()
    anywhere = points + np.random.default_rng(0).normal(size=points.shape)
    total, weights = np.zeros(40), np.zeros(40)
    for frame, pose in zip(frames, poses, strict=True):
        moved = transform_points(pose, anywhere)
        ray = CAMERA.back_project(frame.features.pixels, np.ones(40))
        ray /= np.linalg.norm(ray, axis=1, keepdims=True)
        cosine = -(ray * (toward @ pose[:3, :3].T)).sum(1) - 0.2
        total += cosine * ((moved - (moved * ray).sum(1, keepdims=True) * ray) ** 2).sum(1)
        weights += cosine
    kept = np.isclose(constraints.weights, weights)  # no outlier dropped there
    assert kept.sum() > 20
    assert np.abs(constraints.rms(anywhere) ** 2 - total / weights)[kept].max() < 1e-6


def test_a_wild_feature_is_dropped(actor):
    frames, yaw = turning_frames(actor, 7, pixel_noise=0.3)
    poses = [head_pose((0, y, 0), (8 * y, 0, 600)) for y in yaw]
    frames[2].features.pixels[5] += 80
    constraints = feature_constraints(
        scan_of(actor.neutral, frames, poses), features_on(actor.neutral), np.tile([0.0, 0, 1], (40, 1))
    )
    assert constraints.rms(features_on(actor.neutral))[5] < 1.0


def test_calibration_moves_features_to_where_the_detector_sees_them(actor):
    """A detector with its own idea of every feature: calibrated, the features lie on its rays, on the surface."""
    frames, yaw = turning_frames(actor, 7)
    shift = np.random.default_rng(8).normal(size=(40, 2))
    poses = [head_pose((0, y, 0), (8 * y, 0, 600)) for y in yaw]
    frames = [replace(f, features=Features2D(f.features.pixels + 2 * shift, np.ones(40))) for f in frames]
    constraints = constraints_on(scan_of(actor.neutral, frames, poses), MODEL, actor.neutral)
    home = features_on(actor.neutral)
    triangles, weights = calibrated_features(constraints, MODEL, actor.neutral, 6.0)
    moved = surface_points(actor.neutral, triangles, weights)
    assert np.median(constraints.rms(home)[constraints.seen]) > 2.0
    assert np.median(constraints.rms(moved)[constraints.seen]) < 0.7
    assert np.linalg.norm(moved - home, axis=1).max() <= 6.0
    assert np.allclose(weights.sum(axis=1), 1) and (weights >= 0).all()
    known = {tuple(sorted(t)) for t in MODEL.triangles.tolist()}
    assert all(tuple(sorted(t)) in known for t in triangles[constraints.seen].tolist())
    same = calibrated_features(constraints, MODEL, actor.neutral, 0.0)
    assert (same[0] == MODEL.feature_triangles).all() and (same[1] == MODEL.feature_weights).all()


def with_landmarks(frames, poses, neutral):
    """The frames as a detector sees a head (V, 3): its landmarks from their places, slid as the head turns."""
    landmarks, out = MODEL.landmarks, []
    points = landmarks.points(neutral)
    for frame, pose in zip(frames, poses, strict=True):
        mesh = np.full((478, 3), np.nan)
        seen = CAMERA.project(transform_points(pose, points)) + landmarks.slides(pose, CAMERA, points)
        mesh[landmarks.ids, :2] = seen
        out.append(replace(frame, features=replace(frame.features, face=DetectedFace(mesh))))
    return out


def test_what_a_detector_turns_too_far_is_no_place_of_a_landmark(actor):
    """It sees the nods of this scan too flat; taken for the person's own, the nose was 0.7 mm too short."""
    poses = [head_pose((nod, 0, 0), (0, 0, 600)) for nod in np.linspace(-0.25, 0.25, 5)]
    frames = [render_frame(actor, actor.neutral, pose, k) for k, pose in enumerate(poses)]
    scan = scan_of(actor.neutral, with_landmarks(frames, poses, actor.neutral), poses)
    moved = calibrated_landmarks(scan, MODEL, actor.neutral).offset - MODEL.landmarks.offset
    assert np.abs(moved[MODEL.landmarks.regions == "nose", 2]).max() < 0.3


def test_the_contour_pulls_only_where_the_head_is_far_from_it(actor):
    frames, yaw = turning_frames(actor, 5)
    poses = [head_pose((0, y, 0), (8 * y, 0, 600)) for y in yaw]
    scan = scan_of(actor.neutral, with_landmarks(frames, poses, actor.neutral), poses)
    added = slice(40, None)
    *_, at_home = neutral_evidence(scan, MODEL, actor.neutral, np.eye(3), True)
    assert len(at_home.seen) > 80 and not at_home.strength[added].any()
    narrow = actor.neutral.copy()
    narrow[:, 0] *= np.where(narrow[:, 1] < -20.0, 0.75, 1.0)  # the lower face
    triangles, weights, pulled = neutral_evidence(scan, MODEL, narrow, np.eye(3), True)
    points = surface_points(narrow, triangles, weights)
    force = (pulled.strength[:, None] * (pulled.b - np.einsum("fij,fj->fi", pulled.A, points)))[added]
    sides = np.abs(points[added, 0]) > 30.0
    outwards = force[:, 0] * np.sign(points[added, 0])
    assert outwards[sides & (points[added, 1] < -30.0)].min() >= 0.0 < outwards[sides].max()
    forty = constraints_on(scan, MODEL, narrow)
    *_, without = neutral_evidence(scan, MODEL, narrow, np.eye(3), False)
    assert len(without.seen) == 40 and (without.strength == forty.strength).all()
    assert (pulled.strength[:40] == forty.strength).all()


def test_the_contour_needs_features_that_are_seen(actor):
    """Features of no confidence, as of a face that is turned away, beside a detected face: no NaN reaches the fit."""
    poses = [head_pose((0, 0, 0), (0, 0, 600))]
    frames = with_landmarks([render_frame(actor, actor.neutral, poses[0])], poses, actor.neutral)
    frames = [replace(f, features=replace(f.features, confidence=np.zeros(40))) for f in frames]
    *_, constraints = neutral_evidence(scan_of(actor.neutral, frames, poses), MODEL, actor.neutral, np.eye(3), True)
    assert np.isfinite(constraints.b).all() and not constraints.strength.any()


def jaw_without_depth(actor, width):
    """A jaw that is wider by a share, (V, 3), and its scan, whose sides have no depth: sensors see turned-away skin badly."""
    wide = actor.neutral.copy()
    below = np.clip(-(wide[:, 1] + 10.0) / 40.0, 0.0, 1.0)
    wide[:, 0] *= 1.0 + width * below
    poses = [head_pose((0, y, 0), (8 * y, 0, 600)) for y in (-0.3, 0.0, 0.3)]
    frames = with_landmarks([render_frame(actor, wide, pose) for pose in poses], poses, wide)
    scan = scan_of(wide, frames, poses)
    shown = np.abs(scan.points[:, 0]) < 45.0
    return wide, replace(scan, points=scan.points[shown], normals=scan.normals[shown])


def jaw_off(vertices, truth):
    """Mean distance of the held-out landmarks of the jaw from the true ones, across the view, mm."""
    jaw = MODEL.landmarks.held_out & (MODEL.landmarks.regions == "jaw")
    apart = MODEL.landmarks.points(vertices)[jaw] - MODEL.landmarks.points(truth)[jaw]
    return np.linalg.norm(apart[:, :2], axis=1).mean()


def test_a_jaw_that_depth_does_not_show_is_found_in_the_picture(actor):
    wide, scan = jaw_without_depth(actor, 0.3)
    off = {}
    for contour in (False, True):
        fit = fit_identity(scan, MODEL, FitParameters(contour=contour))
        vertices = transform_points(fit.scan_from_head, fit.vertices)
        wrap = shrink_wrap(scan, MODEL, vertices, ShrinkWrapParameters(contour=contour))
        off[contour] = jaw_off(wrap.vertices, wide)
    assert off[True] < 0.7 * off[False], off


def test_a_jaw_that_is_a_little_wide_is_found_by_the_fit(actor):
    wide, scan = jaw_without_depth(actor, 0.2)
    off = {}
    for contour in (False, True):
        fit = fit_identity(scan, MODEL, FitParameters(contour=contour))
        off[contour] = jaw_off(transform_points(fit.scan_from_head, fit.vertices), wide)
    assert off[True] < 0.87 * off[False], off


# --- fit -----------------------------------------------------------------------------------------------------------


def test_the_fit_finds_identity_and_pose():
    identity = 0.8 * np.random.default_rng(3).normal(size=len(MODEL.identity_modes))
    truth = MODEL.neutral(identity)
    offset = np.eye(4)
    offset[:3, :3], offset[:3, 3] = rotation_vector_matrix(np.array([0.05, -0.08, 0.03])), [6, -4, 5]
    posed = transform_points(offset, truth)
    poses = [head_pose((0, y, 0)) for y in (-0.1, 0.0, 0.1)]
    frames = [
        RgbdFrame(
            np.zeros((480, 640), np.float32),
            CAMERA,
            features=Features2D(CAMERA.project(transform_points(pose, features_on(posed))), np.ones(40)),
        )
        for pose in poses
    ]
    fit = fit_identity(scan_of(posed, frames, poses), MODEL)
    assert fit.residual < 0.1
    placed = transform_points(fit.scan_from_head, fit.vertices)
    error = np.linalg.norm(placed - posed, axis=1)[MODEL.depth_valid]
    assert np.median(error) < 0.7
    assert np.corrcoef(fit.identity[:10], identity[:10])[0, 1] > 0.95
    assert np.nanmedian(fit.feature_rms) < 0.5
    assert fit.history[-1] < 0.1 * fit.history[0]


def test_the_fit_without_features_and_without_a_face():
    truth = MODEL.neutral(0.5 * np.random.default_rng(4).normal(size=12))
    fit = fit_identity(scan_of(truth), MODEL)
    assert fit.residual < 0.1 and np.isnan(fit.feature_rms).all()
    scan = scan_of(truth)
    with pytest.raises(TrackingError, match="does not show a face"):
        fit_identity(replace(scan, points=scan.points + 500), MODEL)


# --- shrink-wrap ---------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def bumpy():
    """A head with detail that no mode holds, and its noisy scan: (modes' head, true head, scan)."""
    rng = np.random.default_rng(5)
    smooth = MODEL.neutral(0.5 * rng.normal(size=20))
    bump = np.zeros(len(smooth))
    for centre in rng.choice(np.flatnonzero(MODEL.depth_valid), 40):
        bump += rng.normal() * np.exp(-((smooth - smooth[centre]) ** 2).sum(1) / 2 / 12.0**2)
    truth = smooth + bump[:, None] * vertex_normals(smooth, MODEL.triangles)
    return smooth, truth, scan_of(truth, noise=0.15)


def test_the_graph_at_rest_leaves_the_mesh_alone():
    graph = deformation_graph(MODEL.mean, MODEL.triangles, 16.0)
    assert np.allclose(graph.shares.sum(axis=1), 1) and (graph.shares >= 0).all()
    carry, rest = carry_matrix(graph, MODEL.mean)
    unknown = np.tile(np.concatenate([np.eye(3), np.zeros((1, 3))]), (len(graph.nodes), 1))
    assert np.abs(carry @ unknown + rest - MODEL.mean).max() < 1e-9
    linear = np.array([[1.1, 0.2, 0], [0, 0.9, 0.1], [0.3, 0, 1]])
    moved = np.concatenate([np.stack([np.concatenate([linear.T, (x @ linear.T - x)[None]]) for x in graph.positions])])
    assert np.abs(carry @ moved.reshape(-1, 3) + rest - MODEL.mean @ linear.T).max() < 1e-9


def test_lips_do_not_carry_one_another():
    graph = deformation_graph(MODEL.mean, MODEL.triangles, 16.0)
    upper, lower = MODEL.feature_triangles[34].ravel()[0], MODEL.feature_triangles[38].ravel()[0]  # inner lip centres
    carries = [set(graph.carriers[v][graph.shares[v] > 0]) for v in (upper, lower)]
    assert not carries[0] & carries[1]
    pairs = touching_pairs(MODEL)
    assert len(pairs) >= 5
    assert (np.abs(MODEL.mean[pairs[:, 0], 0]) < 30).all() and (MODEL.mean[pairs, 1] < 0).all()


def test_shrink_wrap_follows_what_the_modes_cannot_hold(bumpy):
    smooth, truth, scan = bumpy
    wrap = shrink_wrap(scan, MODEL, smooth)
    normals = vertex_normals(truth, MODEL.triangles)
    before, after = (np.abs(((x - truth) * normals).sum(1))[MODEL.depth_valid] for x in (smooth, wrap.vertices))
    assert np.median(before) > 0.25 and np.median(after) < 0.1 and np.percentile(after, 95) < 0.35
    assert wrap.residual < 0.1 and wrap.history[-1] < 0.5 * wrap.history[0]
    assert wrap.matched[MODEL.depth_valid].mean() > 0.95


def test_shrink_wrap_is_smooth_where_the_scan_says_nothing(bumpy):
    smooth, _, scan = bumpy
    wrap = shrink_wrap(scan, MODEL, smooth)
    unseen = ~MODEL.depth_valid
    assert np.linalg.norm(wrap.vertices - smooth, axis=1)[unseen].max() < 4.0
    move = wrap.vertices - smooth
    a, b = MODEL.triangles[:, [0, 1, 2]].ravel(), MODEL.triangles[:, [1, 2, 0]].ravel()
    length = np.linalg.norm(smooth[a] - smooth[b], axis=1)
    steps = np.linalg.norm(move[a] - move[b], axis=1) / length
    assert steps.max() < 0.6  # no spike, rims included
    flips = (vertex_normals(wrap.vertices, MODEL.triangles) * vertex_normals(smooth, MODEL.triangles)).sum(1)
    assert flips.min() > 0.6


def test_shrink_wrap_can_be_switched_off(bumpy):
    smooth, _, scan = bumpy
    wrap = shrink_wrap(scan, MODEL, smooth, ShrinkWrapParameters(iterations=0, detail_iterations=0))
    assert (wrap.vertices == smooth).all()


def test_the_scan_in_another_frame_sees_the_same_pixels(actor):
    frames, yaw = turning_frames(actor, 2)
    poses = [head_pose((0, y, 0), (8 * y, 0, 600)) for y in yaw]
    scan = scan_of(actor.neutral, frames, poses)
    offset = head_pose((0.3, 0.1, 0.2), (5, 6, 7))
    moved = in_head_frame(scan, offset)
    for k in range(2):
        assert np.allclose(transform_points(moved.poses[k], moved.points), transform_points(poses[k], scan.points))
