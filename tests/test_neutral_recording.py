"""A real TrueDepth recording, captured with detected features, against an independent fusion of the same head.

Skipped where the recording is not at hand: it is not part of this project.
"""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import cKDTree

from adaptiveface.geometry.mesh import rigid_alignment, transform_points, vertex_normals
from adaptiveface.neutral.capture import capture_neutral
from adaptiveface.sensors.recording import Recording

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def capture(mannequin, detector):
    recording = Recording(mannequin)
    frames = [recording.read(i) for i in range(len(recording))]
    return capture_neutral([replace(frame, features=detector.detect(frame)) for frame in frames])


@pytest.fixture(scope="module")
def reference(mannequin):
    """Points and normals (n, 3) of the independent fusion, mm."""
    text = (mannequin / "reference_cloud.ply").read_text(encoding="utf-8")
    rows = np.loadtxt(text.partition("end_header\n")[2].splitlines(), usecols=range(6))
    return 1000 * rows[:, :3], rows[:, 3:]


def on_reference(points, normals, reference, from_first_camera):
    """Align points, normals (n, 3) rigidly to the reference: signed point-to-plane distances (n,), mm.

    The two cameras' frames differ by an unknown number of quarter turns about the viewing axis; none is preferred.
    """
    tree, results = cKDTree(reference[0]), []
    for quarter in range(4):
        c, s = np.round([np.cos(np.pi / 2 * quarter), np.sin(np.pi / 2 * quarter)])
        turn = np.array([[c, -s, 0, 0], [s, c, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1.0]])
        transform = turn @ from_first_camera
        for limit in np.geomspace(30, 3, 40):
            moved = transform_points(transform, points)
            distance, nearest = tree.query(moved)
            target, plane = reference[0][nearest], reference[1][nearest]
            agree = (plane * (normals @ transform[:3, :3].T)).sum(axis=1) > 0.7
            use = agree & (distance < limit)
            if use.sum() < 1000:
                break
            off = ((moved - target) * plane).sum(axis=1, keepdims=True) * plane
            transform = rigid_alignment(moved[use], (moved - off)[use]) @ transform
        moved = transform_points(transform, points)
        nearest = tree.query(moved)[1]
        results.append(((moved - reference[0][nearest]) * reference[1][nearest]).sum(axis=1))
    return min(results, key=lambda distances: np.median(np.abs(distances)))


def test_every_frame_registers_from_ear_to_ear(capture):
    assert len(capture.scan.frames) >= 80
    toward = -capture.scan.poses[:, 2, :3]
    yaw = np.degrees(np.arctan2(toward[:, 0], toward[:, 2]))
    assert np.ptp(yaw) > 95
    assert np.median(capture.scan.residuals) < 0.5


def test_the_fused_neutral_lies_on_the_reference(capture, reference):
    """On the face (scan points whose nearest vertex is frontal), no point left out."""
    scan, actor = capture.scan, capture.actor
    face = actor.frontal[cKDTree(actor.neutral).query(scan.points)[1]]
    distances = np.abs(on_reference(scan.points[face], scan.normals[face], reference, scan.poses[0]))
    print(f"fused neutral: median {np.median(distances):.3f} mm, mean {distances.mean():.3f} mm, {face.sum()} points")
    assert np.median(distances) < 0.75


def test_the_personal_mesh_lies_on_the_reference(capture, reference):
    """Frontal vertices that may take depth, none left out; the fit by modes alone is printed for comparison."""
    actor = capture.actor
    face = actor.frontal & actor.depth_valid
    normals = vertex_normals(actor.neutral, actor.triangles)[face]
    medians = {}
    for name, vertices in (("modes alone", capture.fit.vertices), ("shrink-wrapped", actor.neutral)):
        distances = np.abs(on_reference(vertices[face], normals, reference, capture.scan.poses[0]))
        medians[name] = np.median(distances)
        print(f"{name}: median {medians[name]:.3f} mm, mean {distances.mean():.3f} mm, {face.sum()} vertices")
    assert medians["shrink-wrapped"] < 1.0
    assert medians["shrink-wrapped"] < 0.5 * medians["modes alone"]
