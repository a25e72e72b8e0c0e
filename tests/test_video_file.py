"""Video files: presentation times, edit lists, rotation, damage; made with FFmpeg, each frame numbered by its white columns."""

from __future__ import annotations

import subprocess
from pathlib import Path

import numpy as np
import pytest

from adaptiveface.cli import main
from adaptiveface.errors import FileFormatError, FrameError, ParameterError
from adaptiveface.geometry.camera import Camera
from adaptiveface.sensors import open_source
from adaptiveface.sensors.video_file import VIDEO_SUFFIXES, VideoFile

pytest.importorskip("av")
imageio_ffmpeg = pytest.importorskip("imageio_ffmpeg")
CASES = Path(__file__).resolve().parents[2] / "shared" / "cases" / "videos"


def ffmpeg(*arguments) -> None:
    subprocess.run([imageio_ffmpeg.get_ffmpeg_exe(), "-v", "error", "-y", *map(str, arguments)], check=True)


def counted(path: Path, *options, count: int = 90, size: str = "160x120", rate: int = 30) -> Path:
    """A video whose frame k is white in its first k + 4 columns."""
    source = f"color=black:size={size}:rate={rate}:duration={count / rate},format=gray,geq=lum='255*lt(X,N+4)'"
    ffmpeg("-f", "lavfi", "-i", source, "-pix_fmt", "yuv420p", *options, path)
    return path


def numbers(video: VideoFile) -> np.ndarray:
    """Which source frame each frame shows, by its white columns."""
    return np.array([number(video.read(k).colour) for k in range(len(video))])


def number(picture: np.ndarray) -> int:
    return int((picture.mean(axis=(0, 2)) > 128).sum()) - 4


def test_variable_rate_uses_presentation_times():
    if not (CASES / "vfr.mp4").is_file():
        pytest.skip("the case is not here")
    video = open_source(str(CASES / "vfr.mp4"))
    assert video.timestamps[20] == pytest.approx(0.8, abs=1e-6) and video.timestamps[40] == pytest.approx(2.28, abs=1e-6)
    assert video.read(40).timestamp == pytest.approx(2.28, abs=1e-6)


@pytest.mark.parametrize("container", ["mp4", "mov", "webm", "ts"])
@pytest.mark.parametrize("b_frames", [0, 3])
def test_dropped_frames_leave_gaps_in_the_times(tmp_path, container, b_frames):
    codec = ("libvpx", "-b:v", "2M") if container == "webm" else ("libx264", "-bf", str(b_frames))
    drop = "select='not(between(n,20,39))'"
    path = tmp_path / f"clip.{'mts' if container == 'ts' else container}"
    source = "color=black:size=160x120:rate=30:duration=3,format=gray,geq=lum='255*lt(X,N+4)'"
    extra = ("-f", "mpegts") if container == "ts" else ()
    ffmpeg("-f", "lavfi", "-i", source, "-vf", drop, "-fps_mode", "vfr", "-pix_fmt", "yuv420p", "-c:v", *codec, *extra, path)
    video = VideoFile(path)
    kept = np.r_[0:20, 40:90]
    assert len(video) == 70 and not video.notes
    np.testing.assert_allclose(video.timestamps, kept / 30, atol=1.1e-3)
    np.testing.assert_array_equal(numbers(video), kept)


@pytest.mark.parametrize("start", [0.35, 1.0, 2.0])
def test_an_edit_list_is_honoured(tmp_path, start):
    whole = counted(tmp_path / "whole.mp4", "-c:v", "libx264", "-g", "250", "-bf", "3")
    ffmpeg("-ss", start, "-i", whole, "-c", "copy", tmp_path / "cut.mp4")
    video = VideoFile(tmp_path / "cut.mp4")
    shown = numbers(video)  # raises where one cannot be decoded
    assert abs(shown[0] - 30 * start) <= 3 and shown[-1] == 89 and (np.diff(shown) == 1).all()
    assert not video.notes and video.timestamps[0] == 0
    np.testing.assert_allclose(np.diff(video.timestamps), 1 / 30, atol=1e-6)


