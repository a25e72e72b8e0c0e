"""Recordings as in a mirror, on their side and upside down: pictures, depth, calibration and features change together."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
from recordings import talking_head
from scenes import coefficients, exact_actor, head_pose, posed_shape, render_frame
from test_webcam import encode

from adaptiveface.cli import main
from adaptiveface.geometry.camera import Camera
from adaptiveface.geometry.frame import FEATURE_IDS, Features2D
from adaptiveface.landmarks import Upright
from adaptiveface.live.feed import FeatureFeed
from adaptiveface.pipeline import FrameReader, capture_source, track_source
from adaptiveface.result import Result
from adaptiveface.sensors import Recording, RecordingWriter, open_sensor, open_source
from adaptiveface.sensors.orientation import OrientedSource, as_tracked, mirrored, split_mirrored, turned

PEOPLE = Path(__file__).resolve().parents[2] / "shared" / "recordings" / "people"
#: Not symmetric in anything.
CAMERA = Camera(320, 240, 262.5, 270.0, 150.0, 125.0)


def winking(frames: int):
    """The exact actor and frames of a head that turns while its left eye and the left of its mouth move."""
    actor = exact_actor()
    for k in range(frames):
        x = coefficients(actor, eyeBlinkLeft=k / frames, mouthSmileLeft=0.8 * k / frames)
        yield render_frame(actor, posed_shape(actor, x), head_pose((0.0, 0.02 * k, 0.0)), k, noise=0.2, camera=CAMERA)


def as_in_a_mirror(frame):
    """The frame as a selfie camera stores it, written down here once more, number by number."""
    width = frame.camera.width
    renamed = {18 + k: 25 - k for k in range(8)} | {36: 45, 37: 44, 38: 43, 39: 42, 40: 47, 41: 46}
    renamed |= {48: 54, 49: 53, 50: 52, 51: 51, 55: 59, 56: 58, 57: 57, 60: 64, 61: 63, 62: 62, 65: 67, 66: 66}
    renamed |= {new: old for old, new in renamed.items()}
    pixels, confidence = np.full((40, 2), np.nan), np.zeros(40)
    for slot, number in enumerate(FEATURE_IDS):
        at = int(np.flatnonzero(FEATURE_IDS == renamed[int(number)])[0])
        pixels[at] = width - 1 - frame.features.pixels[slot, 0], frame.features.pixels[slot, 1]
        confidence[at] = frame.features.confidence[slot]
    camera = dataclasses.replace(frame.camera, cx=width - 1 - frame.camera.cx)
    return dataclasses.replace(frame, depth=frame.depth[:, ::-1].copy(), camera=camera, features=Features2D(pixels, confidence))


# ---- mirrored --------------------------------------------------------------------------------------------------------
@pytest.fixture(scope="module")
def takes(tmp_path_factory):
    """A recording, the same as in a mirror, and the actor's file."""
    folder = tmp_path_factory.mktemp("takes")
    exact_actor().save(folder / "actor.npz")
    for name, change in (("straight", lambda frame: frame), ("selfie", as_in_a_mirror)):
        frames = [change(frame) for frame in winking(8)]
        with RecordingWriter(folder / name, frames[0].camera) as writer:
            for frame in frames:
                writer.write(frame)
    return folder


def tracked(folder, name, *options) -> Result:
    out = folder / f"{name}{len(options)}.npz"
    assert main(["track", str(folder / name), "--actor", str(folder / "actor.npz"), "--out", str(out), *options]) == 0
    return Result.load(out)


def test_left_and_right_come_out_right(takes):
    straight, selfie, forgotten = tracked(takes, "straight"), tracked(takes, "selfie", "--mirrored"), tracked(takes, "selfie")
    names = list(straight.expression_names)
    left, right = names.index("eyeBlinkLeft"), names.index("eyeBlinkRight")
    assert straight.coefficients[-1, left] > 0.5 > 0.2 > straight.coefficients[-1, right]
    assert np.abs(selfie.coefficients - straight.coefficients).max() < 1e-4
    assert np.abs(selfie.vertices - straight.vertices).max() < 0.01
    assert forgotten.coefficients[-1, right] > 0.5 > 0.2 > forgotten.coefficients[-1, left]
    assert selfie.mirrored and not straight.mirrored and not forgotten.mirrored


