"""Takes of any length: rows go to the disk as they come, results stay there, and memory does not grow with them."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import zipfile

import numpy as np
import pytest
from export_scene import tracked_result
from recordings import talking_head
from test_result import actor, build, tracked_frame  # noqa: F401  (actor is a fixture)

from adaptiveface.cli import main
from adaptiveface.errors import AdaptiveFaceError, FileFormatError, FrameError, TrackingError
from adaptiveface.export import components
from adaptiveface.export.animation import actor_animation
from adaptiveface.files import blocks, map_member, npz
from adaptiveface.parameters import Parameters
from adaptiveface.pipeline import track_to_file
from adaptiveface.result import Result, ResultBuilder
from adaptiveface.result.rows import ROWS, discard, unfinished_folder
from adaptiveface.sensors import Recording


@pytest.fixture
def mapped(monkeypatch):
    """Every mesh of a result stays on the disk, however small it is."""
    monkeypatch.setattr(npz, "MAPPED_FROM", 0)


def filled(actor, folder, pattern):  # noqa: F811
    builder = ResultBuilder(actor, Parameters(), 1, True, folder=folder)
    for k, letter in enumerate(pattern):
        builder.skip(k / 30, "broken") if letter == "s" else builder.add(tracked_frame(actor, k, letter == "t"))
    return builder


@pytest.mark.parametrize("pattern", ["t", "ut", "uttusstu", "us", ""])
def test_rows_in_files_give_the_result_of_rows_in_memory(actor, tmp_path, pattern):  # noqa: F811
    builder = filled(actor, tmp_path / "r.unfinished", pattern)
    result, expected = builder.finish(), build(actor, pattern, keep_stages=True)[0]
    for name in set(Result.__dataclass_fields__) - {"reasons"}:  # their words differ in this test
        np.testing.assert_array_equal(getattr(result, name), getattr(expected, name), err_msg=name)
    result.save(tmp_path / "r.npz")
    loaded = Result.load(tmp_path / "r.npz") if pattern else None
    assert loaded is None or np.array_equal(loaded.vertices, expected.vertices)


def test_a_run_that_was_killed_is_read_from_its_rows(actor, tmp_path):  # noqa: F811
    folder = tmp_path / "r.unfinished"
    filled(actor, folder, "uttu")
    with open(folder / ROWS, "ab") as stream:
        stream.write(b"\0" * 1000)  # the row at which it was killed
    result, expected = Result.load(folder), build(actor, "uttu", keep_stages=True)[0]
    for name in Result.__dataclass_fields__:
        np.testing.assert_array_equal(getattr(result, name), getattr(expected, name), err_msg=name)
    result.save(tmp_path / "r.npz")
    discard(folder)
    assert not folder.exists() and len(Result.load(tmp_path / "r.npz")) == 4


def test_damaged_rows_are_refused(actor, tmp_path):  # noqa: F811
    folder = tmp_path / "r.unfinished"
    builder = filled(actor, folder, "tt")
    content = np.fromfile(folder / ROWS, builder._type)
    content["vertices"][1, 3] = np.nan
    content.tofile(folder / ROWS)
    with pytest.raises(FileFormatError, match="'vertices' holds NaN"):
        Result.load(folder)
    (folder / ROWS).write_bytes(b"")
    with pytest.raises(FileFormatError, match="no frame"):
        Result.load(folder)
    (folder / ROWS).unlink()
    with pytest.raises(FileFormatError, match="rows.bin: cannot be read"):
        Result.load(folder)


def test_a_full_disk_names_the_rows_that_are_kept(actor, tmp_path):  # noqa: F811
    builder = filled(actor, tmp_path / "r.unfinished", "tt")
    builder._rows._stream.close()
    builder._rows._stream = open("/dev/full", "wb", buffering=0)
    with pytest.raises(AdaptiveFaceError, match=r"rows.bin: no space left on the disk; the 2 frames before are kept"):
        builder.add(tracked_frame(actor, 2))


def test_meshes_stay_on_the_disk(actor, tmp_path, mapped):  # noqa: F811
    build(actor, "ttut", keep_stages=True)[0].save(tmp_path / "r.npz")
    result = Result.load(tmp_path / "r.npz")
    assert isinstance(result.vertices, np.memmap) and isinstance(result.v3, np.memmap)
    assert not isinstance(result.coefficients, np.memmap)
    with np.load(tmp_path / "r.npz") as plain:
        np.testing.assert_array_equal(result.vertices, plain["vertices"])
    parts = list(blocks(result.vertices, 3))
    assert [(part.start, part.stop) for part, _ in parts] == [(0, 3), (3, 4)]
    np.testing.assert_array_equal(np.concatenate([block for _, block in parts]), result.vertices)
    result.save(tmp_path / "again.npz")
    assert (tmp_path / "again.npz").read_bytes() == (tmp_path / "r.npz").read_bytes()


@pytest.mark.parametrize("kind", ["bit", "nan", "short", "promise", "moved"])
def test_what_stays_on_the_disk_is_checked(actor, tmp_path, mapped, kind):  # noqa: F811
    path = tmp_path / "r.npz"
    result = build(actor, "tttt")[0]
    if kind == "nan":
        result.vertices[2, 5, 1] = np.nan
    result.save(path)
    content = bytearray(path.read_bytes())
    with zipfile.ZipFile(path) as archive:
        offset = archive.getinfo("vertices.npy").header_offset
    if kind == "bit":
        content[offset + 600] ^= 1
    elif kind == "short":
        del content[offset + 500 : offset + 900]
    elif kind == "promise":
        at = content.index(b"(4, 30, 3)")
        content[at : at + 10] = b"(9, 30, 3)"
    elif kind == "moved":
        content[offset : offset + 4] = b"zero"
    path.write_bytes(content)
    with pytest.raises(FileFormatError, match="r.npz: "):
        Result.load(path)


def test_compressed_results_are_read_into_memory(actor, tmp_path, mapped):  # noqa: F811
    build(actor, "tt")[0].save(tmp_path / "r.npz")
    with np.load(tmp_path / "r.npz") as data:
        np.savez_compressed(tmp_path / "c.npz", **data)
    with zipfile.ZipFile(tmp_path / "c.npz") as archive:
        assert map_member(tmp_path / "c.npz", archive.getinfo("vertices.npy")) is None
    np.testing.assert_array_equal(Result.load(tmp_path / "c.npz").vertices, Result.load(tmp_path / "r.npz").vertices)


KILLED = """
import os, signal, sys
from adaptiveface.cli import main
from adaptiveface.result import ResultBuilder
add = ResultBuilder.add
def killed(self, frame):
    if self.done == 5:
        os.kill(os.getpid(), signal.SIGKILL)
    add(self, frame)
