"""The whole way on real sensor data: capture and track the mannequin head with the command line.

The truth is the head's surface as the source's own scanner fused it, in a frame of its own: one rigid transformation
for all frames together is fitted before distances are measured.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import cKDTree

from adaptiveface.cli import main
from adaptiveface.evaluation import actor_regions
from adaptiveface.geometry.frame import FEATURE_IDS, FEATURE_REGIONS
from adaptiveface.geometry.mesh import rotation_vector_matrix, surface_points, transform_points
from adaptiveface.model.actor import Actor
from adaptiveface.neutral.capture import capture_neutral
from adaptiveface.parameters import Parameters
from adaptiveface.result import Result
from adaptiveface.sensors import Recording
from adaptiveface.tracking.feature_refinement import FeatureRefinement
from adaptiveface.tracking.tracker import FaceTracker


@pytest.fixture(scope="module")
def actor_file(mannequin, detector, tmp_path_factory) -> Path:
    """The recording captured from all its frames."""
    path = tmp_path_factory.mktemp("mannequin") / "actor.npz"
    assert main(["capture", str(mannequin), "--out", str(path)]) == 0
    return path


@pytest.fixture(scope="module")
def tracked(mannequin, actor_file) -> Result:
    """The recording tracked."""
    folder = actor_file.parent
    arguments = ["--actor", str(actor_file), "--out", str(folder / "result.npz")]
    assert main(["track", str(mannequin), *arguments]) == 0
    return Result.load(folder / "result.npz")


@pytest.fixture(scope="module")
def reference(mannequin) -> tuple[np.ndarray, np.ndarray]:
    """Points (n, 3) mm and normals (n, 3) of the reference cloud, an ASCII PLY in metres."""
    lines = (mannequin / "reference_cloud.ply").read_text().splitlines()
    start = next(k for k, line in enumerate(lines) if line.startswith("end_header")) + 1
    values = np.array([line.split()[:6] for line in lines[start:] if line.strip()], float)
    return values[:, :3] * 1000, values[:, 3:]


def face_points(recording: Recording, result: Result, index: int) -> np.ndarray:
    """(n, 3) depth points of one frame within 10 mm of the tracked face, taken to the head frame by its rigid pose."""
    frame = recording.read(index)
    points = (frame.camera.rays() * frame.depth[..., None])[frame.depth > 0]
    near, _ = cKDTree(result.vertices[index][result.frontal]).query(points, distance_upper_bound=10.0)
    return transform_points(np.linalg.inv(result.head_pose[index].astype(float)), points[np.isfinite(near)])


def residuals(points, tree, normals, transform) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Moved points, normals of their closest reference points, signed point-to-plane distances, within 30 mm."""
    moved = transform_points(transform, points)
    _, closest = tree.query(moved, distance_upper_bound=30.0)
    found = closest < tree.n
    moved, closest = moved[found], closest[found]
    return moved, normals[closest], ((moved - tree.data[closest]) * normals[closest]).sum(axis=1)


def register(points, tree, normals, transform, steps) -> np.ndarray:
    """Point-to-plane ICP with robust weights."""
    for _ in range(steps):
        moved, plane, distance = residuals(points, tree, normals, transform)
        weight = 1 / np.maximum(np.abs(distance), 1.0)
        rows = np.concatenate([np.cross(moved, plane), plane], axis=1)
        solution = np.linalg.solve((rows * weight[:, None]).T @ rows, -(rows * weight[:, None]).T @ distance)
        step = np.eye(4)
        step[:3, :3], step[:3, 3] = rotation_vector_matrix(solution[:3]), solution[3:]
        transform = step @ transform
    return transform


def onto_reference(points, first_pose, tree, normals) -> np.ndarray:
    """(4, 4) head frame to the reference's, which is that of the first camera, upside down (measured)."""
    return register(points, tree, normals, np.diag([-1.0, -1.0, 1.0, 1.0]) @ first_pose, 40)


@pytest.mark.slow
def test_the_head_is_kept(tracked):
    assert len(tracked) == 90 and not tracked.skipped.any()
    assert tracked.tracked.sum() >= 80 and tracked.tracked[9:].sum() >= 78


@pytest.mark.slow
def test_a_turn_from_the_front_is_tracked_to_the_profile_with_the_mouth_closed(mannequin, detector, actor_file):
    """All 90 frames, from the last to the first: the detector finds no face in the profile ones, depth carries them.

    The mouth of a mannequin cannot open. Near the profile it did, by 19 mm, from depth alone.
    """
    actor, recording = Actor.load(actor_file), Recording(mannequin)
    tracker, gaps = FaceTracker(actor), []
    for index in reversed(range(len(recording))):
        frame = recording.read(index)
        result = tracker.track(dataclasses.replace(frame, features=detector.detect(frame)))
        assert result.tracked, index
        gaps.append(lip_gap(actor, result.v4))
    print(f"inner lips apart: {lip_gap(actor, actor.neutral):.1f} mm neutral, at most {max(gaps):.1f} mm")
    assert max(gaps) < lip_gap(actor, actor.neutral) + 6.0


def lip_gap(actor: Actor, vertices: np.ndarray) -> float:
    """Distance between the middles of the inner lips (iBUG 62 and 66), mm."""
    points = surface_points(vertices, actor.feature_triangles, actor.feature_weights)
    upper, lower = (int(np.flatnonzero(FEATURE_IDS == number)[0]) for number in (62, 66))
    return float(np.linalg.norm(points[upper] - points[lower]))