def test_a_frame_flipped_twice_is_itself_and_points_are_reflected(takes):
    for frame in winking(3):
        again = mirrored(mirrored(frame))
        assert np.array_equal(again.depth, frame.depth) and again.camera == frame.camera
        np.testing.assert_allclose(again.features.pixels, frame.features.pixels)
        once = mirrored(frame)
        points = (once.camera.rays() * once.depth[..., None])[:, ::-1] * [-1, 1, 1]
        np.testing.assert_allclose(points, frame.camera.rays() * frame.depth[..., None], atol=1e-3)
        np.testing.assert_allclose(once.features.pixels, as_in_a_mirror(frame).features.pixels)


def test_every_kind_of_source_can_be_mirrored(takes, tmp_path):
    picture = np.zeros((48, 64, 3), np.uint8)
    picture[:, :20] = 255
    video = encode(tmp_path / "selfie.avi", [picture] * 3)
    flipped = open_source(f"{video},mirrored")
    assert flipped.colour_only and flipped.fps == 25 and len(flipped) == 3
    assert flipped.read(1).colour[:, -15:].min() > 200 > 50 > flipped.read(1).colour[:, :40].max()
    with open_sensor(f"{takes / 'selfie'},mirrored") as sensor:
        played = list(sensor)
    for frame, expected in zip(played, Recording(takes / "straight"), strict=True):
        assert np.array_equal(frame.depth, expected.depth) and frame.camera == expected.camera
    with open_sensor(f"{takes / 'selfie'},mirrored") as sensor, FeatureFeed(sensor) as feed:
        first = feed.read(5)
    np.testing.assert_allclose(first.features.pixels, Recording(takes / "straight").read(0).features.pixels, atol=1e-3)


def test_a_guessed_camera_of_a_mirrored_video_can_be_corrected(tmp_path):
    """The capture sets the focal length that it has found on the source, which holds for the frames read afterwards."""
    video = open_source(str(encode(tmp_path / "selfie.avi", [np.zeros((48, 64, 3), np.uint8)] * 3)))
    video.camera = dataclasses.replace(video.camera, cx=20.0)
    for flip, quarters in ((True, 0), (False, 1), (True, 3)):
        source = OrientedSource(video, flip, quarters)
        assert source.guessed_camera and source.mirrored == flip
        source.camera = source.camera.zoomed(1.25)
        assert source.read(2).camera == source.camera
    assert video.camera.cx == 20.0 and video.camera.fx == pytest.approx(1.25**3 * 64 / 2 / np.tan(np.radians(30)))
    assert not OrientedSource(OrientedSource(video, True), True).mirrored


def test_a_file_whose_name_ends_like_that_is_itself(tmp_path):
    talking_head(tmp_path / "take,mirrored", 1)
    assert split_mirrored(str(tmp_path / "take,mirrored")) == (str(tmp_path / "take,mirrored"), False)
    assert isinstance(open_source(str(tmp_path / "take,mirrored")), Recording)


def test_capture_and_stream_take_it_too(capsys):
    for command in ("capture", "track", "live", "stream"):
        with pytest.raises(SystemExit):
            main([command, "--help"])
        assert "--mirrored" in capsys.readouterr().out


