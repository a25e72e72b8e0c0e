"""``adaptiveface live --headless``: lists, scans, tracks, records and streams; Ctrl-C and errors leave everything behind."""

from __future__ import annotations

import dataclasses
import os
import signal
import subprocess
import sys
import time
from io import StringIO
from types import SimpleNamespace

import numpy as np
import pytest
from live_faults import ScriptedDriver, raw
from recordings import talking_head

from adaptiveface import lab
from adaptiveface.cli import main
from adaptiveface.errors import RecordingError, SensorDisconnectedError
from adaptiveface.live import recorder as recorder_module
from adaptiveface.live import status
from adaptiveface.model.actor import Actor
from adaptiveface.result import Result
from adaptiveface.sensors import Recording, kinds
from adaptiveface.sensors.live import LiveSensor
from adaptiveface.synthetic.sensor import SyntheticSensor


@pytest.fixture(scope="module")
def take(tmp_path_factory):
    """(recording folder, its exact actor.npz)"""
    folder = tmp_path_factory.mktemp("live")
    talking_head(folder / "take").save(folder / "actor.npz")
    return folder / "take", folder / "actor.npz"


def live(*args) -> int:
    return main(["live", *map(str, args)])


def test_without_a_sensor_it_lists_what_there_is(capsys):
    assert live("--headless") == 0
    out = capsys.readouterr().out
    assert "synthetic " in out and "realsense" in out and "record3d" in out


def test_a_recording_is_tracked_recorded_and_saved(take, tmp_path, capsys):
    recording, actor = take
    out, copy, again = tmp_path / "r.npz", tmp_path / "copy", tmp_path / "a.npz"
    options = ("--actor", actor, "--out", out, "--record", copy, "--save-actor", again, "--personal-actor", tmp_path / "p.npz")
    often = "personal_blendshapes.interval=3"
    assert live(recording, "--headless", *options, "--set", "adaptive_pca.K=3", often) == 0
    text = capsys.readouterr().out
    assert "8 frames: 8 tracked" in text and "latency" in text and f"{copy}: 8 frames" in text
    result = Result.load(out)
    assert result.tracked.all() and '"K": 3' in result.parameters
    command = ("track", recording, "--actor", actor, "--out", tmp_path / "t.npz", "--set", "adaptive_pca.K=3", often)
    assert main([str(word) for word in command]) == 0
    np.testing.assert_array_equal(Result.load(tmp_path / "t.npz").vertices, result.vertices)  # as without threads
    for a, b in zip(Recording(recording), Recording(copy), strict=True):
        assert np.array_equal(a.depth, b.depth)
    np.testing.assert_array_equal(Actor.load(again).neutral, Actor.load(actor).neutral)
    learned = result.rig(Actor.load(actor)).blendshapes
    np.testing.assert_allclose(Actor.load(tmp_path / "p.npz").blendshapes, learned, atol=1e-4)
    assert np.abs(learned - Actor.load(actor).blendshapes).max() > 0.01


def test_bad_requests_end_in_one_line_before_any_work(take, tmp_path, capsys):
    recording, actor = take
    for options, words in (
        ((recording, "--headless", "--out", tmp_path / "r.txt"), "must end in .npz"),
        ((recording, "--headless", "--out", recording / "intrinsic.json" / "r.npz"), "cannot be made"),
        ((recording, "--headless", "--record", recording), "is also read by this command"),
        ((recording, "--headless", "--vmc", "a:99999999"), "HOST:PORT"),
        (("kinect9", "--headless"), "possible sensors"),
        (("synthetic", "--out", tmp_path / "r.npz", "--seconds", "3"), "--out, --seconds: only with --headless"),
        (("synthetic", "--actor", tmp_path / "none.npz"), "none.npz"),
    ):
        assert live(*options) == 2
        err = capsys.readouterr().err
        assert words in err and err.count("\n") == 1 and not (tmp_path / "r.npz").exists()


def test_the_notebook_is_told_sensor_and_actor(take, tmp_path, monkeypatch):
    for name in ("ADAPTIVEFACE_SENSOR", "ADAPTIVEFACE_ACTOR"):
        monkeypatch.setenv(name, "")
    started = []
    monkeypatch.setattr(lab, "_become", lambda command, environment: started.append((command, environment)) or 0)
    monkeypatch.setattr(lab, "NEEDED", ())
    assert live(take[0], "--actor", take[1], "--dir", tmp_path / "books") == 0
    command, environment = started[0]
    assert "--LabApp.default_url=/lab/tree/live_sensor.ipynb" in command
    assert environment["ADAPTIVEFACE_SENSOR"] == str(take[0]) and environment["ADAPTIVEFACE_ACTOR"] == str(take[1])


def play(monkeypatch, steps, **options):
    """What ``scripted`` opens from now on."""
    scripted = SimpleNamespace(open=lambda _: LiveSensor(lambda: ScriptedDriver(steps), **options))
    monkeypatch.setitem(kinds.KINDS, "scripted", scripted)


def steps_of(take):
    return [raw(frame, i) for i, frame in enumerate(Recording(take[0]))]