@pytest.mark.slow
def test_rigid_poses_bring_the_depth_frames_onto_the_reference(tracked, mannequin, reference):
    """At most 1.2 mm (median, point to plane) over the points of every third tracked frame."""
    recording, (points, normals) = Recording(mannequin), reference
    tree = cKDTree(points)
    kept = np.flatnonzero(tracked.tracked)
    clouds = [face_points(recording, tracked, index)[::8] for index in kept[::3]]
    first_pose = tracked.head_pose[kept[0]].astype(float)
    transform = onto_reference(np.concatenate(clouds), first_pose, tree, normals)
    medians = [np.median(np.abs(residuals(cloud, tree, normals, transform)[2])) for cloud in clouds]
    everything = np.concatenate([residuals(cloud, tree, normals, transform)[2] for cloud in clouds])
    print(f"median {np.median(np.abs(everything)):.2f} mm, per frame {min(medians):.2f} to {max(medians):.2f} mm")
    assert np.median(np.abs(everything)) <= 1.2


@pytest.mark.slow
def test_the_final_mesh_lies_on_the_depth(tracked, mannequin):
    """The mesh's vertices lie on the frame's own depth surface: under 1 mm (median) along the viewing ray."""
    recording = Recording(mannequin)
    errors = []
    for index in np.flatnonzero(tracked.tracked)[20::10]:
        frame = recording.read(int(index))
        vertices = tracked.vertices[index][tracked.frontal]
        u, v = np.rint(frame.camera.project(vertices)).astype(int).T
        inside = (u >= 0) & (v >= 0) & (u < 240) & (v < 320)
        depth = frame.depth[v[inside], u[inside]]
        gap = depth - vertices[inside, 2]
        errors.append(np.abs(gap[(depth > 0) & (np.abs(gap) < 20)]))
    assert np.median(np.concatenate(errors)) < 1.0


def test_refined_features_lie_closer_to_the_rigid_head(mannequin, actor_file, tracked, detector):
    """Of a head that cannot move its face, the rigid poses say where every feature is: brows and lips gain by the pictures."""
    actor, recording = Actor.load(actor_file), Recording(mannequin)
    refinement = FeatureRefinement(actor, Parameters().refinement)
    places = surface_points(actor.neutral, actor.feature_triangles, actor.feature_weights)
    errors = {"detected": [], "refined": []}
    for index in np.flatnonzero(tracked.tracked)[::4]:
        pose = tracked.head_pose[index].astype(float)
        frame = recording.read(index)
        frame = dataclasses.replace(frame, features=detector.detect(frame))
        if frame.features is None or frame.features.valid.sum() < 6 or np.degrees(np.arccos(-pose[2, 2])) > 45:
            continue
        truth = frame.camera.project(transform_points(pose, places))
        refined = refinement.refine(frame, actor.neutral, pose, lambda features, mesh: mesh)
        seen = frame.features.confidence > 0.05
        for name, features in (("detected", frame.features), ("refined", refined)):
            away = np.linalg.norm(features.pixels - truth, axis=1)
            errors[name].append(np.where(seen, away, np.nan))
    assert len(errors["refined"]) >= 8
    for region in ("lips", "brows"):
        before, after = (np.nanmedian(np.array(errors[name])[:, FEATURE_REGIONS == region]) for name in ("detected", "refined"))
        print(f"{region}: detected {before:.2f} px, refined {after:.2f} px")
        assert after < 0.9 * before


@pytest.mark.slow
def test_dense_skin_holds_a_plain_glossy_head_better(mannequin, detector):
    """How far vertices slide against the rigid head, without and with the colours of the whole face, within 45 degrees.

    The poses are those by which the neutral's own frames, every second one, were registered. The cheeks have no texture and
    shine: what they show must not pull.
    """
    recording = Recording(mannequin)
    frames = [recording.read(index) for index in range(len(recording))]
    frames = [dataclasses.replace(frame, features=detector.detect(frame)) for frame in frames]
    capture = capture_neutral(frames[::2])
    poses = {2 * number: pose for number, pose in zip(capture.scan.frames, capture.scan.poses, strict=True)}
    regions = {"face": capture.actor.frontal & capture.actor.depth_valid, **actor_regions(capture.actor)}
    slides = {}
    for on in (False, True):
        tracker, rows = FaceTracker(capture.actor, Parameters().replace(skin__on=on)), []
        for index in reversed(range(len(frames))):
            tracked, pose = tracker.track(frames[index]), poses.get(index)
            if pose is None or not tracked.tracked or np.degrees(np.arccos(-pose[2, 2])) > 45:
                continue
            camera = frames[index].camera
            truth = camera.project(transform_points(pose, capture.actor.neutral))
            rows.append(np.linalg.norm(camera.project(tracked.in_camera(tracked.v4)) - truth, axis=1))
        slides[on] = {name: float(np.median(np.array(rows)[:, inside])) for name, inside in regions.items()}
    for name in regions:
        print(f"{name}: {slides[False][name]:.2f} px without, {slides[True][name]:.2f} px with")
    assert len(rows) >= 30
    assert slides[True]["face"] < min(0.7, slides[False]["face"])
    for name in regions:
        assert slides[True][name] < slides[False][name] + 0.05, name
