"""The guided neutral scan: steps, warnings, the choice of frames; on the synthetic sensor and on the real recording."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from scenes import coefficients, exact_actor, head_pose, posed_shape, render_frame

from adaptiveface.errors import TrackingError
from adaptiveface.geometry.frame import Features2D, RgbdFrame
from adaptiveface.geometry.mesh import rigid_alignment, transform_points
from adaptiveface.live.face_quality import expression, head_angles, sharpness
from adaptiveface.live.guided import MIN_FRAMES, STEPS, GuidedCapture
from adaptiveface.sensors.recording import Recording
from adaptiveface.synthetic.sensor import SyntheticSensor


@pytest.fixture(scope="module")
def actor():
    return exact_actor()


@pytest.fixture(scope="module")
def sensor() -> SyntheticSensor:
    return SyntheticSensor(3, neutral_frames=20, frames=70, repeats=1)


def turned(yaw: float = 0.0, pitch: float = 0.0, distance: float = 500.0) -> np.ndarray:
    """A head turned by degrees to its left and up."""
    return head_pose((-np.radians(pitch), -np.radians(yaw), 0.0), (0.0, 0.0, distance))


def still(actor, seconds: float, pose=None, shape=None, start: float = 0.0, fps: float = 10.0) -> list[RgbdFrame]:
    """The same picture again and again, with timestamps."""
    frame = render_frame(actor, actor.neutral if shape is None else shape, turned() if pose is None else pose)
    return [replace(frame, index=k, timestamp=start + k / fps) for k in range(round(seconds * fps))]


def test_angles_are_the_persons_own_left_and_up():
    for yaw, pitch in ((20.0, 0.0), (0.0, 15.0), (-12.0, -7.0)):
        np.testing.assert_allclose(head_angles(turned(yaw, pitch)), (yaw, pitch), atol=1.0)
    aside = turned()
    aside[:3, 3] = [200.0, 0.0, 500.0]
    assert head_angles(aside)[0] > 15, "straight ahead, but seen from its left side"


def test_every_step_is_asked_for_and_a_full_turn_ends_early(actor):
    guide, said, clock = GuidedCapture(), [], 0.0
    path = [(0, 0)] * 12 + [(y, 0) for y in range(0, 26, 2)] + [(y, 0) for y in range(24, -26, -2)]
    path += [(y, 0) for y in range(-24, 1, 4)] + [(0, p) for p in (2, 4, 6, 8, 10, 12, 12, 12, 8, 4, 0)]
    path += [(0, -p) for p in (2, 4, 6, 8, 10, 12, 12, 12)]
    for index, (yaw, pitch) in enumerate(path):
        clock += 0.1
        frame = replace(render_frame(actor, actor.neutral, turned(yaw, pitch), index, noise=0.3), timestamp=clock)
        guidance = guide.add(frame)
        assert guidance.warnings == () or guidance.done, (yaw, pitch, guidance.warnings)
        if not said or said[-1] != guidance.step:
            said.append(guidance.step)
        if guidance.done:
            break
    assert guidance.done and guidance.warnings == () and guidance.progress == 1.0
    assert [step for step in said if step in STEPS][:3] == ["straight", "left", "right"] and said[-1] == "done"
    assert clock < guide.seconds and min(guidance.coverage.values()) == 1.0
    yaws = [head_angles(turned(*path[frame.index]))[0] for frame in guide.frames]
    assert min(yaws) < -20 and max(yaws) > 20, "frames from both sides are kept"


def test_a_still_head_ends_by_time_with_a_word_about_its_sides(actor):
    guide = GuidedCapture(seconds=3.0)
    results = [guide.add(frame) for frame in still(actor, 5.0)]
    first = next(k for k, result in enumerate(results) if result.done)
    assert first == pytest.approx(30, abs=1)
    assert "left, right, up, down" in results[-1].warnings[0] and len(guide.frames) == first + 1
    progress = [result.progress for result in results]
    assert progress == sorted(progress)


def test_expressions_are_pointed_out_and_not_chosen(actor):
    names = [name for name in actor.expression_names if "jaw" in name.lower()]
    open_mouth = posed_shape(actor, coefficients(actor, **{names[0]: 0.6}))
    guide = GuidedCapture(seconds=3.0)
    wide = [guide.add(frame) for frame in still(actor, 2.0, shape=open_mouth)]
    assert all(result.warnings == ("close your mouth",) for result in wide) and wide[-1].step == "straight"
    results = [guide.add(replace(frame, index=100 + frame.index)) for frame in still(actor, 3.0, start=2.0)]
    assert results[-1].done and all(frame.index >= 100 for frame in guide.frames)


def test_a_face_that_never_looks_neutral_is_used_after_twice_the_time(actor):
    wide = posed_shape(actor, coefficients(actor, **{actor.expression_names[0]: 0.6}))
    guide = GuidedCapture(seconds=2.0)
    results = [guide.add(frame) for frame in still(actor, 6.0, shape=wide)]
    first = next(k for k, result in enumerate(results) if result.done)
    assert first == pytest.approx(40, abs=1) and any("without a warning" in w for w in results[-1].warnings)


def test_what_is_wrong_with_a_frame(actor):
    good = still(actor, 0.2)[0]
    cases = {
        "no face": replace(good, features=None),
        "no depth": replace(good, depth=np.zeros_like(good.depth)),
        "too near": still(actor, 0.2, turned(distance=200.0))[0],
        "too far": still(actor, 0.2, turned(distance=1200.0))[0],
    }
    for text, frame in cases.items():
        guide = GuidedCapture()
        assert text in guide.add(frame).warnings[0]
        if text.startswith("no "):
            with pytest.raises(TrackingError, match="none of the 1 frames"):
                guide.finish()
        else:
            assert guide.finish().warnings, "better than nothing, but said"
    guide = GuidedCapture()
    guide.add(good)
    shifted = Features2D(good.features.pixels + [60.0, 0.0], good.features.confidence)
    assert "blurred" in guide.add(replace(good, features=shifted, timestamp=0.05)).warnings[0]


def test_blur_is_judged_against_the_sharpness_so_far(sensor):
    guide = GuidedCapture()
    frames = [sensor.read(k) for k in range(8)]
    assert all(guide.add(frame).warnings == () for frame in frames)
    frame = sensor.read(8)
    smeared = replace(frame, colour=cv2.GaussianBlur(frame.colour, (0, 0), 2.0))
    assert sharpness(smeared) < 0.4 * sharpness(frame)
    assert "blurred" in guide.add(smeared).warnings[0]


def test_enough_ends_it_at_once(actor):
    guide = GuidedCapture()
    for frame in still(actor, 0.4):
        guide.add(frame)
    assert guide.finish().done and guide.done and len(guide.frames) == 4
    count = guide.frames_seen
    guide.add(still(actor, 0.2)[0])
    assert guide.frames_seen == count, "nothing is added after the end"


def test_the_sensors_neutral_frames_make_the_head(sensor):
    """The live performance: neutral frames among expressions; the scan takes the neutral ones and covers the face."""
    guide, warned = GuidedCapture(seconds=5.0, most=20), []
    for k in range(200):
        step = k % 178
        frame = sensor.read(step if step < 90 else 178 - step)
        guidance = guide.add(replace(frame, index=k, timestamp=k / 30))
        warned += guidance.warnings if not guidance.done else ()
        if guidance.done:
            break
    assert guidance.done and len(guide.frames) == 20
    assert {"close your mouth", "keep your eyes open"} <= set(warned)
    assert guide.vertex_coverage[guide.model.frontal].mean() > 0.9 and guide.vertex_coverage.max() == 1.0
    actor, truth = guide.build(), sensor.ground_truth(0)
    head = transform_points(np.linalg.inv(truth.head_pose), truth.vertices)[: len(actor.neutral)][actor.frontal]
    found = actor.neutral[actor.frontal]
    pose = rigid_alignment(found, head)
    assert np.median(np.linalg.norm(transform_points(pose, found) - head, axis=1)) < 3.0


def test_expression_measure_is_zero_on_the_neutral_under_any_pose(actor):
    for yaw, pitch in ((0, 0), (25, 5), (-25, -8)):
        frame = render_frame(actor, actor.neutral, turned(yaw, pitch))
        assert expression(frame.features, frame.features.pixels).worst == pytest.approx(0, abs=1e-9)
    unseen = Features2D(np.full((40, 2), np.nan), np.zeros(40))
    assert expression(unseen, frame.features.pixels).worst == 0.0


@pytest.mark.slow
def test_the_real_head_is_scanned_on_both_sides(mannequin, detector):
    recording, guide = Recording(mannequin), GuidedCapture()
    for index in range(len(recording)):
        frame = recording.read(index)
        guidance = guide.add(replace(frame, features=detector.detect(frame), timestamp=index / 9))
    assert guidance.coverage["left"] == guidance.coverage["right"] == guidance.coverage["straight"] == 1.0
    assert guidance.coverage["up"] < 0.5 and not guidance.done
    assert guide.finish().warnings == (
        "the head hardly turned up, down: what shows only from there comes from the average head",
    )
    assert MIN_FRAMES < len(guide.frames) <= 60
    assert guide.vertex_coverage[guide.model.frontal].mean() > 0.85
