"""Writers that signals end at random moments: the old file or the whole new one; the long trial is fault_runs.py --kill."""

from __future__ import annotations

import os

import pytest

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="signals and processes of POSIX")


def test_a_writer_that_is_ended_leaves_the_old_file_or_the_new_one(capsys):
    import fault_writers

    assert fault_writers.table(("INT", "TERM", "KILL"), 2, ["x.glb", "x.gif", "obj", "result.npz"]) == 0
    assert capsys.readouterr().out.count("old") == 12


def test_a_recording_that_is_ended_has_its_features_up_to_the_last_frame():
    import fault_writers

    assert fault_writers.recordings(("INT", "TERM", "KILL"), 3) == 0
