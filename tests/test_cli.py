"""The command line on small recordings: what it writes, what it prints, how it ends."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys

import numpy as np
import pytest
from recordings import talking_head, true_mesh
from scenes import exact_actor

from adaptiveface import __version__, pipeline
from adaptiveface.cli import main
from adaptiveface.geometry.frame import FEATURE_IDS
from adaptiveface.model.actor import Actor
from adaptiveface.parameters import Parameters
from adaptiveface.result import Result
from adaptiveface.sensors import Recording

QUICK = ["fit.iterations=8", "shrink_wrap.iterations=3", "fusion.passes=1", "fusion.voxel=4"]


@pytest.fixture(scope="module")
def take(tmp_path_factory):
    """(recording folder, its exact actor.npz): 8 frames of a head that turns and opens its jaw."""
    folder = tmp_path_factory.mktemp("cli")
    talking_head(folder / "take").save(folder / "actor.npz")
    return folder / "take", folder / "actor.npz"


def run(capsys, *args) -> tuple[int, str, str]:
    """Exit status, stdout and stderr of the command line, run in this process."""
    try:
        status = main([str(arg) for arg in args])
    except SystemExit as stop:
        status = stop.code
    captured = capsys.readouterr()
    return status, captured.out, captured.err


def fails(capsys, *args) -> str:
    """The one line with which a command must refuse its input."""
    status, out, err = run(capsys, *args)
    assert (status, out) == (2, "")
    assert err.startswith("adaptiveface: error: ") and err.count("\n") == 1 and "Traceback" not in err
    return err


def test_track_with_an_actor(take, tmp_path, capsys):
    recording, actor = take
    status, out, err = run(capsys, "track", recording, "--actor", actor, "--out", tmp_path / "r.npz")
    assert (status, err) == (0, "") and "8 frames: 8 tracked" in out
    result = Result.load(tmp_path / "r.npz")
    assert result.tracked.all() and not result.skipped.any() and result.v1 is None
    np.testing.assert_allclose(result.timestamps, np.arange(8) / 30, atol=1e-5)
    np.testing.assert_array_equal(result.feature_ids, FEATURE_IDS)
    assert Parameters.from_json(result.parameters) == Parameters()
    jaw = result.coefficients[:, result.expression_names.index("jawOpen")]
    assert jaw[0] < 0.1 and jaw[-1] > 0.3
    for index in range(8):
        error = np.linalg.norm(result.vertices[index] - true_mesh(exact_actor(), index, 8), axis=1)
        assert error[result.frontal].mean() < 0.5  # mm; 0.25 at most when this was written


def test_what_was_learned_about_expressions_goes_into_the_next_performance(take, tmp_path, capsys):
    recording, actor = take
    personal, out = tmp_path / "personal.npz", tmp_path / "r.npz"
    often = ("--set", "personal_blendshapes.interval=3")
    status, text, err = run(capsys, "track", recording, "--actor", actor, "--out", out, "--personal-actor", personal, *often)
    assert (status, err) == (0, "") and f"{personal}: the rig with the expressions as learned" in text
    result, before, after = Result.load(out), Actor.load(actor), Actor.load(personal)
    np.testing.assert_allclose(after.blendshapes, result.rig(before).blendshapes, atol=1e-4)
    jaw = before.expression_names.index("jawOpen")
    assert np.abs(after.blendshapes[jaw] - before.blendshapes[jaw]).max() > 0.01
    np.testing.assert_array_equal(after.neutral, before.neutral)
    assert run(capsys, "track", recording, "--actor", personal, "--out", tmp_path / "next.npz")[0] == 0
    off = ("--set", "personal_blendshapes.on=false")
    status, text, _ = run(capsys, "track", recording, "--actor", actor, "--out", out, "--personal-actor", personal, *off)
    assert status == 0 and "as they were: nothing was learned about them" in text
    np.testing.assert_allclose(Actor.load(personal).blendshapes, before.blendshapes, atol=1e-4)


def test_track_keeps_stages_and_parameters_on_demand(take, tmp_path, capsys):
    recording, actor = take
    arguments = ["--keep-stages", "--set", "laplacian.w1=0.2", "adaptive_pca.K=3", "--set", "blendshapes.A=9"]
    status, *_ = run(capsys, "track", recording, "--actor", actor, "--out", tmp_path / "r.npz", *arguments)
    result = Result.load(tmp_path / "r.npz")
    assert status == 0 and result.v1.shape == result.v3.shape == result.vertices.shape
    assert result.coefficients.shape == (8, 9)
    parameters = Parameters.from_json(result.parameters)
    assert (parameters.laplacian.w1, parameters.adaptive_pca.K, parameters.blendshapes.A) == (0.2, 3, 9)


def test_the_same_input_gives_the_same_bytes(take, tmp_path, capsys):
    recording, actor = take
    for name in ("a.npz", "b.npz"):
        run(capsys, "track", recording, "--actor", actor, "--out", tmp_path / name)
    one, two = Result.load(tmp_path / "a.npz"), Result.load(tmp_path / "b.npz")
    for name in Result.__dataclass_fields__:
        if name != "stage_ms":
            np.testing.assert_array_equal(getattr(one, name), getattr(two, name), err_msg=name)


def test_capture_then_track_without_an_actor(take, tmp_path, capsys):
    recording, exact = take
    out = tmp_path / "actor.npz"
    status, printed, _ = run(capsys, "capture", recording, "--out", out, "--neutral-frames", 3, "--set", *QUICK)
    assert status == 0 and str(out) in printed
    actor, truth = Actor.load(out), Actor.load(exact)
    size = np.ptp(actor.neutral[actor.frontal], axis=0) / np.ptp(truth.neutral[truth.frontal], axis=0)
    assert np.abs(size - 1).max() < 0.1
    status, *_ = run(capsys, "track", recording, "--out", tmp_path / "r.npz", "--neutral-frames", 3, "--set", *QUICK)
    assert status == 0 and Result.load(tmp_path / "r.npz").tracked.all()


@pytest.mark.slow
def test_demo_leaves_actor_result_and_report(tmp_path, capsys):
    status, printed, err = run(capsys, "demo", "--out", tmp_path / "demo", "--seed", 2, "--frames", 6, "--set", *QUICK)
    assert (status, err) == (0, "") and "52 frames: 52 tracked" in printed and "repeat       v4" in printed
    report = tmp_path / "demo" / "report.html"
    assert str(report) in printed and report.stat().st_size > 50_000
    assert len(Result.load(tmp_path / "demo" / "result.npz")) == 52 and Actor.load(tmp_path / "demo" / "actor.npz")


def test_track_writes_a_report_on_demand(take, tmp_path, capsys):
    arguments = ["--out", tmp_path / "r.npz", "--report", tmp_path / "report"]
    status, printed, _ = run(capsys, "track", take[0], "--actor", take[1], *arguments)
    assert status == 0 and str(tmp_path / "report" / "report.html") in printed
    assert (tmp_path / "report" / "report.html").stat().st_size > 50_000


def test_broken_frames_are_skipped_and_counted(take, tmp_path, capsys):
    recording = tmp_path / "damaged"
    shutil.copytree(take[0], recording)
    (recording / "depth" / "00002.png").unlink()
    (recording / "depth" / "00005.png").write_bytes(b"rubbish")
    status, out, err = run(capsys, "track", recording, "--actor", take[1], "--out", tmp_path / "r.npz")
    result = Result.load(tmp_path / "r.npz")
    assert (status, err) == (0, "") and "6 tracked, 0 without a face, 2 broken and skipped" in out
    assert np.flatnonzero(result.skipped).tolist() == [2, 5] and (result.tracked != result.skipped).all()
    assert "00002.png: missing" in result.reasons[2] and "00005.png" in result.reasons[5]
    np.testing.assert_array_equal(result.vertices[2], result.vertices[1])
    np.testing.assert_allclose(result.timestamps, np.arange(8) / 30, atol=1e-5)


def test_the_neutral_is_taken_from_frames_with_a_face(take, monkeypatch):
    """Broken frames and frames without features do not count among the leading neutral frames."""

    class Source(Recording):
        def read(self, index):
            frame = super().read(index)
            if index in (0, 2):
                object.__setattr__(frame, "features", None)
            return frame

    given = []
    monkeypatch.setattr(
        "adaptiveface.pipeline.capture.capture_actor", lambda frames, *_: given.extend(frame.index for frame in frames)
    )
    pipeline.capture_source(Source(take[0]), neutral_frames=3)
    assert given == [1, 3, 4]


def test_a_long_scan_is_sampled_evenly(take, monkeypatch):
    given = []
    monkeypatch.setattr(
        "adaptiveface.pipeline.capture.capture_actor", lambda frames, *_: given.extend(frame.index for frame in frames)
    )
    monkeypatch.setattr("adaptiveface.pipeline.capture.MAX_NEUTRAL_FRAMES", 3)
    pipeline.capture_source(Recording(take[0]))
    assert given == [0, 3, 6]


def test_ctrl_c_keeps_what_was_done(take, tmp_path, capsys, monkeypatch):
    def read(self, index, original=Recording.read):
        if index == 4:
            signal.raise_signal(signal.SIGINT)
        return original(self, index)

    monkeypatch.setattr(Recording, "read", read)
    out = tmp_path / "r.npz"
    status, printed, err = run(capsys, "track", take[0], "--actor", take[1], "--out", out)
    assert (status, err) == (130, "adaptiveface: interrupted\n") and "r.partial.npz: 4 frames" in printed
    partial = Result.load(tmp_path / "r.partial.npz")
    assert len(partial) == 4 and partial.tracked.all() and not out.exists()


def test_the_frame_loop_caps_blas_to_one_thread(take):
    from threadpoolctl import threadpool_info

    threads = []

    def look(tracked, frame):
        threads.extend(pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas")

    pipeline.track_source(Recording(take[0]), Actor.load(take[1]), on_frame=look)
    assert threads and set(threads) == {1}


BAD_COMMANDS = {
    "no command": ([], "required: COMMAND"),
    "unknown command": (["dance"], "invalid choice: 'dance'"),
    "unknown option": (["demo", "--fast"], "--fast"),
    "no output": (["track", "{take}"], "--out"),
    "no source": (["track", "nowhere", "--out", "{tmp}/r.npz"], "possible sources"),
    "bad seed": (["track", "synthetic:one", "--out", "{tmp}/r.npz"], "seed 'one'"),
    "unknown noise": (["capture", "synthetic:1:loud", "--out", "{tmp}/a.npz"], "'loud'"),
    "output folder missing": (["track", "{take}", "--out", "{take}/intrinsic.json/r.npz"], "cannot be made"),
    "output is a folder": (["track", "{take}", "--out", "{tmp}/folder.npz"], "is a folder"),
    "output is no npz": (["capture", "{take}", "--out", "{tmp}/actor.zip"], "must end in .npz"),
    "unknown stage": (["track", "{take}", "--out", "{tmp}/r.npz", "--set", "magic.w=1"], "unknown stage 'magic'"),
    "unknown parameter": (["track", "{take}", "--out", "{tmp}/r.npz", "--set", "laplacian.w7=1"], "laplacian.w7"),
    "out of range": (["track", "{take}", "--out", "{tmp}/r.npz", "--set", "laplacian.w1=-1"], "outside its range"),
    "not a number": (["track", "{take}", "--out", "{tmp}/r.npz", "--set", "laplacian.w1=much"], "number is expected"),
    "NaN": (["track", "{take}", "--out", "{tmp}/r.npz", "--set", "laplacian.w1=nan"], "finite number"),
    "half a shape": (["track", "{take}", "--out", "{tmp}/r.npz", "--set", "adaptive_pca.K=2.5"], "whole number"),
    "no value": (["track", "{take}", "--out", "{tmp}/r.npz", "--set", "laplacian.w1"], "stage.name=value"),
    "no actor file": (["track", "{take}", "--out", "{tmp}/r.npz", "--actor", "{tmp}/none.npz"], "none.npz: no such"),
    "text as actor": (
        ["track", "{take}", "--out", "{tmp}/r.npz", "--actor", "{take}/intrinsic.json"],
        "intrinsic.json",
    ),
    "zero neutral frames": (["capture", "{take}", "--out", "{tmp}/a.npz", "--neutral-frames", "0"], "'0'"),
    "negative frames": (["demo", "--frames", "-5"], "'-5'"),
    "endless frames": (["demo", "--frames", "9" * 5000], "whole number"),
    "demo noise": (["demo", "--noise", "loud", "--out", "{tmp}/demo"], "'loud'"),
}


@pytest.mark.parametrize("name", BAD_COMMANDS)
def test_bad_command_lines_end_with_one_line(take, tmp_path, capsys, name):
    arguments, reason = BAD_COMMANDS[name]
    (tmp_path / "folder.npz").mkdir()
    filled = [argument.format(take=take[0], tmp=tmp_path) for argument in arguments]
    assert reason in fails(capsys, *filled)
    assert not (tmp_path / "r.npz").exists() and not (tmp_path / "demo").exists()


def test_a_missing_system_library_is_explained(take, tmp_path, capsys, monkeypatch):
    def broken(*_, **__):
        raise ImportError("libGL.so.1: cannot open shared object file: No such file or directory")

    monkeypatch.setattr("adaptiveface.pipeline.track.track_source", broken)
    line = fails(capsys, "track", take[0], "--actor", take[1], "--out", tmp_path / "r.npz")
    assert "libGL.so.1" in line and "apt install" in line


def test_version_and_module(tmp_path):
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    command = [sys.executable, "-m", "adaptiveface"]
    done = subprocess.run([*command, "--version"], capture_output=True, text=True, env=environment, cwd=tmp_path)
    assert (done.returncode, done.stdout.strip()) == (0, f"adaptiveface {__version__}")
    bad = subprocess.run([*command, "track", "x"], capture_output=True, text=True, env=environment, cwd=tmp_path)
    assert bad.returncode == 2 and bad.stderr.count("\n") == 1
