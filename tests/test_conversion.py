"""What conversion keeps and says: a camera per frame, reasons of broken frames, calibrations that lack or twist a value."""

from __future__ import annotations

import json

import numpy as np
import pytest
from recordings import SMALL, edit_intrinsics, talking_head
from test_sensors_record3d import H, W, write
from test_webcam import encode

from adaptiveface.cli import main
from adaptiveface.errors import AdaptiveFaceError, FileFormatError
from adaptiveface.sensors import Recording, RecordingWriter, open_sensor, open_source
from adaptiveface.sensors.matroska import is_plain_video
from adaptiveface.sensors.record3d import R3dRecording
from adaptiveface.sensors.video_file import VideoFile, is_video

pytest.importorskip("lzfse")
#: A lens that focuses: every frame has a camera of its own.
FOCUSING = {"perFrameIntrinsicCoeffs": [[60.0 + 0.7 * n, 61.0 + 0.7 * n, 23.0 - 0.1 * n, 31.0] for n in range(6)]}


# ---- a camera per frame ----------------------------------------------------------------------------------------------
def test_a_lens_that_moves_is_kept_by_convert(tmp_path, capsys):
    """Every measured point stays where it was, not only those of the first frame."""
    path = write(tmp_path / "a.r3d", 6, FOCUSING)
    assert main(["convert", str(path), "--out", str(tmp_path / "out")]) == 0
    assert "intrinsics.csv" in capsys.readouterr().out
    source, converted = R3dRecording(path), Recording(tmp_path / "out")
    assert len({frame.camera for frame in converted}) == 6
    for before, after in zip(source, converted, strict=True):
        both = (before.depth > 0) & (after.depth > 0)
        old, new = (frame.camera.rays() * frame.depth[..., None] for frame in (before, after))
        assert np.abs(old - new)[both].max() < 0.06  # depth is stored in tenths of a millimetre


def test_one_camera_for_all_needs_no_table(tmp_path, capsys):
    path = write(tmp_path / "a.r3d", 3, {"perFrameIntrinsicCoeffs": [[60.0, 61.0, 23.0, 31.0]] * 3})
    assert main(["convert", str(path), "--out", str(tmp_path / "out")]) == 0
    assert "intrinsics.csv" not in capsys.readouterr().out and not (tmp_path / "out" / "intrinsics.csv").exists()


def test_frames_that_the_table_leaves_out_have_the_recordings_camera(tmp_path):
    talking_head(tmp_path / "take", 3)
    (tmp_path / "take" / "intrinsics.csv").write_text("frame,fx,fy,cx,cy\n1,270,271,160,120\n")
    cameras = [frame.camera for frame in Recording(tmp_path / "take")]
    assert cameras[0] == cameras[2] == SMALL and (cameras[1].fx, cameras[1].cy) == (270, 120)


@pytest.mark.parametrize(
    ("row", "words"),
    [
        ("1,270,271,160", "line 2 has 4 values"),
        ("1,-270,271,160,120", "line 2: camera intrinsics"),
        ("1,nan,271,160,120", "line 2: camera intrinsics"),
        ("1,2,271,160,120", "line 2: fx, fy, cx, cy"),
        ("1,270,271,160,1e9", "do not fit images of 320 pixels"),
        ("x,270,271,160,120", "line 2: frame = 'x'"),
        ("1,wide,271,160,120", "line 2: fx = 'wide'"),
    ],
)
def test_a_bad_camera_is_named_with_its_line(tmp_path, row, words):
    talking_head(tmp_path / "take", 2)
    (tmp_path / "take" / "intrinsics.csv").write_text(f"frame,fx,fy,cx,cy\n{row}\n")
    with pytest.raises(FileFormatError, match=words) as error:
        Recording(tmp_path / "take")
    assert "intrinsics.csv" in str(error.value)


