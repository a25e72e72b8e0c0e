"""Azure Kinect: recordings written and played by the SDK itself, in an environment of its own with NumPy 1."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest
from equivalence import performance, units_of

from adaptiveface.camera import Camera
from adaptiveface.cli import main
from adaptiveface.errors import DriverMissingError, FileFormatError, SensorError
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
def packages() -> list[str]:
    """What reading a sensor needs, of the project's own requirements, and the extra ``azure``."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    needed = [p for p in project["dependencies"] if re.match(r"(numpy|opencv|pillow)", p)]
    assert len(needed) == 3
    return needed + project["optional-dependencies"]["azure"]


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """Runs Python in a new environment with pyk4a-bundle and NumPy 1; returns what it printed."""
    if sys.version_info >= (3, 13) or sys.platform != "linux":
        pytest.skip("pyk4a-bundle has no build for this Python or system")
    python = tmp_path_factory.mktemp("azure") / "venv" / "bin" / "python"
    quiet = ["-q", "--disable-pip-version-check", "--only-binary", ":all:"]
    for command in (
        [sys.executable, "-m", "venv", str(python.parents[1])],
        [str(python), "-m", "pip", "install", *quiet, *packages()],
        [str(python), "-c", "import pyk4a"],
    ):
        done = subprocess.run(command, capture_output=True, text=True, timeout=300)
        if done.returncode:
            pytest.skip(f"no environment with pyk4a-bundle and NumPy 1: {done.stderr.strip()[-300:]}")

    def execute(*arguments, status: int = 0) -> str:
        path = os.pathsep.join([str(ROOT), str(ROOT / "tests")])
        command = [str(python), *map(str, arguments)]
        done = subprocess.run(command, capture_output=True, text=True, timeout=120, env={**os.environ, "PYTHONPATH": path})
        assert done.returncode == status, done.stderr[-2000:]
        return done.stdout if status == 0 else done.stderr

    return execute


@pytest.mark.slow
def test_a_recording_tracks_to_the_same_result(run, tmp_path):
    """The performance in an MKV of the SDK's recorder, converted with the command line, tracked here."""
    p = performance(640, 576, 504.0)
    plain = [p.camera.fx, p.camera.fy, p.camera.cx, p.camera.cy, *[0.0] * 8]
    np.savez(
        tmp_path / "take.npz", depth=np.stack([units_of(f, 1000) for f in p.frames]), depth_lens=plain,
        colour=np.full((720, 1280, 3), (200, 100, 50), np.uint8), baseline=-32.0,
        colour_lens=[610, 610, 639.5, 359.5, *[0.0] * 8],
    )  # fmt: skip
    run(ROOT / "tests" / "azure_mkv.py", tmp_path / "take.npz", tmp_path / "take.mkv")
    printed = run("-m", "adaptiveface", "convert", tmp_path / "take.mkv", "--out", tmp_path / "out")
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
def test_lens_distortion_and_picture_agree_with_the_sdk(run, tmp_path):
    result = json.loads(run(ROOT / "tests" / "azure_check.py", tmp_path))
    print(f"\nAzure Kinect, a plane through the lens: {result}")
    assert result["frames"] == [0, 1] and result["times"] == pytest.approx([1.0, 1 + 1 / 30], abs=1e-3)
    assert result["plane"] < 0.3 < 3 < result["bent"]  # depth is stored in whole millimetres
    worst, mean = result["picture"]
    assert worst < 3 and mean < 1  # JPEG alone changes colours by a step or two


@pytest.mark.slow
def test_failures_come_from_the_sdk_in_the_packages_words(run, tmp_path):
    (tmp_path / "bad.mkv").write_bytes(b"nothing of the kind" * 100)
    message = run("-m", "adaptiveface", "convert", tmp_path / "bad.mkv", "--out", tmp_path / "out", status=2)
    assert "bad.mkv: not an Azure Kinect recording with depth" in message and message.count("\n") == 1
    message = run("-m", "adaptiveface", "record", "azure", "--out", tmp_path / "out", status=2)
    assert "none is connected" in message and message.count("\n") == 1
