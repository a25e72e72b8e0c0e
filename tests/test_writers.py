"""Writers that signals end at random moments: the old file or the whole new one; the long trial is fault_runs.py --kill."""

from __future__ import annotations

import os
import signal
from contextlib import nullcontext
from pathlib import Path

import pytest

from adaptiveface.files.atomic import replacing_folder

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="signals and processes of POSIX")


def test_a_writer_that_is_ended_leaves_the_old_file_or_the_new_one(capsys):
    import fault_writers

    assert fault_writers.table(("INT", "TERM", "KILL"), 2, ["x.glb", "x.gif", "obj", "result.npz"]) == 0
    assert capsys.readouterr().out.count("old") == 12


def test_a_recording_that_is_ended_has_its_features_up_to_the_last_frame():
    import fault_writers

    assert fault_writers.recordings(("INT", "TERM", "KILL"), 3) == 0


def test_ctrl_c_while_a_folder_is_replaced_leaves_the_new_folder_alone(tmp_path, monkeypatch):
    """It comes while the old folder is removed: seen once as a left ``NAME.previous``."""
    target, unlink = tmp_path / "obj", Path.unlink
    for text in ("old", "new"):
        if text == "new":
            monkeypatch.setattr(Path, "unlink", lambda path, **k: (signal.raise_signal(signal.SIGINT), unlink(path, **k))[1])
        with pytest.raises(KeyboardInterrupt) if text == "new" else nullcontext():
            with replacing_folder(target, lambda name: name.endswith(".obj")) as folder:
                (folder / "0.obj").write_text(text)
    assert [p.name for p in tmp_path.iterdir()] == ["obj"] and (target / "0.obj").read_text() == "new"