# ---- broken frames ---------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("broken", [1, 5, 7])
def test_the_reasons_of_broken_frames_are_printed(tmp_path, capsys, broken):
    damage = {f"rgbd/{n}.depth": b"not lzfse" for n in range(broken)}
    path = write(tmp_path / "a.r3d", 9, replace=damage)
    assert main(["convert", str(path), "--out", str(tmp_path / "out")]) == 0
    out = capsys.readouterr().out
    assert f"{broken} of the 9 frames are broken" in out
    assert out.count("not LZFSE") == min(broken, 5) and ("and 2 more" in out) == (broken == 7)


def test_record_prints_them_too(tmp_path, capsys):
    talking_head(tmp_path / "take", 4)
    (tmp_path / "take" / "depth" / "00002.png").write_bytes(b"no picture")
    assert main(["record", str(tmp_path / "take"), "--out", str(tmp_path / "out")]) == 0
    out = capsys.readouterr().out
    assert "1 of the 4 frames are broken" in out and "00002.png" in out


# ---- calibrations ----------------------------------------------------------------------------------------------------
ROW_MAJOR = [60.0, 0, 23.0, 0, 61.0, 31.0, 0, 0, 1]


def test_row_major_is_seen_by_every_reader(tmp_path):
    with pytest.raises(FileFormatError, match=r"K .* row-major, write \[60, 0, 0, 0, 61, 0, 23, 31, 1\]"):
        open_source(str(write(tmp_path / "a.r3d", 2, {"K": ROW_MAJOR})))
    talking_head(tmp_path / "take", 2)
    edit_intrinsics(tmp_path / "take", intrinsic_matrix=[262.5, 0, 159.5, 0, 262.5, 119.5, 0, 0, 1])
    with pytest.raises(FileFormatError, match="intrinsic_matrix .* row-major"):
        Recording(tmp_path / "take")
    video = encode(tmp_path / "clip.avi", [np.zeros((H, W, 3), np.uint8)] * 3)
    (tmp_path / "intrinsic.json").write_text(json.dumps({"width": W, "height": H, "intrinsic_matrix": ROW_MAJOR}))
    with pytest.raises(FileFormatError, match="intrinsic_matrix .* row-major"):
        VideoFile(video)


@pytest.mark.parametrize("values", [[3.0, 61.0, 23.0, 31.0], [60.0, 61.0, 2300.0, 31.0]])
def test_a_calibration_that_does_not_fit_the_picture(tmp_path, values):
    k = [values[0], 0, 0, 0, values[1], 0, values[2], values[3], 1] if values[0] < 60 else None
    more = {"K": k} if k else {"perFrameIntrinsicCoeffs": [[60.0, 61.0, 23.0, 31.0], values]}
    path = write(tmp_path / "a.r3d", 2, more)
    with pytest.raises(AdaptiveFaceError, match="do not fit"):
        R3dRecording(path).read(1)


def without(folder, *names):
    path = folder / "intrinsic.json"
    content = json.loads(path.read_text())
    path.write_text(json.dumps({name: value for name, value in content.items() if name not in names}))


def test_a_missing_depth_scale_is_named_with_what_is_usual(tmp_path, capsys):
    talking_head(tmp_path / "take", 2)
    without(tmp_path / "take", "depth_scale")
    assert main(["track", str(tmp_path / "take"), "--out", str(tmp_path / "r.npz")]) == 2
    message = capsys.readouterr().err
    assert "depth_scale is missing" in message and "1000" in message and "5000" in message and message.count("\n") == 1


@pytest.mark.parametrize("scale", [0.001, 0.0001])
def test_metres_per_unit_are_recognised(tmp_path, scale):
    talking_head(tmp_path / "take", 2)
    edit_intrinsics(tmp_path / "take", depth_scale=scale)
    with pytest.raises(FileFormatError, match=f"{1 / scale:g} units per metre"):
        Recording(tmp_path / "take")


@pytest.mark.parametrize("null", [True, False])
def test_a_missing_frame_rate_is_said_once(tmp_path, capsys, null):
    talking_head(tmp_path / "take", 2)
    if null:
        edit_intrinsics(tmp_path / "take", fps=None)
    else:
        without(tmp_path / "take", "fps")
    assert main(["record", str(tmp_path / "take"), "--out", str(tmp_path / "out")]) == 0
    err = capsys.readouterr().err
    assert err.count("fps is missing; 30 is taken") == 1 and "intrinsic.json" in err and err.count("\n") == 1


