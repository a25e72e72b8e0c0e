"""What is written where: never onto an input, never onto another kind of file, and the tables of a recording as they grow."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

from adaptiveface.cli import main
from adaptiveface.errors import AdaptiveFaceError
from adaptiveface.files import (
    GrowingTable,
    check_distinct,
    check_folder,
    check_new_folder,
    check_output,
    check_output_folder,
    replacing,
    replacing_folder,
)


def npz(path, *members):
    np.savez(path, **dict.fromkeys(members, np.zeros(1)))
    return path


def actor(path):
    return npz(path, "neutral", "blendshapes", "feature_triangles")


def result(path):
    return npz(path, "vertices", "coefficients", "stage_ms")


def refused(words, check, *arguments):
    with pytest.raises(AdaptiveFaceError, match=words) as caught:
        check(*arguments)
    assert str(arguments[0]) in str(caught.value) or check is check_distinct


def test_an_output_is_none_of_the_inputs_by_whatever_name(tmp_path, monkeypatch):
    given = actor(tmp_path / "a.npz")
    link, twin = tmp_path / "link.npz", tmp_path / "twin.npz"
    link.symlink_to(given)
    os.link(given, twin)
    (tmp_path / "sub").mkdir()
    monkeypatch.chdir(tmp_path / "sub")
    for name in (given, link, twin, tmp_path / "sub" / ".." / "a.npz", type(given)("../a.npz")):
        refused("is also read by this command", check_output, name, "actor", [None, given])
    refused("is also read", check_output, given, "actor", [f"azure:{given}"])
    refused("is also read", check_new_folder, tmp_path / "sub", [tmp_path / "sub" / "."])
    check_output(tmp_path / "b.npz", "actor", [given, "synthetic"])


def test_what_is_there_must_be_of_the_same_kind(tmp_path):
    check_output(actor(tmp_path / "a.npz"), "actor")
    refused("is not a result", check_output, tmp_path / "a.npz", "result")
    refused("is not an actor", check_output, result(tmp_path / "r.npz"), "actor")
    for kind, suffix, right in (
        ("mp4", ".mp4", b"\0\0\0\x20ftypisom"),
        ("gif", ".gif", b"GIF89a"),
        ("glb", ".glb", b"glTF\2\0\0\0"),
        ("usd", ".usda", b"#usda 1.0"),
        ("usd", ".usdc", b"PXR-USDC"),
        ("html", ".html", b"<!doctype html><p>"),
        ("arkit-csv", ".csv", b"Timecode,BlendShapeCount"),
        ("result", ".npz", b""),
    ):
        path = tmp_path / f"x{suffix}"
        path.write_bytes(right)
        check_output(path, kind)
        path.write_bytes(b"frame,timestamp\r\n0,0.0\r\n")
        refused("what is there is not", check_output, path, kind)
        path.unlink()
    if hasattr(os, "mkfifo"):
        os.mkfifo(tmp_path / "pipe.npz")
        refused("what is there is not", check_output, tmp_path / "pipe.npz", "result")


def test_folders_that_hold_something_else_are_left_alone(tmp_path):
    full, file = tmp_path / "full", tmp_path / "file"
    full.mkdir()
    (full / "diary.txt").write_text("mine")
    file.write_text("mine")
    refused("diary.txt", check_new_folder, full)
    refused("diary.txt", check_output_folder, full, lambda name: name.endswith(".obj"))
    for check, *more in ((check_new_folder,), (check_folder,), (check_output_folder, lambda name: True)):
        refused("is a file", check, file, *more)
        refused("not a folder", check, file / "below", *more)
    check_folder(full)
    (tmp_path / "empty" / "depth").mkdir(parents=True)  # what a recording that never began leaves
    check_new_folder(tmp_path / "empty")
    refused("two outputs", check_distinct, tmp_path / "x", tmp_path / "a" / ".." / "x")


def test_a_link_stays_a_link_and_permissions_stay(tmp_path):
    (tmp_path / "far").mkdir()
    target, link = tmp_path / "far" / "a.csv", tmp_path / "a.csv"
    target.write_text("old")
    target.chmod(0o640)
    link.symlink_to(target)
    with replacing(link) as temporary:
        temporary.write_text("new")
    assert link.is_symlink() and target.read_text() == "new" and target.stat().st_mode & 0o777 == 0o640


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() == 0, reason="root may write everything")
def test_a_write_protected_file_stays(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("old")
    path.chmod(0o444)
    with pytest.raises(AdaptiveFaceError, match="write-protected"), replacing(path) as temporary:
        temporary.write_text("new")


def ours(name):
    return name.endswith(".obj")


@pytest.mark.parametrize("error", [None, KeyboardInterrupt(), ValueError("no"), OSError(28, "full")])
def test_a_folder_is_replaced_whole_or_not_at_all(tmp_path, error):
    folder = tmp_path / "take"
    folder.mkdir()
    for name in ("0.obj", "1.obj"):
        (folder / name).write_text("old")
    if error is None:
        with replacing_folder(folder, ours) as new:
            (new / "0.obj").write_text("new")
        assert [path.name for path in folder.iterdir()] == ["0.obj"] and (folder / "0.obj").read_text() == "new"
    else:
        kind = AdaptiveFaceError if isinstance(error, OSError) else type(error)
        with pytest.raises(kind), replacing_folder(folder, ours) as new:
            (new / "0.obj").write_text("half")
            raise error
        assert {path.read_text() for path in folder.iterdir()} == {"old"} and len([*folder.iterdir()]) == 2
    assert [*tmp_path.iterdir()] == [folder]


def test_a_folder_that_a_kill_left_under_its_second_name_comes_back(tmp_path):
    previous = tmp_path / "take.previous"
    previous.mkdir()
    (previous / "0.obj").write_text("old")
    with pytest.raises(ValueError), replacing_folder(tmp_path / "take", ours):
        raise ValueError
    assert (tmp_path / "take" / "0.obj").read_text() == "old" and not previous.exists()
    (tmp_path / "take.part").mkdir()
    (tmp_path / "take.part" / "diary.txt").write_text("mine")
    with pytest.raises(AdaptiveFaceError, match="diary"), replacing_folder(tmp_path / "take", ours):
        pass
    assert (tmp_path / "take.part" / "diary.txt").exists()


def test_a_table_holds_whole_rows_at_any_moment(tmp_path, monkeypatch):
    table = GrowingTable(tmp_path / "t.csv", ("frame", "timestamp"))
    table.append([])
    table.append([(0, "0.5"), (1, "0.6")])
    whole = (tmp_path / "t.csv").read_bytes()
    assert whole == b"frame,timestamp\r\n0,0.5\r\n1,0.6\r\n"
    real, calls = os.write, []

    def short_then_full(descriptor, content):
        calls.append(len(content))
        if len(calls) == 1:
            return real(descriptor, bytes(content)[:3])
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "write", short_then_full)
    with pytest.raises(OSError):
        table.append([(2, "0.7")])
    monkeypatch.undo()
    assert (tmp_path / "t.csv").read_bytes() == whole
    table.append([(2, "0.7")])
    table.close()
    assert (tmp_path / "t.csv").read_bytes() == whole + b"2,0.7\r\n"


COMMANDS = {
    "capture onto a result": (("capture", "synthetic", "--out", "r.npz"), "is not an actor"),
    "track onto its actor": (("track", "synthetic", "--actor", "a.npz", "--out", "a.npz"), "also read"),
    "track onto its actor by a link": (("track", "synthetic", "--actor", "a.npz", "--out", "link.npz"), "also read"),
    "track onto an actor": (("track", "synthetic", "--out", "a.npz"), "is not a result"),
    "report onto a file": (("track", "synthetic", "--out", "n.npz", "--report", "r.npz"), "is a file"),
    "export onto its source": (("export", "r.npz", "--format", "mp4", "--source", "v.mp4", "--out", "v.mp4"), "also read"),
    "export onto its character": (("export", "r.npz", "--character", "c.glb", "--out", "c.glb"), "also read"),
    "export onto a table": (("export", "r.npz", "--format", "arkit-csv", "--out", "t.csv"), "not a table of ARKit"),
    "export into a full folder": (("export", "r.npz", "--format", "obj", "--out", "full"), "other files"),
    "batch onto a file": (("batch", "take", "--out", "a.npz"), "is a file"),
    "scores onto a table": (("evaluate", "r.npz", "a.npz", "--csv", "t.csv"), "not a table of scores"),
    "record into a full folder": (("record", "synthetic", "--out", "full"), "holds files already"),
    "convert into a full folder": (("convert", "v.mp4", "--out", "full"), "holds files already"),
    "demo onto a file": (("demo", "--out", "a.npz"), "is a file"),
    "live, one name for two": (("live", "synthetic", "--headless", "--out", "n.npz", "--save-actor", "n.npz"), "two outputs"),
    "learned onto its actor": (
        ("track", "synthetic", "--actor", "a.npz", "--out", "n.npz", "--personal-actor", "link.npz"),
        "also read",
    ),
    "live, the learned actor onto the captured": (
        ("live", "synthetic", "--headless", "--save-actor", "b.npz", "--personal-actor", "./b.npz"),
        "two outputs",
    ),
    "live onto its actor": (
        ("live", "synthetic", "--headless", "--actor", "a.npz", "--save-actor", "./a.npz"),
        "also read",
    ),
    "live into a full folder": (("live", "synthetic", "--headless", "--record", "full"), "holds files already"),
}


@pytest.mark.parametrize("name", COMMANDS)
def test_commands_refuse_before_any_work(name, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    actor(tmp_path / "a.npz")
    result(tmp_path / "r.npz")
    (tmp_path / "link.npz").symlink_to("a.npz")
    (tmp_path / "v.mp4").write_bytes(b"\0\0\0\x20ftypisom")
    (tmp_path / "c.glb").write_bytes(b"glTF\2\0\0\0")
    (tmp_path / "t.csv").write_text("frame,timestamp\n")
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "diary.txt").write_text("mine")
    before = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    command, words = COMMANDS[name]
    assert main([*command]) == 2
    err = capsys.readouterr().err
    assert words in err and err.count("\n") == 1
    assert before == {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}


@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
@pytest.mark.parametrize("number, status", [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_signal_is_an_orderly_end_of_a_command(tmp_path, number, status):
    code = (
        "import sys, pathlib, adaptiveface.pipeline as p; from adaptiveface.cli import main;"
        "work = p.capture_source; p.capture_source = lambda *a, **o: (pathlib.Path('started').touch(), work(*a, **o))[1];"
        "sys.argv[1:] = ['track', 'synthetic', '--out', 'r.npz']; sys.exit(main())"
    )
    command = [sys.executable, "-c", code]
    process = subprocess.Popen(command, cwd=tmp_path, stderr=subprocess.PIPE, text=True, preexec_fn=listening)
    while not (tmp_path / "started").exists():
        time.sleep(0.02)
    process.send_signal(number)
    _, err = process.communicate(timeout=120)
    assert process.returncode == status and "Traceback" not in err and err.count("\n") == 1
    assert not (tmp_path / "r.npz").exists()


def listening() -> None:
    signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
def test_ctrl_c_while_the_process_ends_says_nothing(tmp_path):
    code = (
        "import atexit, os, signal, sys; signal.signal(signal.SIGINT, signal.default_int_handler);"
        "atexit.register(lambda: os.kill(os.getpid(), signal.SIGINT));"
        "sys.argv[1:] = ['capture', 'nothing', '--out', 'x.txt'];"
        "from adaptiveface.cli import main; sys.exit(main())"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=tmp_path)
    assert run.returncode == 2 and "must end in" in run.stderr and run.stderr.count("\n") == 1


def test_a_full_disk_is_named_with_the_folder_not_with_the_file_in_it(tmp_path):
    with pytest.raises(AdaptiveFaceError, match=r"take: no space left on the disk; nothing was written$") as caught:
        with replacing_folder(tmp_path / "take", ours) as new, replacing(new / "0.obj"):
            raise OSError(28, "full")
    assert "part" not in str(caught.value) and [*tmp_path.iterdir()] == []
