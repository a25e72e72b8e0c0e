"""The whole neutral capture on synthetic performers that lie in no basis of the model, against their true surface."""

from dataclasses import replace

import numpy as np
import pytest

from adaptiveface.errors import FrameError, TrackingError
from adaptiveface.evaluation.metrics import TrueSurface
from adaptiveface.geometry.mesh import rigid_alignment, transform_points, vertex_normals
from adaptiveface.model.actor import Actor
from adaptiveface.neutral.capture import capture_actor, capture_neutral
from adaptiveface.synthetic.sensor import SyntheticSensor

FRAMES = 24


class Frames:
    """A sequence of frames of which some cannot be read."""

    def __init__(self, frames, broken=()):
        self.frames, self.broken = frames, set(broken)

    def __len__(self):
        return len(self.frames)

    def __getitem__(self, number):
        if number in self.broken:
            raise FrameError(f"frame {number} is truncated")
        return self.frames[number]


@pytest.fixture(scope="module", params=[(2, "structured-light"), (5, "truedepth")], ids=lambda p: p[1])
def performer(request):
    """Sensor, frames, capture of one development performer."""
    seed, noise = request.param
    sensor = SyntheticSensor(seed, noise=noise, neutral_frames=FRAMES, frames=1, repeats=1, colour=False)
    frames = [sensor.read(i) for i in range(FRAMES)]
    return sensor, frames, capture_neutral(frames)


def in_true_head(capture, sensor, points):
    """Points of the actor's head frame in the performer's own head frame, through the registered middle frame."""
    k = len(capture.scan.frames) // 2
    rigid = sensor.ground_truth(int(capture.scan.frames[k])).head_pose
    return transform_points(np.linalg.inv(rigid) @ capture.scan.poses[k], points)


def true_neutral(sensor):
    truth = sensor.ground_truth(0)
    return transform_points(np.linalg.inv(truth.head_pose), truth.vertices)


def test_the_personal_neutral_lies_on_the_true_surface(performer):
    sensor, _, capture = performer
    actor, truth = capture.actor, true_neutral(sensor)
    skin = actor.frontal & actor.depth_valid
    surface = TrueSurface(truth, actor.triangles)
    for name, vertices in (("modes alone", capture.fit.vertices), ("shrink-wrapped", actor.neutral)):
        placed = in_true_head(capture, sensor, vertices)
        distance = surface.distance(placed[skin])
        aligned = transform_points(rigid_alignment(placed[skin], truth[skin]), placed)
        apart = np.linalg.norm(aligned - truth, axis=1)[skin]
        print(
            f"{sensor.name}: {name}: true surface median {np.median(distance):.3f}, mean {distance.mean():.3f}, "
            f"p95 {np.percentile(distance, 95):.3f} mm; correspondence median {np.median(apart):.2f} mm"
        )
    assert np.median(distance) <= 0.2
    assert distance.mean() <= 0.65
    assert np.median(apart) <= 1.2


def test_every_frame_is_registered(performer):
    sensor, _, capture = performer
    assert capture.scan.frames.tolist() == list(range(FRAMES))
    truth = [sensor.ground_truth(i).head_pose for i in range(FRAMES)]
    to_head = [np.linalg.inv(t) @ pose for t, pose in zip(truth, capture.scan.poses, strict=True)]
    # One constant transformation leads from the actor's head frame to the performer's, up to the registration error.
    points, middle = capture.scan.points, transform_points(to_head[0], capture.scan.points)
    error = [np.linalg.norm(transform_points(t, points) - middle, axis=1).mean() for t in to_head]
    assert np.median(error) < 0.6 and max(error) < 1.5


def test_no_spikes(performer):
    sensor, _, capture = performer
    actor = capture.actor
    normals = vertex_normals(actor.neutral, actor.triangles)
    fitted = vertex_normals(capture.fit.vertices, actor.triangles)
    assert (normals * fitted).sum(1)[actor.frontal].min() > 0.3
    move = np.linalg.norm(actor.neutral - capture.fit.vertices, axis=1)
    assert move.max() < 8


def test_the_actor_is_whole_and_survives_saving(performer, tmp_path):
    _, _, capture = performer
    actor = capture.actor
    assert actor.blendshapes.shape == (23, *actor.neutral.shape)
    assert np.linalg.norm(actor.blendshapes, axis=2).max(axis=1).min() > 2
    assert len(actor.scan_points) > 10000
    actor.save(tmp_path / "actor.npz")
    loaded = Actor.load(tmp_path / "actor.npz")
    assert np.abs(loaded.neutral - actor.neutral).max() < 1e-4
    assert loaded.expression_names == actor.expression_names


def test_bit_identical_twice_with_broken_frames_and_progress():
    sensor = SyntheticSensor(1, noise="truedepth", neutral_frames=6, frames=1, repeats=1, colour=False)
    frames = [sensor.read(i) for i in range(6)]
    frames[2] = replace(frames[2], depth=np.zeros_like(frames[2].depth))
    steps = []
    first = capture_actor(Frames(frames, broken=[0, 4]), progress=lambda step, share: steps.append((step, share)))
    second = capture_neutral(Frames(frames, broken=[0, 4]))
    assert second.scan.frames.tolist() == [1, 3, 5]
    for name in ("neutral", "blendshapes", "scan_points", "identity", "feature_weights"):
        assert (getattr(first, name) == getattr(second.actor, name)).all()
    assert [step for step, _ in steps][-1] == "blendshapes" and all(0 <= share <= 1 for _, share in steps)
    assert {step for step, _ in steps} == {"fuse", "fit", "shrink_wrap", "blendshapes"}


def test_nothing_to_capture():
    with pytest.raises(TrackingError, match="no neutral frames"):
        capture_actor([])
    sensor = SyntheticSensor(1, neutral_frames=2, frames=1, repeats=1, colour=False)
    with pytest.raises(TrackingError, match="no face"):
        capture_actor([replace(sensor.read(i), features=None) for i in range(2)])
    with pytest.raises(TrackingError, match="no face"):
        capture_actor(Frames([sensor.read(0)], broken=[0]))
