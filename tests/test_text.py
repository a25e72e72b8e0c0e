"""Text: any output encoding, closed pipes, byte-order marks, and the files that macOS puts beside others."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys

import numpy as np
import pytest
from export_scene import tracked_result
from recordings import talking_head
from written import write_obj_shapes

from adaptiveface.cli import main
from adaptiveface.files import decoded, read_text
from adaptiveface.formats.obj import read_obj, read_obj_vertices
from adaptiveface.importers.assemble import read_feature_vertices
from adaptiveface.lab import copy_notebooks, lab_command
from adaptiveface.result import Result
from adaptiveface.retargeting.obj_folder import load_obj_folder
from adaptiveface.sensors import Recording

JAPANESE = "\u30c6\u30b9\u30c8-caf\u00e9"
MARKS = {"utf-8": b"\xef\xbb\xbf", "utf-16-le": b"\xff\xfe", "utf-16-be": b"\xfe\xff"}


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    """A folder with a Japanese name that holds result.npz."""
    folder = tmp_path_factory.mktemp("text") / JAPANESE
    folder.mkdir()
    tracked_result(frames=3)[1].save(folder / "result.npz")
    return folder


def command(*words, **environment) -> subprocess.CompletedProcess:
    values = {k: v for k, v in os.environ.items() if not k.startswith(("LC_", "LANG", "PYTHONIO", "PYTHONUTF8"))}
    return subprocess.run(
        [sys.executable, "-m", "adaptiveface", *map(str, words)], capture_output=True, env=values | environment
    )


ENCODINGS = [
    {"PYTHONIOENCODING": "cp1252"},
    {"PYTHONIOENCODING": "ascii"},
    {"PYTHONIOENCODING": "ascii:strict"},
    {"PYTHONIOENCODING": "cp932"},
    {"LC_ALL": "C", "PYTHONCOERCECLOCALE": "0", "PYTHONUTF8": "0"},
]


@pytest.mark.parametrize("environment", ENCODINGS, ids=lambda e: next(iter(e.items()))[1])
def test_no_message_ends_a_job(saved, tmp_path, environment):
    out = tmp_path / f"{JAPANESE}.csv"
    done = command("export", saved / "result.npz", "--format", "arkit-csv", "--out", out, **environment)
    assert (done.returncode, done.stderr) == (0, b"") and out.stat().st_size > 1000
    assert b"3 frames" in done.stdout
    failed = command("export", saved / "none\u30c6.npz", **environment)
    assert failed.returncode == 2 and failed.stderr.count(b"\n") == 1 and b"Traceback" not in failed.stderr


@pytest.mark.skipif(os.name != "posix", reason="names that are not text")
def test_a_name_that_is_no_text_is_printed(saved, tmp_path):
    out = os.fsencode(tmp_path) + b"/caf\xe9.csv"
    words = [sys.executable, "-m", "adaptiveface", "export", saved / "result.npz", "--format", "arkit-csv", "--out", out]
    done = subprocess.run(words, capture_output=True)
    assert (done.returncode, done.stderr) == (0, b"") and os.path.exists(out)


@pytest.mark.skipif(os.name != "posix" or shutil.which("bash") is None, reason="pipes of a shell")
@pytest.mark.parametrize("words", ["--help", "--version", "export --help", "export {} --format arkit-csv --out {}.csv"])
def test_a_closed_pipe_ends_quietly(saved, words):
    words = words.format(saved / "result.npz", saved / "x")
    line = f"{sys.executable} -m adaptiveface {words} | true; exit ${{PIPESTATUS[0]}}"
    done = subprocess.run(["bash", "-c", line], capture_output=True)
    assert done.stderr == b""


# ---- byte-order marks -------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("encoding", MARKS)
def test_text_with_a_mark(tmp_path, encoding):
    (tmp_path / "a.txt").write_bytes(MARKS[encoding] + "frame,\u00e9".encode(encoding))
    assert read_text(tmp_path / "a.txt", 100) == decoded((tmp_path / "a.txt").read_bytes()) == "frame,\u00e9"
    (tmp_path / "n.txt").write_bytes(MARKS[encoding] + " ".join(map(str, range(40))).encode(encoding))
    assert read_feature_vertices(tmp_path / "n.txt", 50).tolist() == list(range(40))


@pytest.mark.parametrize("encoding", MARKS)
def test_an_obj_folder_as_other_systems_leave_it(tmp_path, encoding):
    actor, result, _ = tracked_result(frames=2)
    from adaptiveface.export.animation import actor_animation

    write_obj_shapes(tmp_path / "face", actor_animation(result, actor))
    plain = load_obj_folder(tmp_path / "face")
    for path in list((tmp_path / "face").iterdir()):
        text = "\n".join(line for line in path.read_text().splitlines() if line.startswith(("v ", "f ")))
        path.write_bytes(MARKS[encoding] + text.encode(encoding))  # the first line is a vertex
        path.with_name(f"._{path.name}").write_bytes(b"\0\5\x16\7\0\2\0\0Mac OS X" + bytes(90))
    (tmp_path / "face" / ".DS_Store").write_bytes(bytes(10))
    again = load_obj_folder(tmp_path / "face")
    assert again.expression_names == plain.expression_names
    np.testing.assert_allclose(again.neutral, plain.neutral, atol=1e-4)
    path = tmp_path / "face" / "neutral.obj"
    assert len(read_obj(path)[0]) == len(read_obj_vertices(path)) == len(actor.neutral)


@pytest.mark.parametrize("encoding", MARKS)
def test_a_recording_with_marks_in_every_table(tmp_path, encoding):
    talking_head(tmp_path / "take", 2)
    plain = Recording(tmp_path / "take")
    for name in ("features.csv", "timestamps.csv", "intrinsic.json"):
        path = tmp_path / "take" / name
        path.write_bytes(MARKS[encoding] + path.read_text().encode(encoding))
    (tmp_path / "take" / "depth" / "._00000.png").write_bytes(b"\0\5\x16\7")
    again = Recording(tmp_path / "take")
    assert len(again) == 2 and again.camera == plain.camera
    np.testing.assert_array_equal(again.read(1).features.pixels, plain.read(1).features.pixels)


@pytest.mark.parametrize("encoding", MARKS)
def test_curves_with_a_mark(saved, tmp_path, encoding):
    from adaptiveface.export.arkit_csv import read_arkit_csv

    assert main(["export", str(saved / "result.npz"), "--format", "arkit-csv", "--out", str(tmp_path / "a.csv")]) == 0
    plain = read_arkit_csv(tmp_path / "a.csv")
    (tmp_path / "a.csv").write_bytes(MARKS[encoding] + (tmp_path / "a.csv").read_text().encode(encoding))
    np.testing.assert_array_equal(read_arkit_csv(tmp_path / "a.csv").curves, plain.curves)


def test_the_lab_passes_over_files_of_macos(tmp_path):
    (tmp_path / "from").mkdir()
    (tmp_path / "from" / "00.ipynb").write_text(json.dumps({}))
    (tmp_path / "from" / "._00.ipynb").write_bytes(b"\0\5\x16\7")
    assert copy_notebooks(tmp_path / "to", tmp_path / "from").new == ("00.ipynb",)
    (tmp_path / "to" / "._00.ipynb").write_bytes(b"\0\5\x16\7")
    assert "--LabApp.default_url=/lab/tree/00.ipynb" in lab_command(tmp_path / "to")


def test_results_in_a_folder_of_any_name(saved):
    assert len(Result.load(saved / "result.npz")) == 3
