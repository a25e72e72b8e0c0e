"""Record3D files, written here in the app's layout: exact depth, scaled pictures, and files that are broken."""

from __future__ import annotations

import io
import json
import struct
import sys
import zipfile

import numpy as np
import pytest
from equivalence import performance
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from PIL import Image

from adaptiveface.cli import main
from adaptiveface.errors import AdaptiveFaceError, DriverMissingError, FileFormatError, FrameError
from adaptiveface.sensors import Recording, open_sensor, open_source
from adaptiveface.sensors.lzfse_stream import decompress, unpacked_size
from adaptiveface.sensors.record3d import R3dRecording

lzfse = pytest.importorskip("lzfse")
W, H = 48, 64
METADATA = {"w": W, "h": H, "dw": W, "dh": H, "fps": 60, "K": [60.0, 0, 0, 0, 61.0, 0, 23.0, 31.0, 1]}


def depth_of(number: int) -> np.ndarray:
    depth = np.random.default_rng(number).uniform(0.3, 0.6, (H, W)).astype("<f4")
    depth[0, :3] = np.nan, np.inf, 0.0
    return depth


def expected(number: int) -> np.ndarray:
    return np.nan_to_num(depth_of(number), nan=0, posinf=0) * np.float32(1000)


def write(path, count=3, metadata=None, replace=None, size=(W, H)):
    """``replace``: entry -> bytes, None leaves it out."""
    entries = {"metadata": json.dumps({**METADATA, **(metadata or {})}).encode()}
    for n in range(count):
        picture = io.BytesIO()
        Image.new("RGB", size, (200, 20 * n, 50)).save(picture, "JPEG", quality=95)
        entries[f"rgbd/{n}.jpg"], entries[f"rgbd/{n}.depth"] = picture.getvalue(), lzfse.compress(depth_of(n).tobytes())
        entries[f"rgbd/{n}.conf"] = lzfse.compress(bytes(W * H))
    entries.update(replace or {})
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in entries.items():
            if content is not None:
                archive.writestr(name, content)
    return path


def test_depth_is_exact_in_millimetres_and_the_picture_aligned(tmp_path):
    source = open_source(str(write(tmp_path / "a.r3d", 12)))
    assert isinstance(source, R3dRecording) and len(source) == 12 and source.fps == 60
    for n in range(12):  # 10 and 11 come after 9, not after 1
        frame = source.read(n)
        assert np.array_equal(frame.depth, expected(n)) and frame.depth.dtype == np.float32
        assert frame.timestamp == pytest.approx(n / 60)
        assert np.abs(frame.colour.astype(int) - [200, 20 * n, 50]).max() <= 6
    assert (source.camera.fx, source.camera.fy, source.camera.cx, source.camera.cy) == (60, 61, 23, 31)


def test_calibration_scales_from_picture_to_depth(tmp_path):
    """A point keeps its place in the picture: pixel edges, not centres, scale."""
    large = {"w": 3 * W, "h": 3 * H, "K": [180.0, 0, 0, 0, 183.0, 0, 70.0, 94.0, 1]}
    frame = open_source(str(write(tmp_path / "a.r3d", 1, large, size=(3 * W, 3 * H)))).read(0)
    assert frame.colour.shape == (H, W, 3)
    point = np.array([20.0, -30.0, 400.0])
    in_picture = np.array([180 * point[0], 183 * point[1]]) / point[2] + [70.0, 94.0]
    np.testing.assert_allclose(frame.camera.project(point), (in_picture + 0.5) / 3 - 0.5)


def test_calibration_and_time_per_frame(tmp_path):
    more = {"perFrameIntrinsicCoeffs": [[50 + n, 50, 23, 31] for n in range(3)], "frameTimestamps": [5.0, 5.1, 5.3]}
    source = R3dRecording(write(tmp_path / "a.r3d", 3, more))
    assert [frame.camera.fx for frame in source] == [50, 51, 52]
    assert source.timestamps.tolist() == [5.0, 5.1, 5.3]


def test_as_sensor_and_converted(tmp_path, capsys):
    path = write(tmp_path / "a.r3d", 5, replace={"rgbd/2.depth": b"bvx$"})
    with open_sensor(str(path)) as sensor:
        frames = list(sensor)
    assert [f.sequence for f in frames] == [0, 1, 3, 4] and frames[-1].dropped == 1
    assert main(["convert", str(path), "--out", str(tmp_path / "out")]) == 0
    assert "4 frames" in capsys.readouterr().out
    converted = Recording(tmp_path / "out")
    for n, frame in zip((0, 1, 3, 4), converted, strict=True):
        np.testing.assert_allclose(frame.depth, expected(n), atol=0.0501)  # stored in tenths of a millimetre
        assert frame.camera == frames[0].camera