@pytest.mark.parametrize("degrees", [0, 90, 180, 270])
def test_a_rotated_phone_video_is_upright(tmp_path, degrees):
    still = "color=black:size=160x120:rate=30:duration=0.4,drawbox=x=0:y=0:w=40:h=30:color=white:t=fill"
    ffmpeg("-f", "lavfi", "-i", still, "-pix_fmt", "yuv420p", "-c:v", "libx264", tmp_path / "a.mp4")
    ffmpeg("-display_rotation", degrees, "-i", tmp_path / "a.mp4", "-c", "copy", tmp_path / "b.mp4")
    turned = np.rot90(VideoFile(tmp_path / "a.mp4").read(3).colour, degrees // 90)
    video = VideoFile(tmp_path / "b.mp4")
    assert (video.camera.height, video.camera.width) == turned.shape[:2]
    np.testing.assert_array_equal(video.read(3).colour, turned)


@pytest.mark.parametrize("suffix", [".wmv", ".avi", ".webm", ".mov", ".m4v", ".mpg", ".flv"])
def test_kinds_of_files_play(tmp_path, suffix):
    assert suffix in VIDEO_SUFFIXES
    video = open_source(str(counted(tmp_path / f"clip{suffix}", "-q:v", "2", "-b:v", "2M")))
    assert len(video) == 90 and video.fps == pytest.approx(30, rel=1e-3)
    np.testing.assert_allclose(np.diff(video.timestamps), 1 / 30, atol=1.1e-3)
    assert (np.diff(numbers(video)) >= 0).all() and numbers(video)[-1] >= 87


def test_odd_sizes_one_frame_and_ten_bits(tmp_path):
    odd = VideoFile(counted(tmp_path / "odd.mp4", "-vf", "scale=161:121", "-c:v", "mpeg4", count=5))
    assert (odd.camera.width, odd.camera.height, len(odd)) == (161, 121, 5)
    one = VideoFile(counted(tmp_path / "one.mp4", count=1))
    assert len(one) == 1 and one.timestamps.tolist() == [0] and one.fps == 30
    ten = VideoFile(counted(tmp_path / "ten.mp4", "-pix_fmt", "yuv420p10le", "-c:v", "libx265", count=6))
    assert ten.read(5).colour.dtype == np.uint8 and len(ten) == 6


@pytest.mark.parametrize("share", [0.3, 0.6, 0.9])
@pytest.mark.parametrize("key_distance", [10, 250])
def test_a_file_that_is_cut_off_ends_with_its_last_frame_and_says_so(tmp_path, share, key_distance):
    noise = ("-vf", "noise=alls=60:allf=t", "-c:v", "libx264", "-g", str(key_distance), "-movflags", "+faststart")
    path = counted(tmp_path / "clip.mp4", *noise)
    content = path.read_bytes()
    path.write_bytes(content[: int(share * len(content))])
    video = VideoFile(path)
    assert 5 < len(video) < 90 and f"{len(video)} of its 90 frames" in video.notes[0] and "clip.mp4" in video.notes[0]
    assert all(video.read(k).colour.any() for k in range(len(video)))  # none of them is broken
    with pytest.raises(IndexError):
        video.read(len(video))


def test_damage_in_the_middle_costs_only_its_frames(tmp_path):
    path = counted(tmp_path / "clip.mp4", "-vf", "noise=alls=60:allf=t", "-c:v", "libx264", "-g", "10", "-bf", "0")
    content = bytearray(path.read_bytes())
    middle = len(content) // 2
    content[middle : middle + 3000] = bytes(3000)
    path.write_bytes(content)
    video, lost, seen = VideoFile(path), [], {}
    for k in range(len(video)):
        try:
            seen[k] = video.read(k).colour.mean()
        except FrameError as error:
            lost.append(k)
            assert f"frame {k} cannot be decoded" in str(error)
    assert len(video) == 90 and 1 <= len(lost) <= 12
    assert {0, 89} <= seen.keys() and video.read(89).timestamp == pytest.approx(89 / 30)


@pytest.mark.parametrize("text", ["#EXTM3U\n#EXTINF:1,\nclip.ts\n", "ffconcat version 1.0\nfile clip.ts\n", "", "text"])
def test_a_play_list_under_a_videos_name_is_none(tmp_path, text):
    counted(tmp_path / "clip.ts", "-c:v", "libx264", count=5)
    (tmp_path / "list.mp4").write_text(text)
    with pytest.raises(FileFormatError, match="list.mp4: not a video"):
        open_source(str(tmp_path / "list.mp4"))


def test_frames_in_any_order(tmp_path):
    video = VideoFile(counted(tmp_path / "clip.mp4", "-c:v", "libx264", "-bf", "3"))
    order = [80, 3, 3, 2, 89, 0]
    assert [number(video.read(k).colour) for k in order] == order
    video.close()
    assert video.read(7).index == 7


def test_field_of_view(tmp_path):
    path = str(counted(tmp_path / "clip.mp4", count=3))
    assert open_source(path).camera.fx == pytest.approx(80 / np.tan(np.radians(30)))
    assert open_source(path, 90.0).camera.fx == pytest.approx(80)
    calibration = '{"width": 160, "height": 120, "intrinsic_matrix": [150, 0, 0, 0, 150, 0, 80, 60, 1]}'
    (tmp_path / "intrinsic.json").write_text(calibration)
    assert isinstance(open_source(path).camera, Camera) and open_source(path).camera.fx == 150
    assert open_source(path, 90.0).camera.fx == pytest.approx(80)  # what is said counts more than what lies there
    with pytest.raises(ParameterError, match="for a video only"):
        open_source(str(tmp_path), 60.0)


@pytest.mark.parametrize("value", ["5", "200", "wide", "nan"])
def test_an_impossible_field_of_view_ends_in_one_line(tmp_path, value, capsys):
    with pytest.raises(SystemExit) as done:
        main(["track", "clip.mp4", "--fov", value, "--out", str(tmp_path / "r.npz")])
    assert done.value.code == 2 and "between 10 and 150 degrees" in capsys.readouterr().err


def test_the_command_says_what_is_missing_and_makes_the_outputs_folder(tmp_path, capsys):
    path = counted(tmp_path / "clip.mp4", "-vf", "noise=alls=60:allf=t", "-c:v", "libx264", "-movflags", "+faststart")
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    main(["track", str(path), "--fov", "70", "--out", str(tmp_path / "new" / "folder" / "r.npz")])
    assert "is cut off: 43 of its 90 frames can be read" in capsys.readouterr().out  # whatever is seen in the stripes
    assert (tmp_path / "new" / "folder").is_dir()


@pytest.mark.parametrize("command", ["track", "capture", "export", "live"])
def test_a_folder_that_cannot_be_made_is_one_line(tmp_path, command, capsys):
    (tmp_path / "file").write_text("")
    out = str(tmp_path / "file" / "deep" / ("x.glb" if command == "export" else "x.npz"))
    source = ["synthetic", "--headless"] if command == "live" else ["synthetic"]
    assert main([command, *source, "--out", out]) == 2
    error = capsys.readouterr().err.strip()
    assert len(error.splitlines()) == 1 and "cannot be made" in error and out in error
