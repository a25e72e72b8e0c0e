"""Azure Kinect: recordings written and played by the SDK itself, in an environment of its own with NumPy 1."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pytest
from equivalence import performance, units_of

from adaptiveface.cli import main
from adaptiveface.errors import DriverMissingError, FileFormatError, SensorError
from adaptiveface.geometry.camera import Camera
from adaptiveface.sensors import Recording, list_sensors, open_sensor, open_source
from adaptiveface.sensors.azure import AzureDriver
from adaptiveface.sensors.registration import Lens, Registration

ROOT = Path(__file__).resolve().parents[1]
NUMPY_2 = int(np.__version__.partition(".")[0]) >= 2


@pytest.mark.skipif(not NUMPY_2, reason="NumPy 1 is installed")
def test_with_numpy_2_the_way_out_is_given(tmp_path, capsys):
    (tmp_path / "take.mkv").write_bytes(b"anything")
    for name in ("azure", "azure:1", f"azure:{tmp_path / 'take.mkv'}", str(tmp_path / "take.mkv")):
        with pytest.raises(DriverMissingError, match=r'NumPy 1.*python3.11 -m venv.*install "adaptiveface\[azure\]"'):
            open_sensor(name)
    assert "NumPy 1" in {info.name: info.state for info in list_sensors()}["azure"]
    assert main(["convert", str(tmp_path / "take.mkv"), "--out", str(tmp_path / "out")]) == 2
    message = capsys.readouterr().err
    assert "NumPy 1" in message and message.count("\n") == 1 and not (tmp_path / "out").exists()


def test_without_the_driver_the_pip_line_is_given(monkeypatch):
    monkeypatch.setattr(np, "__version__", "1.26.4")
    monkeypatch.setitem(sys.modules, "pyk4a", None)
    with pytest.raises(DriverMissingError, match=r'pip install "adaptiveface\[azure\]"'):
        AzureDriver()


def test_names_that_mean_nothing(tmp_path):
    for argument in ("-1", "1234", "no such file.mkv", str(tmp_path)):
        with pytest.raises(SensorError, match="neither the number of a camera nor a recording"):
            open_sensor(f"azure:{argument}")
    (tmp_path / "a.mkv").write_bytes(b"")
    with pytest.raises(FileFormatError, match="adaptiveface convert"):
        open_source(str(tmp_path / "a.mkv"))


# ---- depth and picture of two lenses ---------------------------------------------------------------------------------
def lens(camera: Camera, *distortion: float) -> Lens:
    return Lens(camera.width, camera.height, camera.matrix, np.array(distortion or [0.0] * 8))


SMALL = Camera(64, 48, 60.0, 60.0, 31.5, 23.5)


def test_without_distortion_depth_stays_as_it_is_and_nothing_has_no_colour():
    registration = Registration(lens(SMALL), lens(SMALL))
    depth = np.random.default_rng(0).integers(0, 5000, (48, 64)).astype(np.uint16)
    np.testing.assert_array_equal(registration.depth(depth), depth)
    colour = registration.colour(np.full((48, 64, 3), 90, np.uint8), registration.depth(depth))
    assert (colour[depth == 0] == 0).all() and (colour[depth > 0] == 90).all()
    assert not registration.colour(np.full((48, 64, 3), 90, np.uint8), np.zeros((48, 64))).any()


def test_no_measurement_arises_between_foreground_and_background():
    registration = Registration(lens(SMALL, 0.4, -0.1, 0.001, 0.002, 0, 0, 0, 0))
    raw = np.full((48, 64), 900.0)
    raw[10:30, 20:40] = 500.0
    raw[:, 45:50] = 0
    assert set(np.unique(registration.depth(raw))) == {0.0, 500.0, 900.0}


def test_the_picture_is_shifted_by_the_baseline():
    picture = np.zeros((48, 64, 3), np.uint8)
    picture[:, 40:] = 255
    registration = Registration(lens(SMALL), lens(SMALL), translation=(-50.0, 0, 0))
    aligned = registration.colour(picture, np.full((48, 64), 600.0))
    assert int(np.argmax(aligned[20, :, 0] > 127)) == 40 + 60 * 50 // 600


# ---- the SDK itself --------------------------------------------------------------------------------------------------
@pytest.mark.slow
def test_a_recording_tracks_to_the_same_result(numpy_1, tmp_path):
    """The performance in an MKV of the SDK's recorder, converted with the command line, tracked here."""
    p = performance(640, 576, 504.0)
    plain = [p.camera.fx, p.camera.fy, p.camera.cx, p.camera.cy, *[0.0] * 8]
    np.savez(
        tmp_path / "take.npz",
        depth=np.stack([units_of(f, 1000) for f in p.frames]),
        depth_lens=plain,
        colour=np.full((720, 1280, 3), (200, 100, 50), np.uint8),
        baseline=-32.0,
        colour_lens=[610, 610, 639.5, 359.5, *[0.0] * 8],
    )
    numpy_1(ROOT / "tests" / "azure_mkv.py", tmp_path / "take.npz", tmp_path / "take.mkv")
    printed = numpy_1("-m", "adaptiveface", "convert", tmp_path / "take.mkv", "--out", tmp_path / "out")
    assert f"{len(p)} frames" in printed and "0 dropped" in printed
    recording = Recording(tmp_path / "out")
    assert recording.camera == p.camera and recording.fps == 30
    frames = list(recording)
    for given, got in zip(p.quantised(1000), frames, strict=True):
        np.testing.assert_array_equal(given.depth, got.depth)
        seen = got.depth > 0
        assert np.abs(got.colour[seen].astype(int).mean(axis=0) - [200, 100, 50]).max() < 6
    result = p.compare(frames, 1000)
    print(f"\nAzure Kinect, MKV: {result}")
    assert result.worst < 0.2 and result.frames == len(p)


@pytest.mark.slow
def test_lens_distortion_and_picture_agree_with_the_sdk(numpy_1, tmp_path):
    result = json.loads(numpy_1(ROOT / "tests" / "azure_check.py", tmp_path))
    print(f"\nAzure Kinect, a plane through the lens: {result}")
    assert result["frames"] == [0, 1] and result["times"] == pytest.approx([1.0, 1 + 1 / 30], abs=1e-3)
    assert result["plane"] < 0.3 < 3 < result["bent"]  # depth is stored in whole millimetres
    worst, mean = result["picture"]
    assert worst < 3 and mean < 1  # JPEG alone changes colours by a step or two


@pytest.mark.slow
def test_failures_come_from_the_sdk_in_the_packages_words(numpy_1, tmp_path):
    (tmp_path / "bad.mkv").write_bytes(b"nothing of the kind" * 100)
    message = numpy_1("-m", "adaptiveface", "convert", tmp_path / "bad.mkv", "--out", tmp_path / "out", status=2)
    assert "bad.mkv: not an Azure Kinect recording with depth" in message and message.count("\n") == 1
    message = numpy_1("-m", "adaptiveface", "record", "azure", "--out", tmp_path / "out", status=2)
    assert "none is connected" in message and message.count("\n") == 1