ResultBuilder.add = killed
main(sys.argv[1:])
"""


@pytest.mark.skipif(os.name != "posix", reason="SIGKILL")
def test_a_killed_track_leaves_its_frames_and_an_old_result(tmp_path, capsys):
    talking_head(tmp_path / "take").save(tmp_path / "actor.npz")
    out = tmp_path / "r.npz"
    words = ["track", tmp_path / "take", "--actor", tmp_path / "actor.npz", "--out", out]
    assert main([str(word) for word in words]) == 0
    older = out.read_bytes()
    run = subprocess.run([sys.executable, "-c", KILLED, *map(str, words)], capture_output=True)
    assert run.returncode == -signal.SIGKILL and out.read_bytes() == older
    left = unfinished_folder(out)
    assert left.name == "r.unfinished" and len(Result.load(left)) == 5
    assert main(["export", str(left), "--format", "arkit-csv", "--out", str(tmp_path / "r.csv")]) == 0
    assert "5 frames" in capsys.readouterr().out
    assert main([str(word) for word in words]) == 0  # again, to its end
    assert len(Result.load(out)) == 8 and not left.exists()
    kept = tmp_path / "r.unfinished-1"
    assert len(Result.load(kept)) == 5 and f"kept as {kept.name}" in capsys.readouterr().err


@pytest.mark.skipif(os.name != "posix", reason="SIGKILL")
def test_a_killed_live_run_leaves_its_frames(tmp_path):
    talking_head(tmp_path / "take").save(tmp_path / "actor.npz")
    out = tmp_path / "r.npz"
    words = ["live", tmp_path / "take", "--headless", "--actor", tmp_path / "actor.npz", "--out", out]
    run = subprocess.run([sys.executable, "-c", KILLED, *map(str, words)], capture_output=True)
    assert run.returncode == -signal.SIGKILL and not out.exists()
    assert len(Result.load(unfinished_folder(out))) == 5
    assert main([str(word) for word in words]) == 0
    assert len(Result.load(out)) == 8 and not unfinished_folder(out).exists()


def test_nothing_is_left_where_no_frame_can_be_used(tmp_path, monkeypatch):
    rig, source = talking_head(tmp_path / "take"), Recording(tmp_path / "take")

    def broken(index):
        raise FrameError(f"frame {index} is gone")

    monkeypatch.setattr(source, "read", broken)
    with pytest.raises(TrackingError, match="no frame can be used"):
        track_to_file(source, rig, tmp_path / "r.npz")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["take"]


GROWTH = """
import resource, sys, numpy as np
from pathlib import Path
from adaptiveface.model.face_model import embedded_face_model
from adaptiveface.result import Result
from adaptiveface.result.rows import FileRows
from adaptiveface.result import result as module
frames, folder = int(sys.argv[1]), Path(sys.argv[2])
n = 7000
head = dict(triangles=np.zeros((1, 3), np.int32), frontal=np.ones(n, bool), expression_names=np.array(["a"] * 23),
            feature_vertices=np.zeros(40, np.int32), feature_ids=np.zeros(40, np.int32), stage_names=np.array(["x"]),
            parameters=np.array("{}"), colour_only=np.array(False), neutral=np.zeros((n, 3), np.float32),
            stages=np.array(False))
