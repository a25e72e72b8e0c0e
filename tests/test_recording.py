"""Recordings: what is written is read back, and whatever is wrong is named."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest
from PIL import Image
from recordings import edit_intrinsics, mutated, png_header

from adaptiveface.errors import FileFormatError, FrameError, ParameterError, TrackingError
from adaptiveface.geometry.camera import Camera
from adaptiveface.geometry.frame import FEATURE_IDS, Features2D, RgbdFrame
from adaptiveface.geometry.source import Abilities
from adaptiveface.pipeline import capture_source
from adaptiveface.sensors import FrameSource, Recording, RecordingWriter, open_source
from adaptiveface.sensors.intrinsics import read_camera
from adaptiveface.sensors.orientation import OrientedSource, mirrored, turned
from adaptiveface.sensors.record3d import R3dRecording
from adaptiveface.sensors.video_file import VideoFile
from adaptiveface.studies.session import Session
from adaptiveface.synthetic.sensor import SyntheticSensor

CAMERA = Camera(24, 16, 30.0, 31.0, 11.5, 7.5)


def make_frame(index: int) -> RgbdFrame:
    rng = np.random.default_rng(index)
    depth = rng.integers(4000, 8000, (16, 24)).astype(np.float32) / 10
    depth[0, :5] = 0
    pixels = rng.uniform(0, 16, (40, 2))
    confidence = rng.uniform(0.1, 1, 40)
    pixels[3], confidence[3] = np.nan, 0
    colour = rng.integers(0, 256, (16, 24, 3)).astype(np.uint8)
    return RgbdFrame(depth, CAMERA, colour, index, 0.04 * index + 1, Features2D(pixels, confidence))


@pytest.fixture
def folder(tmp_path):
    """A recording of five lossless frames."""
    with RecordingWriter(tmp_path / "take", CAMERA, fps=25, depth_scale=10_000, colour_format="png") as writer:
        for index in range(5):
            assert writer.write(make_frame(index)) == index
    return tmp_path / "take"


def test_what_is_written_is_read_back(folder):
    recording = Recording(folder)
    assert isinstance(recording, FrameSource)
    assert (recording.camera, recording.fps, recording.depth_scale) == (CAMERA, 25, 10_000)
    assert (recording.name, len(recording), recording.has_features) == ("take", 5, True)
    for index, frame in enumerate(recording):
        truth = make_frame(index)
        assert frame.index == index and frame.timestamp == pytest.approx(truth.timestamp, abs=1e-6)
        np.testing.assert_allclose(frame.depth, truth.depth, atol=1e-3)
        assert frame.depth.dtype == np.float32
        np.testing.assert_array_equal(frame.colour, truth.colour)
        np.testing.assert_allclose(frame.features.pixels, truth.features.pixels, atol=1e-4)
        np.testing.assert_allclose(frame.features.confidence, truth.features.confidence, atol=1e-4)
    assert not list(folder.rglob("*.part"))


def test_irises_are_kept_in_a_table_of_their_own(folder, tmp_path):
    assert not (folder / "irises.csv").exists() and Recording(folder).read(0).features.irises is None
    seen = np.array([[12.5, 6.25], [4.0, 5.5]])
    with RecordingWriter(tmp_path / "looking", CAMERA, fps=25) as writer:
        for irises in (seen, None, [[np.nan, np.nan], seen[1]]):
            frame = make_frame(0)
            irises = None if irises is None else np.array(irises)
            writer.write(dataclasses.replace(frame, features=dataclasses.replace(frame.features, irises=irises)))
    assert (tmp_path / "looking/irises.csv").read_text().splitlines()[:2] == ["frame,eye,u,v", "0,left,12.5000,6.2500"]
    frames = [Recording(tmp_path / "looking").read(k).features for k in range(3)]
    np.testing.assert_array_equal(frames[0].iris_centres, seen)
    assert frames[1].iris_centres is None and np.isnan(frames[2].irises[0]).all()
    for quarters in range(1, 5):
        frame = Recording(tmp_path / "looking").read(0)
        for _ in range(quarters):
            frame = turned(frame, 1)
        np.testing.assert_allclose(
            frame.features.irises, turned(Recording(tmp_path / "looking").read(0), quarters).features.irises
        )
    np.testing.assert_allclose(frame.features.irises, seen)
    np.testing.assert_allclose(mirrored(frame).features.irises, [[19.0, 5.5], [10.5, 6.25]])  # 23 - u: the right eye is left
    (tmp_path / "looking/irises.csv").write_text("frame,eye,u,v\n0,middle,1,2\n")
    with pytest.raises(FileFormatError, match="line 2: eye = 'middle' is neither left nor right"):
        Recording(tmp_path / "looking")


def test_depth_is_stored_in_the_layout_of_the_contract(folder):
    stored = np.asarray(Image.open(folder / "depth" / "00002.png"))
    np.testing.assert_array_equal(stored, np.rint(make_frame(2).depth * 10).astype(np.uint16))
    intrinsics = json.loads((folder / "intrinsic.json").read_text())
    assert intrinsics["intrinsic_matrix"] == [30.0, 0, 0, 0, 31.0, 0, 11.5, 7.5, 1]


def test_depth_beyond_the_range_of_the_file_is_no_measurement(tmp_path):
    depth = np.full((16, 24), 500, np.float32)
    depth[0, 0], depth[0, 1], depth[0, 2] = 7000, np.nan, -3
    with RecordingWriter(tmp_path, CAMERA, depth_scale=10_000) as writer:
        writer.write(RgbdFrame(depth, CAMERA))
    read = Recording(tmp_path).read(0)
    assert (read.depth[0, :3] == 0).all() and (read.depth[1:] == 500).all()
    assert read.colour is None and read.features is None and not Recording(tmp_path).has_features


def test_jpeg_colour_comes_back_close(tmp_path):
    u, v = np.meshgrid(np.arange(24), np.arange(16))
    colour = np.stack([4 * u, 8 * v, 60 + 2 * u + 2 * v], axis=-1).astype(np.uint8)
    with RecordingWriter(tmp_path, CAMERA) as writer:
        writer.write(RgbdFrame(np.full((16, 24), 500, np.float32), CAMERA, colour))
    assert (tmp_path / "color" / "00000.jpg").is_file()
    assert np.abs(Recording(tmp_path).read(0).colour.astype(int) - colour).max() <= 6


def truncate(path):
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


BREAKAGES = {
    "missing depth": ("depth/00002.png", lambda p: p.unlink(), "missing"),
    "missing colour": ("color/00002.png", lambda p: p.unlink(), "missing"),
    "truncated depth": ("depth/00002.png", truncate, "not readable as an image"),
    "truncated colour": ("color/00002.png", truncate, "not readable as an image"),
    "empty file": ("depth/00002.png", lambda p: p.write_bytes(b""), "not readable as an image"),
    "text": ("color/00002.png", lambda p: p.write_text("no picture"), "not readable as an image"),
    "a folder": ("depth/00002.png", lambda p: (p.unlink(), p.mkdir()), "not a regular file"),
    "wrong size": ("depth/00002.png", lambda p: Image.new("I;16", (24, 17), 5000).save(p), "24 x 17 pixels"),
    "wrong colour size": ("color/00002.png", lambda p: Image.new("RGB", (25, 16)).save(p), "25 x 16 pixels"),
    "8-bit depth": ("depth/00002.png", lambda p: Image.new("L", (24, 16), 200).save(p), "16-bit grey"),
    "all zero": ("depth/00002.png", lambda p: Image.new("I;16", (24, 16), 0).save(p), "every pixel is zero"),
    "all too near": ("depth/00002.png", lambda p: Image.new("I;16", (24, 16), 9).save(p), "depth_scale 10000"),
    "huge": ("depth/00002.png", lambda p: p.write_bytes(png_header(60_000, 60_000)), "00002.png"),
}


@pytest.mark.parametrize("name", BREAKAGES)
def test_a_broken_frame_is_named_and_the_others_still_read(folder, name):
    file, damage, reason = BREAKAGES[name]
    damage(folder / file)
    recording = Recording(folder)
    assert len(recording) == 5
    with pytest.raises(FrameError) as caught:
        recording.read(2)
    assert str(folder / file).rsplit(".", 1)[0] in str(caught.value) and reason in str(caught.value)
    assert [frame.index for frame in recording] == [0, 1, 3, 4]


def test_a_damaged_image_never_raises_anything_else(folder):
    """300 seeded mutations of a depth PNG and of a JPEG: a frame or a FrameError."""
    Image.fromarray(make_frame(1).colour).save(folder / "color" / "00001.jpg")
    (folder / "color" / "00001.png").unlink()
    recording = Recording(folder)
    refused = 0
    for file in (folder / "depth" / "00001.png", folder / "color" / "00001.jpg"):
        content = file.read_bytes()
        for seed in range(150):
            file.write_bytes(mutated(content, seed))
            try:
                frame = recording.read(1)
                assert frame.depth.shape == (16, 24) and frame.colour.shape == (16, 24, 3)
            except FrameError:
                refused += 1
        file.write_bytes(content)
    assert refused > 100


MATRIX = [30.0, 0, 0, 0, 31.0, 0, 11.5, 7.5, 1]
BAD_INTRINSICS = {
    "NaN focal length": (dict(intrinsic_matrix=[float("nan"), *MATRIX[1:]]), "intrinsic_matrix = nan"),
    "infinite centre": (dict(intrinsic_matrix=[*MATRIX[:6], float("inf"), 7.5, 1]), "intrinsic_matrix = inf"),
    "NaN depth scale": (dict(depth_scale=float("nan")), "depth_scale = nan"),
    "zero depth scale": (dict(depth_scale=0), "depth_scale = 0"),
    "depth scale per millimetre": (dict(depth_scale=1), "depth_scale = 1 "),
    "absurd depth scale": (dict(depth_scale=1e30), "depth_scale = 1e+30"),
    "negative depth scale": (dict(depth_scale=-1000), "depth_scale = -1000"),
    "depth scale as text": (dict(depth_scale="1000"), "depth_scale = 1000"),
    "no depth scale": (dict(depth_scale=None), "depth_scale = None"),
    "row-major": (dict(intrinsic_matrix=[30.0, 0, 11.5, 0, 31.0, 7.5, 0, 0, 1]), "row-major"),
    "8 numbers": (dict(intrinsic_matrix=MATRIX[:8]), "list of 9"),
    "nested": (dict(intrinsic_matrix=[MATRIX[:3], MATRIX[3:6], MATRIX[6:]]), "list of 9"),
    "negative focal length": (dict(intrinsic_matrix=[-30.0, *MATRIX[1:]]), "fx"),
    "tiny focal length": (dict(intrinsic_matrix=[0.1, *MATRIX[1:]]), "do not fit"),
    "negative width": (dict(width=-24), "-24"),
    "huge width": (dict(width=10**9), "16384"),
    "endless width": (dict(width=10**400), "width"),
    "half a pixel": (dict(width=24.5), "not whole"),
    "zero fps": (dict(fps=0), "fps = 0"),
}


@pytest.mark.parametrize("name", BAD_INTRINSICS)
def test_unusable_intrinsics_are_named(folder, name):
    values, reason = BAD_INTRINSICS[name]
    path = edit_intrinsics(folder, **values)
    with pytest.raises(FileFormatError) as caught:
        Recording(folder)
    assert str(path) in str(caught.value) and reason in str(caught.value)


def test_a_rate_that_is_missing_is_assumed_with_a_warning(folder, caplog):
    path = edit_intrinsics(folder, fps=None)
    assert Recording(folder).fps == 30 and f"{path}: fps is missing; 30 is taken" in caplog.text
    caplog.clear()
    edit_intrinsics(folder, depth_scale=None)
    assert read_camera(path) == CAMERA and not caplog.text  # pictures that bring their own rate need the camera only


def test_what_a_source_declares_has_defaults(folder):
    class Own:
        name, camera, fps, timestamps = "own", CAMERA, 15.0, np.arange(3) / 15

        def read_colour(self, index):
            return np.full((2, 2, 3), index, np.uint8)

    recording, own, none = Recording(folder), Abilities.of(Own()), Abilities.of(None)
    assert Abilities.of(recording) is recording and recording.unit_file == folder / "intrinsic.json"
    assert (own.fps, own.has_features, own.notes) == (15.0, False, ()) and len(own.timestamps) == 3
    assert own.read_colour(1).max() == 1 and none.read_colour(1) is None and none.path is None
    own.close()


@pytest.mark.parametrize("of_ours", [R3dRecording, Recording, VideoFile, OrientedSource, SyntheticSensor, Session])
def test_our_own_sources_declare_what_they_are(of_ours):
    source = of_ours.__new__(of_ours)
    assert Abilities.of(source) is source  # nothing is guessed from the names of their attributes


@pytest.mark.parametrize("content", ["", "[1, 2]", "{", "[" * 100_000, '{"width": 3', "\x00\x01", '"text"'])
def test_intrinsics_that_are_no_json_object(folder, content):
    (folder / "intrinsic.json").write_text(content)
    with pytest.raises(FileFormatError, match="intrinsic.json"):
        Recording(folder)


def test_missing_parts_of_a_recording(folder, tmp_path):
    with pytest.raises(FileFormatError, match="no such folder"):
        Recording(tmp_path / "nowhere")
    for file in (folder / "depth").iterdir():
        file.unlink()
    with pytest.raises(FileFormatError, match="no depth images"):
        Recording(folder)
    (folder / "intrinsic.json").unlink()
    with pytest.raises(FileFormatError, match="intrinsic.json: no such file"):
        Recording(folder)


def test_timestamps_follow_the_frame_rate_where_the_table_is_silent(folder):
    path = folder / "timestamps.csv"
    path.write_text("frame,timestamp\n1,10.0\n3,10.5\n")
    np.testing.assert_allclose(Recording(folder).timestamps, [9.96, 10.0, 10.25, 10.5, 10.54])
    path.unlink()
    np.testing.assert_allclose(Recording(folder).timestamps, np.arange(5) / 25)


@pytest.mark.parametrize(
    ("table", "text", "reason"),
    [
        ("timestamps.csv", "frame,time\n0,1\n", "first line"),
        ("timestamps.csv", "frame,timestamp\n0,nan\n", "line 2: timestamp = nan"),
        ("timestamps.csv", "frame,timestamp\n0,1\n1,soon\n", "line 3: timestamp = 'soon'"),
        ("timestamps.csv", "frame,timestamp\n0,1,2\n", "line 2 has 3 values"),
        ("features.csv", "frame,feature,u,v,confidence\n0,99,1,1,1\n", "feature 99"),
        ("features.csv", "frame,feature,u,v,confidence\n0,36,1,1,7\n", "confidence = 7"),
        ("features.csv", "frame,feature,u,v,confidence\n0,36,1,1,nan\n", "confidence = nan"),
        ("features.csv", "frame,feature,u,v,confidence\n0.5,36,1,1,1\n", "'0.5'"),
        ("features.csv", "frame,feature,u,v,confidence\n0,36,here,1,1\n", "u = 'here'"),
        ("features.csv", "", "first line"),
    ],
)
def test_bad_tables_are_named_with_their_line(folder, table, text, reason):
    (folder / table).write_text(text)
    with pytest.raises(FileFormatError) as caught:
        Recording(folder)
    assert str(folder / table) in str(caught.value) and reason in str(caught.value)


def test_binary_table(folder):
    (folder / "features.csv").write_bytes(b"\xff\xfe\x00" * 50)
    with pytest.raises(FileFormatError, match="features.csv"):
        Recording(folder)


def test_features_outside_the_forty_are_passed_over_and_nan_is_not_seen(folder):
    rows = ["frame,feature,u,v,confidence", "1,30,5,5,1", "1,48,3,4,0.5", "1,36,nan,4,1", "77,36,1,1,1"]
    (folder / "features.csv").write_text("\n".join(rows))
    recording = Recording(folder)
    assert recording.read(0).features is None and recording.has_features
    features = recording.read(1).features
    assert FEATURE_IDS[features.valid].tolist() == [48]
    np.testing.assert_array_equal(features.pixels[features.valid], [[3, 4]])


def test_numbering_may_start_anywhere_and_gaps_stay_gaps(folder):
    for sub in ("depth", "color"):
        for k in (4, 3, 1, 0):
            (folder / sub / f"{k:05d}.png").rename(folder / sub / f"{k + 120}.png")
        (folder / sub / "00002.png").unlink()
        (folder / sub / "notes.png").write_text("not a frame")
    recording = Recording(folder)
    assert len(recording) == 5 and [frame.index for frame in recording] == [0, 1, 3, 4]
    np.testing.assert_allclose(recording.read(3).depth, make_frame(3).depth, atol=1e-3)
    (folder / "depth" / "124.png").rename(folder / "depth" / "999999999.png")
    with pytest.raises(FileFormatError, match="numbered from"):
        Recording(folder)


def test_indices_outside_a_recording(folder):
    for index in (-1, 5):
        with pytest.raises(IndexError):
            Recording(folder).read(index)


def test_the_writer_refuses_what_it_could_not_read_back(folder, tmp_path):
    with pytest.raises(FileFormatError, match="already holds a recording"):
        RecordingWriter(folder, CAMERA)
    with pytest.raises(FileFormatError, match="depth_scale = 1 "):
        RecordingWriter(tmp_path / "new", CAMERA, depth_scale=1)
    with RecordingWriter(tmp_path / "other", CAMERA) as writer, pytest.raises(FileFormatError, match="24 x 16"):
        writer.write(RgbdFrame(np.full((16, 25), 500, np.float32), CAMERA))


def test_open_source_knows_recordings_and_says_what_is_possible(folder, tmp_path):
    assert open_source(str(folder)).name == "take"
    (tmp_path / "film.txt").write_bytes(b"")
    for text in (str(tmp_path / "nowhere"), str(tmp_path / "film.txt")):
        with pytest.raises(FileFormatError, match="possible sources: .*synthetic:SEED"):
            open_source(text)
    for text in ("synthetic:x", "synthetic:-1", "synthetic:1:loud", "synthetic:99999999999"):
        with pytest.raises(ParameterError, match="possible sources"):
            open_source(text)


def test_open_source_makes_the_synthetic_sensor():
    sensor = open_source("synthetic:7:truedepth")
    assert (sensor.seed, sensor.noise) == (7, "truedepth") and len(sensor) > 0


def test_real_recording(mannequin):
    recording = Recording(mannequin)
    assert len(recording) == 90 and recording.depth_scale == 8000 and not recording.has_features
    frames = list(recording)
    assert len(frames) == 90 and frames[0].colour.shape == (320, 240, 3)
    near = np.array([np.percentile(frame.depth[frame.depth > 0], 5) for frame in frames])
    assert (near > 200).all() and (near < 450).all()
    assert (np.diff([frame.timestamp for frame in frames]) > 0).all()


def test_a_recording_of_broken_frames_alone_is_refused_with_the_first_reason(folder):
    for path in (folder / "depth").iterdir():
        path.write_bytes(b"no picture")
    with pytest.raises(TrackingError, match="no frame can be used; 5 broken frames, the first: .*00000.png"):
        capture_source(Recording(folder))