# ---- turned ----------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("quarters", range(-1, 6))
def test_a_turned_frame_sees_the_same_points_turned(quarters):
    frame = next(winking(1))
    colour = np.random.default_rng(0).integers(0, 255, (240, 320, 3), np.uint8)
    frame = dataclasses.replace(frame, colour=colour)
    after = turned(frame, quarters)
    angle = np.pi / 2 * quarters
    turn = np.array([[np.cos(angle), np.sin(angle), 0], [-np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    points, moved = ((f.camera.rays() * f.depth[..., None])[f.depth > 0] for f in (frame, after))
    order = [np.lexsort(np.round(p, 3).T) for p in (points @ turn.T, moved)]
    np.testing.assert_allclose((points @ turn.T)[order[0]], moved[order[1]], atol=1e-3)
    seen = frame.features.valid
    for pixel, there in zip(frame.features.pixels[seen], after.features.pixels[seen], strict=True):
        ray, other = (f.camera.back_project(p, np.array(1.0)) for f, p in ((frame, pixel), (after, there)))
        np.testing.assert_allclose(turn @ ray, other, atol=1e-9)
    at = np.rint(frame.features.pixels[seen][0]).astype(int)
    there = np.rint(after.features.pixels[seen][0]).astype(int)
    assert np.array_equal(after.colour[there[1], there[0]], frame.colour[at[1], at[0]])


def test_detectors_without_a_look_are_taken_as_they_are():
    class Plain:
        def detect(self, frame):
            return None

    frame = dataclasses.replace(next(winking(1)), features=None, colour=np.zeros((240, 320, 3), np.uint8))
    found = Upright(Plain()).detect(frame)
    assert found.features is None and found.depth is not None and found.camera == frame.camera


def real(name, step=1):
    folder = PEOPLE / name
    if not folder.is_dir():
        pytest.skip(f"the recording is not at {folder}")
    recording = Recording(folder)
    return recording, range(0, len(recording), step)


@pytest.mark.parametrize("quarters", range(4))
@pytest.mark.parametrize("name", ["kinect2_ir_1", "kinect2_ir_2", "kinect2_ir_3"])
def test_people_are_turned_upright(detector, caplog, name, quarters):
    recording, numbers = real(name, 7)
    reader = FrameReader(OrientedSource(recording, quarters=quarters), detector)
    faces = [reader.read(index) for index in numbers]
    assert (reader.quarters + quarters) % 4 == 0
    assert ("are turned by" in caplog.text) == (quarters > 0) and len(caplog.records) <= 1
    for index, face in zip(numbers, faces, strict=True):
        expected = recording.read(index)
        assert np.array_equal(face.depth, expected.depth) and face.camera == expected.camera


@pytest.mark.parametrize("quarters", [1, 2, 3])
def test_an_upside_down_recording_gives_the_same_head(mannequin, detector, quarters):
    """Depth, colour and calibration are turned: head and poses are those of the upright recording."""

    class Part(OrientedSource):
        def __len__(self):
            return 20

        def read(self, index):
            return super().read(36 + 2 * index)

    actor = capture_source(Part(Recording(mannequin)), detector=detector)
    straight = track_source(Part(Recording(mannequin)), actor, detector=detector)
    source = Part(Recording(mannequin), quarters=quarters)
    other = capture_source(source, detector=detector)
    result = track_source(source, other, detector=detector)
    assert (result.turned + quarters) % 4 == 0 and result.tracked.all() and straight.tracked.all()
    assert np.abs(other.neutral - actor.neutral).max() < 0.01
    assert np.abs(result.vertices - straight.vertices).max() < 0.01
    upright = as_tracked(source, result)
    assert np.array_equal(upright.read(3).colour, Recording(mannequin).read(42).colour)


@pytest.mark.parametrize("quarters", range(4))
def test_a_colour_video_is_turned_too(detector, tmp_path, quarters):
    path = PEOPLE / "webcam" / "neutral_then_strong.mp4"
    if not path.is_file():
        pytest.skip(f"the video is not at {path}")
    reader = FrameReader(OrientedSource(open_source(str(path)), quarters=quarters), detector)
    faces = [reader.read(index) for index in range(4)]
    assert (reader.quarters + quarters) % 4 == 0 and all(face.features is not None for face in faces)


def test_the_result_keeps_which_way_round_it_was(takes, tmp_path):
    result = tracked(takes, "selfie", "--mirrored")
    dataclasses.replace(result, turned=3).save(tmp_path / "r.npz")
    loaded = Result.load(tmp_path / "r.npz")
    assert (loaded.mirrored, loaded.turned) == (True, 3)
    source = as_tracked(Recording(takes / "selfie"), loaded)
    assert source.read(0).depth.shape == (320, 240)
    assert as_tracked(OrientedSource(Recording(takes / "selfie"), mirrored=True), result).read(0).depth.shape == (240, 320)
    assert json.loads(result.parameters)