@pytest.mark.parametrize("fps", [None, "thirty", 0, 1e9])
def test_a_record3d_file_without_a_usable_rate(tmp_path, caplog, fps):
    source = R3dRecording(write(tmp_path / "a.r3d", 2, {"fps": fps}))
    assert source.fps == 30 and "a.r3d: fps" in caplog.text and "30 is taken" in caplog.text


# ---- .mkv ------------------------------------------------------------------------------------------------------------
def element(identifier: int, content: bytes, width: int = 8, unknown: bool = False) -> bytes:
    """An EBML element whose size takes ``width`` bytes."""
    number = (1 << (7 * width)) - 1 if unknown else len(content)
    size = (number | 1 << (7 * width)).to_bytes(width, "big")
    return identifier.to_bytes((identifier.bit_length() + 7) // 8, "big") + size + content


HEADER = element(0x1A45DFA3, element(0x4282, b"matroska", 1), 1)
TRACKS, CLUSTER = element(0x1654AE6B, b"V_MPEG4/ISO/AVC"), element(0x1F43B675, bytes(5000))
TAGS, ATTACHED = element(0x1254C367, b"..K4A_DEPTH_MODE.."), element(0x1941A469, b"..calibration.json..", 4)


@pytest.mark.parametrize(
    ("content", "plain"),
    [
        (HEADER + element(0x18538067, TRACKS + CLUSTER * 3), True),
        (HEADER + element(0x18538067, TRACKS + CLUSTER * 3, unknown=True), True),
        (HEADER + element(0x18538067, TRACKS + element(0x1F43B675, bytes(99), unknown=True), unknown=True), True),
        (HEADER + element(0x18538067, TRACKS + CLUSTER)[:2000], True),
        (HEADER + element(0x18538067, TRACKS + TAGS + CLUSTER), False),
        (HEADER + element(0x18538067, TRACKS + CLUSTER * 3 + TAGS), False),
        (HEADER + element(0x18538067, ATTACHED + TRACKS + CLUSTER, unknown=True), False),
        (HEADER, False),
        (b"", False),
        (b"anything at all", False),
        (bytes(1000), False),
        (b"\x1a\x45\xdf\xa3", False),
        (HEADER + b"\x18\x53\x80\x67\x01" + b"\xff" * 7 + b"\x00" * 100, True),
    ],
)
def test_whose_recording_an_mkv_is(tmp_path, content, plain):
    path = tmp_path / "a.mkv"
    path.write_bytes(content)
    assert is_plain_video(path) is plain and is_video(path) is plain


@pytest.mark.parametrize("name", ["film.mkv", "FILM.MKV"])
def test_a_plain_mkv_is_a_video(tmp_path, capsys, name):
    pictures = [np.full((H, W, 3), 20 * k, np.uint8) for k in range(5)]
    path = encode(tmp_path / name, pictures)
    source = open_source(str(path))
    assert isinstance(source, VideoFile) and source.colour_only and len(source) == 5
    with open_sensor(str(path)) as sensor:
        assert sensor.colour_only and len(list(sensor)) == 5
    assert main(["convert", str(path), "--out", str(tmp_path / "out")]) == 2
    assert "no depth" in capsys.readouterr().err


def test_the_writer_keeps_a_camera_per_frame_while_it_records(tmp_path):
    """What is killed in the middle of a recording keeps the cameras of its frames."""
    source = R3dRecording(write(tmp_path / "a.r3d", 6, FOCUSING))
    writer = RecordingWriter(tmp_path / "out", source.read(0).camera, 60)
    for index in range(4):
        writer.write(source.read(index))
    cameras = [frame.camera for frame in Recording(tmp_path / "out")]  # the writer is not closed
    writer.close()
    assert [camera.fx for camera in cameras] == [60.0 + 0.7 * n for n in range(4)]
