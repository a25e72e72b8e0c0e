"""The detector looks at every n-th frame only while the tracker is certain; between, features are predicted and refined."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from coloured import actor_and_views, coloured_performer

from adaptiveface.geometry.frame import Features2D, RgbdFrame
from adaptiveface.landmarks import Upright
from adaptiveface.model.actor import Actor
from adaptiveface.neutral.appearance import gather_appearance
from adaptiveface.parameters import Parameters
from adaptiveface.pipeline.track import track_source
from adaptiveface.synthetic.sensor import SyntheticSensor
from adaptiveface.tracking.tracker import FaceTracker

EVERY = 2
HALF = Parameters().replace(refinement__detect_every=EVERY)
FIRST, LAST = 20, 38


@pytest.fixture(scope="module")
def sensor() -> SyntheticSensor:
    return coloured_performer(8, 40, noise=0.5)


@pytest.fixture(scope="module")
def frames(sensor) -> list[RgbdFrame]:
    return [sensor.read(index) for index in range(FIRST, LAST)]


@pytest.fixture(scope="module")
def actor(sensor) -> Actor:
    plain, views = actor_and_views(sensor, step=2)
    return replace(plain, appearance=gather_appearance(plain, views, HALF.refinement))


class Detector:
    """Finds what the synthetic frames bring, as MediaPipe trusts itself, and counts."""

    def __init__(self) -> None:
        self.looked_at: list[int] = []

    def detect(self, frame: RgbdFrame) -> Features2D | None:
        self.looked_at.append(frame.index)
        return None if frame.features is None else replace(frame.features, confidence=0.3 * frame.features.confidence)


class Source:
    """Frames that a detector has to search."""

    fps, name, has_features = 30.0, "frames", False

    def __init__(self, frames: list[RgbdFrame]) -> None:
        self._frames, self.camera = frames, frames[0].camera

    def __len__(self) -> int:
        return len(self._frames)

    def read(self, index: int) -> RgbdFrame:
        return replace(self._frames[index], features=None)


def follow(actor: Actor, frames: list[RgbdFrame], parameters: Parameters):
    """The frames' results and those the detector looked at, as a reader of features and a tracker work together."""
    detector, tracker, out = Detector(), FaceTracker(actor, parameters), []
    upright = Upright(detector)
    for frame in frames:
        out.append(tracker.track(upright.detect(frame)))
        upright.spare(tracker.detect_every)
    return out, detector.looked_at


def features_error(sensor: SyntheticSensor, actor: Actor, tracked) -> float:
    """Median distance of the tracked features from the true ones, px."""
    points = np.einsum("fk,fkd->fd", actor.feature_weights, tracked.vertices[actor.feature_triangles])
    found = sensor.camera.project(points)
    return float(np.median(np.linalg.norm(found - sensor.ground_truth(tracked.index).features, axis=1)))


def test_half_of_the_frames_is_searched_and_features_stay_where_they_are(sensor, actor, frames):
    (every, all_of_them), (half, looked_at) = (follow(actor, frames, p) for p in (Parameters(), HALF))
    assert all_of_them == list(range(FIRST, LAST)) and all(tracked.tracked for tracked in half)
    assert len(looked_at) <= len(frames) / EVERY + 3
    mine, theirs = (np.mean([features_error(sensor, actor, t) for t in run]) for run in (half, every))
    assert mine < theirs + 0.2


def test_the_detector_is_asked_at_once_when_the_tracker_is_not_certain(actor, frames):
    """A face that is gone, a picture without colour, a hand: the next frame is searched."""
    tracker, upright = FaceTracker(actor, HALF), Upright(Detector())
    for frame in frames[:3]:
        tracker.track(upright.detect(frame))
    assert tracker.detect_every == EVERY
    copy = tracker.copy()
    assert not copy.track(replace(frames[3], depth=np.zeros_like(frames[3].depth), features=None)).tracked
    assert copy.detect_every == 1
    copy = tracker.copy()
    assert copy.track(replace(frames[3], colour=None, features=None)).tracked and copy.detect_every == 1
    half = frames[3].depth.copy()
    half[:, : half.shape[1] // 2] -= 80.0 * (half[:, : half.shape[1] // 2] > 0)
    copy = tracker.copy()
    copy.track(replace(frames[3], depth=half))
    assert copy.detect_every == 1


def test_without_the_neutrals_colours_every_frame_is_searched(actor, frames):
    _, looked_at = follow(replace(actor, appearance=None), frames[:6], HALF)
    assert looked_at == list(range(FIRST, FIRST + 6))
    assert Parameters.paper().refinement.detect_every == 1


def test_files_are_searched_as_the_tracker_asks(actor, frames):
    source = Source(frames)

    class Known(Detector):
        def detect(self, frame):
            return super().detect(replace(frame, features=frames[frame.index - FIRST].features))

    detector = Known()
    result = track_source(source, actor, HALF, detector=detector)
    assert result.tracked.all() and len(detector.looked_at) <= len(frames) / EVERY + 3