def test_without_an_actor_the_neutral_is_scanned_by_text(tmp_path, monkeypatch, capsys):
    """Half a second from frame to frame, so that 24 of them are the ten seconds of the scan, and the rest is tracked."""
    performer = SyntheticSensor(5, neutral_frames=24, frames=8, repeats=1, colour=False)
    play(monkeypatch, [dataclasses.replace(raw(f, i), timestamp=i / 2) for i, f in enumerate(performer)])
    quick = ["fit.iterations=8", "shrink_wrap.iterations=3", "fusion.passes=1", "fusion.voxel=4"]
    assert live("scripted", "--headless", "--save-actor", tmp_path / "a.npz", "--out", tmp_path / "r.npz", "--set", *quick) == 0
    out = capsys.readouterr().out
    assert "look straight at the camera" in out and "turn your head slowly to your left" in out
    neutral = Actor.load(tmp_path / "a.npz").neutral
    assert np.abs(neutral - performer.performer.neutral).mean() < 10.0  # mm, in the performer's own head frame
    result = Result.load(tmp_path / "r.npz")
    assert 8 <= len(result) < 20 and result.tracked.all()


def test_a_recording_that_is_all_scan_says_so_and_keeps_the_actor(tmp_path, monkeypatch, capsys):
    performer = SyntheticSensor(5, neutral_frames=10, frames=0, repeats=1, colour=False)
    play(monkeypatch, [raw(f, i) for i, f in enumerate(performer)])
    quick = ["fit.iterations=8", "shrink_wrap.iterations=3", "fusion.passes=1", "fusion.voxel=4"]
    assert live("scripted", "--headless", "--save-actor", tmp_path / "a.npz", "--set", *quick) == 2
    assert "the recording ended with the neutral scan" in capsys.readouterr().err and (tmp_path / "a.npz").is_file()


def test_a_sensor_without_depth_is_not_recorded(take, tmp_path, monkeypatch, capsys):
    sensor = LiveSensor(lambda: ScriptedDriver(steps_of(take)))
    sensor.colour_only = True
    monkeypatch.setitem(kinds.KINDS, "scripted", SimpleNamespace(open=lambda _: sensor))
    assert live("scripted", "--headless", "--actor", take[1], "--record", tmp_path / "rec") == 2
    assert "no depth, and a recording is made of depth" in capsys.readouterr().err and not (tmp_path / "rec").exists()


def test_a_sensor_that_fails_for_good_ends_with_its_error_and_the_result_is_kept(take, tmp_path, monkeypatch, capsys):
    play(monkeypatch, [*steps_of(take)[:5], SensorDisconnectedError("scripted: unplugged")], reconnect=False)
    assert live("scripted", "--headless", "--actor", take[1], "--out", tmp_path / "r.npz") == 2
    assert "scripted: unplugged" in capsys.readouterr().err
    assert len(Result.load(tmp_path / "r.npz")) == 5


def test_a_full_disk_ends_the_recording_only_and_is_told_at_the_end(take, tmp_path, monkeypatch, capsys):
    def full(self, frame):
        if self.frames or self._waiting:
            raise RecordingError(f"{self.writer.path}: No space left on device after 1 frames, which are kept")
        return write(self, frame)

    write = recorder_module.FrameRecorder.write
    monkeypatch.setattr(recorder_module.FrameRecorder, "write", full)
    play(monkeypatch, steps_of(take))
    code = live("scripted", "--headless", "--actor", take[1], "--out", tmp_path / "r.npz", "--record", tmp_path / "rec")
    assert code == 2 and "No space left" in capsys.readouterr().err
    assert len(Result.load(tmp_path / "r.npz")) == 8 and len(Recording(tmp_path / "rec")) == 1


def test_streaming_a_live_sensor_goes_through_the_same_session(take, monkeypatch, capsys):
    pytest.importorskip("pythonosc")
    play(monkeypatch, steps_of(take))
    assert main(["stream", "scripted", "--actor", str(take[1])]) == 0
    out = capsys.readouterr().out
    assert "VMC to 127.0.0.1:39539" in out and "latency" in out


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="signals")
def test_ctrl_c_ends_cleanly_and_everything_is_saved(take, tmp_path):
    arguments = [
        "live",
        "synthetic:5",
        "--headless",
        "--actor",
        take[1],
        "--out",
        tmp_path / "r.npz",
        "--record",
        tmp_path / "rec",
    ]
    code = "from adaptiveface.cli import main; raise SystemExit(main())"
    process = subprocess.Popen(
        [sys.executable, "-c", code, *map(str, arguments)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    try:
        deadline = time.monotonic() + 120
        while len(list(tmp_path.glob("rec/depth/*.png"))) < 60 and time.monotonic() < deadline:
            assert process.poll() is None
            time.sleep(0.05)
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=120)
    finally:
        process.kill()
    assert process.returncode == 0 and "ended by Ctrl-C" in out and err == ""
    assert len(Result.load(tmp_path / "r.npz")) > 0 and len(Recording(tmp_path / "rec")) >= 60


def test_the_status_line_is_rewritten_in_a_terminal_and_rare_in_a_log(monkeypatch):
    class Terminal(StringIO):
        def isatty(self):
            return True

    clock = iter(range(100))
    monkeypatch.setattr(status, "time", SimpleNamespace(monotonic=lambda: next(clock)))  # threads of other tests keep theirs
    terminal, log = Terminal(), StringIO()
    for stream in (terminal, log):
        line = status.StatusLine(stream)
        for number in range(8):
            line.show(f"frame {number}")
        line.end("8 frames")
    assert log.getvalue() == "frame 0\nframe 5\n8 frames\n"
    assert terminal.getvalue().count("\n") == 1 and terminal.getvalue().endswith("\r8 frames\n")
    assert all(f"\rframe {number}" in terminal.getvalue() for number in range(8))