kind = module._row_type(head)
rows, row = FileRows(kind, folder / "r.unfinished", head), np.zeros((), kind)
row["tracked"] = True
for k in range(frames):
    row["vertices"] = k
    rows.append(row)
rows.close()
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
module._of_rows(rows.all(), head).save(folder / "r.npz")
result = Result.load(folder / "r.npz")
assert len(result) == frames and result.vertices[frames - 1, 5, 1] == frames - 1
print((resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) // 1024)
"""


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="peak memory as Linux counts it")
def test_saving_and_loading_take_no_memory_for_long_takes(tmp_path):
    """9,000 frames are 720 MiB on the disk; saving and loading them adds less than 150 MiB to the process."""
    run = subprocess.run([sys.executable, "-c", GROWTH, "9000", tmp_path], capture_output=True, text=True, check=True)
    assert int(run.stdout) < 150


def test_long_takes_are_exported_within_the_tolerance(monkeypatch):
    """A sixth of the frames is decomposed, the others are looked at in blocks: what they need besides is added."""
    rig, result, v4 = tracked_result(frames=48)
    exact = actor_animation(result, rig, tolerance=0.05)
    monkeypatch.setattr(components, "SAMPLE", 8)
    seen = []
    whole = Result.head_meshes
    monkeypatch.setattr(Result, "head_meshes", lambda r, frames: seen.append(len(frames)) or whole(r, frames))
    mesh = actor_animation(result, rig, tolerance=0.05)
    assert np.linalg.norm([mesh.shape(f) - v4[f] for f in range(48)], axis=2).max() < 0.051
    assert len(mesh.targets) <= len(exact.targets) + 8
    bare = actor_animation(result, tolerance=0.05)
    assert np.linalg.norm([bare.shape(f) - v4[f] for f in range(48)], axis=2).max() < 0.051
    assert np.abs(mesh.weights[:, 23:]).max() <= 1 + 1e-6 and max(seen) <= 48


def test_the_fewest_components_are_taken():
    rng = np.random.default_rng(0)
    shapes = rng.normal(size=(5, 40, 3))
    amounts = rng.normal(size=(30, 5)) * [100, 30, 10, 3, 0.001]
    meshes = np.tensordot(amounts, shapes, axes=1)
    targets, weights = components.principal_targets(meshes.__getitem__, 30, 0.1)
    assert len(targets) == 4 and np.abs(weights).max() == 1
    error = np.linalg.norm(np.tensordot(weights, targets, axes=1) - meshes, axis=2).max()
    assert error <= 0.1
    assert len(components.principal_targets(np.zeros((3, 40, 3)).__getitem__, 3, 0.1)[0]) == 0


EXPORT = """
import resource, sys
import numpy as np
from export_scene import tracked_result
from adaptiveface.export.animation import actor_animation
from adaptiveface.result import Result
import dataclasses
actor, result, _ = tracked_result()
index = np.arange(int(sys.argv[1])) % len(result)
many = {entry.name: getattr(result, entry.name)[index] for entry in dataclasses.fields(Result)
        if np.ndim(getattr(result, entry.name)) and len(getattr(result, entry.name)) == len(result)
        and isinstance(getattr(result, entry.name), np.ndarray)}
dataclasses.replace(result, reasons=("",) * len(index), **many).save(sys.argv[2])
del many
result = Result.load(sys.argv[2])
actor_animation(dataclasses.replace(result, vertices=result.vertices[:600], head_pose=result.head_pose[:600],
                coefficients=result.coefficients[:600], timestamps=np.arange(600) / 30), actor)
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
print(len(actor_animation(result, actor)), (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) // 1024)
"""


@pytest.mark.slow
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="peak memory as Linux counts it")
def test_export_takes_no_memory_for_long_takes(tmp_path):
    """2,400 frames are 190 MiB of vertices; four times the frames of the first export must not take 100 MiB more."""
    here = os.pathsep.join([os.path.dirname(__file__), *filter(None, [os.environ.get("PYTHONPATH")])])
    run = subprocess.run(
        [sys.executable, "-c", EXPORT, "2400", str(tmp_path / "r.npz")],
        capture_output=True,
        text=True,
        check=True,
        env=os.environ | {"PYTHONPATH": here},
    )
    frames, more = map(int, run.stdout.split())
    assert frames == 2400 and more < 100
