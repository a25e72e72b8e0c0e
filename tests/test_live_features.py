"""The detector on a stream: video mode's clock, several faces, and what a covered mouth does to the tracker."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from adaptiveface.camera import Camera
from adaptiveface.frame import RgbdFrame
from adaptiveface.landmarks import FeatureDetector
from adaptiveface.landmarks.kept_face import PATIENCE, KeptFace, VideoClock
from adaptiveface.synthetic.sensor import SyntheticSensor

WIDE = Camera(1280, 480, 525.0, 525.0, 639.5, 239.5)


@pytest.fixture(scope="module")
def video(detector):
    """A detector in video mode; skips where the detector does."""
    with_video = FeatureDetector(video=True)
    yield with_video
    with_video.close()
    with_video.close()


@pytest.fixture(scope="module")
def performers():
    """A person at 0.6 m and another one, larger, at 0.45 m: 4 neutral frames of each."""
    options = dict(neutral_frames=4, frames=0, repeats=0)
    return [list(SyntheticSensor(5, **options)), list(SyntheticSensor(7, distance=450.0, **options))]


def side_by_side(performers, index: int, left: bool, right: bool) -> RgbdFrame:
    """One wide frame of the first performer on the left and the second one on the right, each where it is present."""
    shown = [frames[index % 4] for frames in performers]
    blank = np.full_like(shown[0].colour, 128), np.zeros_like(shown[0].depth)
    parts = [(f.colour, f.depth) if seen else blank for f, seen in zip(shown, (left, right), strict=True)]
    colour, depth = (np.concatenate(images, axis=1) for images in zip(*parts, strict=True))
    return RgbdFrame(depth, WIDE, colour, index, index / 30)


# ---- the clock of video mode ------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    "stamps",
    [
        [k / 30 for k in range(20)],
        [5.0, 5.0, 5.0001, 5.0002, 5.0003],
        [100.0, 100.033, 0.0, 0.033, 0.066, -5.0],
        [1.0, math.nan, 2.0, math.inf, 3.0],
        [1.0, 1e9, 1e9 + 0.03, 2.0],
    ],
)
def test_video_milliseconds_always_rise_by_little(stamps):
    clock = VideoClock()
    steps = np.diff([clock.tick(stamp) for stamp in stamps])
    assert (steps >= 1).all() and (steps <= 1000).all()


def test_the_clock_follows_the_sensor():
    clock = VideoClock()
    ticks = [clock.tick(7.0 + k / 30) for k in range(31)]
    assert abs(ticks[-1] - ticks[0] - 1000) <= 15


def test_video_mode_survives_restarting_clocks_and_new_sizes_and_sees_what_single_images_see(
    video, detector, performers
):
    frames = performers[0]
    for size, stamp in ((1, 10.0), (1, 10.03), (1, 0.0), (2, 0.03), (2, math.nan), (1, 0.1)):
        frame = dataclasses.replace(frames[1], timestamp=stamp)
        if size == 2:
            frame = dataclasses.replace(frame, colour=frame.colour[40:, 60:], depth=frame.depth[40:, 60:])
        np.testing.assert_array_equal(video.detect(frame).pixels, detector.detect(frame).pixels)


# ---- several faces ------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("mode", ["video", "single images"])
def test_the_tracked_face_is_kept_beside_a_nearer_and_larger_one(mode, request, performers):
    found = request.getfixturevalue("video" if mode == "video" else "detector")
    found._kept = KeptFace()
    sides = []
    for k in range(24):
        features = found.detect(side_by_side(performers, k, left=k < 12 or k >= 22, right=4 <= k))
        sides.append("none" if features is None else "left" if features.pixels[:, 0].mean() < 640 else "right")
    patience = round(PATIENCE * 30)
    assert sides[:12] == ["left"] * 12
    assert sides[12 : 12 + patience - 1] == ["none"] * (patience - 1)  # away: not exchanged at once
    assert sides[-3:] == ["right"] * 3  # the other one was taken, and is kept in turn


def test_at_first_the_nearest_face_is_taken_and_without_depth_the_largest(detector, performers):
    detector._kept = KeptFace()
    frame = side_by_side(performers, 0, True, True)
    assert detector.detect(frame).pixels[:, 0].mean() > 640
    detector._kept = KeptFace()
    beyond = np.where(np.arange(1280) >= 640, frame.depth + 400 * (frame.depth > 0), frame.depth)
    assert detector.detect(dataclasses.replace(frame, depth=beyond)).pixels[:, 0].mean() < 640
    detector._kept = KeptFace()
    assert detector.detect(dataclasses.replace(frame, depth=0 * frame.depth)).pixels[:, 0].mean() > 640


def test_a_face_that_passes_in_front_of_the_kept_one_is_not_taken():
    mesh = np.random.default_rng(0).uniform(200, 300, (100, 3))
    depth = np.full((480, 640), 700.0, np.float32)
    frame = RgbdFrame(depth, Camera(640, 480, 525.0, 525.0, 319.5, 239.5), timestamp=0.0)
    kept = KeptFace()
    assert kept.choose([mesh], frame) is mesh
    nearer = dataclasses.replace(frame, depth=depth - 250, timestamp=0.03)
    assert kept.choose([mesh + 10], nearer) is None
    assert kept.choose([mesh], dataclasses.replace(frame, timestamp=0.2)) is mesh