def test_a_file_tracks_to_the_same_result(tmp_path):
    p = performance()
    c = p.camera
    k = [c.fx, 0, 0, 0, c.fy, 0, c.cx, c.cy, 1]
    size = {"w": c.width, "h": c.height, "dw": c.width, "dh": c.height}
    metres = [(f.depth / np.float32(1000)).astype("<f4") for f in p.frames]
    depths = {f"rgbd/{n}.depth": lzfse.compress(m.tobytes()) for n, m in enumerate(metres)}
    with open_sensor(str(write(tmp_path / "take.r3d", 0, {**size, "K": k}, depths))) as sensor:
        got = list(sensor)
    result = p.compare(got, 10_000)
    print(f"\nRecord3D, .r3d file: {result}")
    assert result.worst < 0.2 and result.frames == len(p)


@pytest.mark.parametrize(
    ("metadata", "replace", "words"),
    [
        ({}, {"metadata": None}, "metadata"),
        ({}, {"metadata": b"{"}, "not readable as JSON"),
        ({}, {"metadata": b"[1]"}, "not a JSON object"),
        ({"dw": 0}, {}, "dw = 0"),
        ({"dw": 10**6}, {}, "dw = 1000000"),
        ({"h": "64"}, {}, "h = '64'"),
        ({"h": True}, {}, "h = True"),
        ({"w": 64}, {}, "differ in shape"),
        ({"K": [1, 2]}, {}, "list of 9"),
        ({"K": [0] * 9}, {}, "intrinsics"),
        ({"K": [1e300] * 9}, {}, "list of 9"),
        ({}, {f"rgbd/{n}.depth": None for n in range(3)}, "no depth images"),
    ],
)
def test_a_file_that_cannot_be_used_is_named_with_its_value(tmp_path, metadata, replace, words):
    path = write(tmp_path / "bad.r3d", 3, metadata, replace)
    with pytest.raises(FileFormatError, match=words) as error:
        open_source(str(path))
    assert "bad.r3d" in str(error.value)


def test_not_a_zip(tmp_path):
    (tmp_path / "a.r3d").write_bytes(b"nothing of the kind")
    with pytest.raises(FileFormatError, match="not a readable zip archive"):
        open_source(str(tmp_path / "a.r3d"))


BOMB = b"".join(struct.pack("<4sII", b"bvxn", 2**31, 8) + bytes(8) for _ in range(1000)) + b"bvx$"


@pytest.mark.parametrize(
    ("entry", "content", "words"),
    [
        ("rgbd/1.depth", BOMB, "2147483648000 bytes"),
        ("rgbd/1.depth", b"", "cut off"),
        ("rgbd/1.depth", b"not lzfse at all", "not LZFSE"),
        ("rgbd/1.depth", lzfse.compress(bytes(100)), "holds 100 bytes"),
        ("rgbd/1.depth", lzfse.compress(bytes(4 * W * H)), "no measurement"),
        ("rgbd/1.jpg", b"no picture", "not readable as an image"),
    ],
)
def test_a_broken_frame_is_skipped_and_named(tmp_path, entry, content, words):
    source = R3dRecording(write(tmp_path / "a.r3d", 3, replace={entry: content}))
    with pytest.raises(FrameError, match=words) as error:
        source.read(1)
    assert entry in str(error.value) and "a.r3d" in str(error.value)
    assert [frame.index for frame in source] == [0, 2]


@pytest.mark.parametrize("size", [10, 5_000, 200_000])
@pytest.mark.parametrize("kind", ["noise", "smooth", "zeros"])
def test_the_unpacked_size_is_known_before_unpacking(size, kind):
    rng = np.random.default_rng(size)
    smooth = (500 + np.cumsum(rng.integers(-2, 3, size))).astype(np.uint8)
    content = {"noise": rng.bytes(size), "smooth": smooth.tobytes(), "zeros": bytes(size)}[kind]
    packed = lzfse.compress(content)
    assert unpacked_size(packed, "x") == size and decompress(packed, size, "x") == content
    with pytest.raises(FrameError):
        decompress(packed[:-4], size, "x")


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(at=st.integers(0, 10**6), value=st.integers(0, 255), cut=st.booleans())
def test_damage_anywhere_raises_only_the_packages_errors(tmp_path, at, value, cut):
    clean = tmp_path / "clean.r3d"
    if not clean.exists():
        write(clean, 2)
    content = bytearray(clean.read_bytes())
    at %= len(content)
    content[at] = value
    (tmp_path / "damaged.r3d").write_bytes(content[:at] if cut else content)
    try:
        source = open_source(str(tmp_path / "damaged.r3d"))
        for index in range(len(source)):
            try:
                assert source.read(index).depth.shape == (H, W)
            except FrameError:
                pass
    except AdaptiveFaceError:
        pass


def test_without_the_extra_the_pip_line_is_given(tmp_path, monkeypatch):
    path = write(tmp_path / "a.r3d")
    monkeypatch.setitem(sys.modules, "lzfse", None)
    with pytest.raises(DriverMissingError, match=r'pip install "adaptiveface\[record3d\]"'):
        open_source(str(path))
