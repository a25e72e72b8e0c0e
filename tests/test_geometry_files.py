"""OBJ sequences and point caches: units, normals, sizes, times, and what Blender makes of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from blender_runs import evaluate, needs_blender
from export_scene import animated_meshes, tracked_result
from written import read_obj_sequence, read_point_cache

from adaptiveface import cli
from adaptiveface.errors import AdaptiveFaceError, FileFormatError
from adaptiveface.export.obj_sequence import sequence_bytes, write_obj_sequence
from adaptiveface.export.point_cache import cache_bytes, write_point_cache
from adaptiveface.formats import UNITS
from adaptiveface.formats.obj import obj_text

FRAMES = (0, 7, 15, 23)
NEAR = 0.05  # mm


@pytest.fixture(scope="module")
def meshes():
    return animated_meshes()


def centred(mesh, frame: int) -> np.ndarray:
    return mesh.shape(frame, posed=True) - mesh.centre


@pytest.mark.parametrize("unit", tuple(UNITS))
def test_sequence_comes_back_in_millimetres_from_any_unit(meshes, tmp_path, unit):
    mesh = meshes["hag"]
    short = replace(mesh, weights=mesh.weights[:3], timestamps=mesh.timestamps[:3], head_pose=mesh.head_pose[:3])
    write_obj_sequence(tmp_path / "frames", short, unit)
    assert sorted(p.name for p in (tmp_path / "frames").iterdir()) == [
        "face_00000.obj",
        "face_00001.obj",
        "face_00002.obj",
        "timestamps.csv",
    ]
    vertices, triangles = read_obj_sequence(tmp_path / "frames")
    np.testing.assert_allclose(vertices, [centred(short, f) for f in range(3)], atol=2e-4)
    assert np.array_equal(triangles, mesh.triangles)
    size = sum(p.stat().st_size for p in (tmp_path / "frames").glob("*.obj"))
    assert sequence_bytes(short, unit) == pytest.approx(size, rel=0.02)
    first = (tmp_path / "frames" / "face_00000.obj").read_text().splitlines()
    extent = np.ptp([[float(x) for x in line.split()[1:4]] for line in first if line.startswith("v ")], axis=0)
    np.testing.assert_allclose(extent * UNITS[unit], np.ptp(centred(short, 0), axis=0), atol=1e-3)


def test_folders_of_earlier_versions_are_read(meshes, tmp_path):
    mesh = meshes["hag"]
    for k in range(2):
        lines = obj_text(centred(mesh, k), mesh.triangles).splitlines()
        (tmp_path / f"{k:05d}.obj").write_text("\n".join(line.replace("//", "/") for line in lines[2:] if line[:2] != "vn"))
    vertices, _ = read_obj_sequence(tmp_path)
    np.testing.assert_allclose(vertices[1], centred(mesh, 1), atol=1e-3)


def test_normals_are_smooth(meshes):
    mesh = meshes["hag"]
    lines = obj_text(mesh.neutral, mesh.triangles, mesh.colours).splitlines()
    normals = np.array([line.split()[1:] for line in lines if line.startswith("vn ")], float)
    assert normals.shape == mesh.neutral.shape and np.allclose(np.linalg.norm(normals, axis=1), 1, atol=5e-3)
    assert "s 1" in lines and next(line for line in lines if line[0] == "f").count("//") == 3


@pytest.mark.parametrize("suffix", [".mdd", ".pc2"])
@pytest.mark.parametrize("unit", ["m", "mm"])
def test_caches_come_back(meshes, tmp_path, suffix, unit):
    mesh = meshes["actor"]
    path = tmp_path / f"a{suffix}"
    write_point_cache(path, mesh, unit)
    again = read_point_cache(path) * UNITS[unit]
    np.testing.assert_allclose(again, [centred(mesh, f) for f in range(len(mesh))], atol=1e-3)
    assert cache_bytes(mesh) == pytest.approx(path.stat().st_size, rel=0.01)
    assert sorted(p.name for p in tmp_path.iterdir()) == sorted(["a.obj", path.name])


def test_caches_have_one_sample_for_every_frame_of_the_rate(meshes, tmp_path):
    """Two frames are missing: the samples between stand for them."""
    mesh = meshes["hag"]
    keep = np.r_[0:5, 7:24]
    gappy = replace(mesh, weights=mesh.weights[keep], timestamps=mesh.timestamps[keep], head_pose=mesh.head_pose[keep])
    write_point_cache(tmp_path / "g.pc2", gappy, "mm")
    again = read_point_cache(tmp_path / "g.pc2")
    assert len(again) == 24
    shift = gappy.centre - mesh.centre
    np.testing.assert_allclose(again[12] + shift, centred(mesh, 12), atol=1e-3)
    between = (2 * centred(mesh, 4) + centred(mesh, 7)) / 3
    np.testing.assert_allclose(again[5] + shift, between, atol=1e-3)


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("a.pc2", b""),
        ("a.pc2", b"POINTCACHE2\0" + bytes(20) + b"x"),
        ("a.pc2", b"something else entirely, long enough"),
        ("a.mdd", b"\0\0"),
        ("a.mdd", b"\xff" * 8),
        ("a.mdd", b"\0\0\0\1\0\0\0\1" + bytes(12)),
    ],
)
def test_broken_caches(tmp_path, name, content):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(FileFormatError, match=name):
        read_point_cache(tmp_path / name)


@pytest.mark.parametrize("kind", ["obj", "mdd", "pc2"])
def test_command_says_the_size_first(tmp_path, capsys, kind, monkeypatch):
    tracked_result(frames=4)[1].save(tmp_path / "result.npz")
    command = ["export", str(tmp_path / "result.npz"), "--character", "baby", "--format", kind, "--out-unit", "cm"]
    assert cli.main(command) == 0
    first = next(line for line in capsys.readouterr().out.splitlines() if "MB" in line)
    assert "about" in first and "lengths in cm" in first and ("pc2 takes" in first) == (kind == "obj")
    assert cli.main(command) == 0  # an output of ours may be written again
    if kind != "obj":
        (tmp_path / "result-baby.obj").write_text("v 0 0 0\n")
        assert cli.main(command) == cli.EXIT_ERROR
        assert "result-baby.obj: what is there is not an OBJ file of this package" in capsys.readouterr().err
        assert (tmp_path / "result-baby.obj").read_text() == "v 0 0 0\n"


def test_other_files_are_not_taken_for_a_sequence(meshes, tmp_path):
    (tmp_path / "scan_00001.obj").write_text("v 0 0 0\n")
    with pytest.raises(AdaptiveFaceError, match="scan_00001"):
        write_obj_sequence(tmp_path, meshes["hag"])


@needs_blender
def test_in_blender(meshes, tmp_path):
    """A head is 0.29 m there, frame by frame and with both caches; it was 292 m."""
    files, caches = {}, {}
    for name, mesh in meshes.items():
        write_obj_sequence(tmp_path / name, mesh)
        for frame in FRAMES:
            files[f"{name}-{frame}"] = str(tmp_path / name / f"face_{frame:05d}.obj")
        for kind in ("mdd", "pc2"):
            path = tmp_path / f"{name}-{kind}.{kind}"
            write_point_cache(path, mesh)
            files[f"{name}-{kind}"], caches[f"{name}-{kind}"] = str(path.with_suffix(".obj")), str(path)
    answer = evaluate(
        tmp_path,
        {"fps": [30, 1], "files": files, "caches": caches, "frames": {key: FRAMES if key in caches else [0] for key in files}},
    )
    for name, mesh in meshes.items():
        for k, frame in enumerate(FRAMES):
            for points in (answer[f"{name}-{frame}/points"][0], *(answer[f"{name}-{c}/points"][k] for c in ("mdd", "pc2"))):
                off = np.linalg.norm(1e3 * points - centred(mesh, frame), axis=1)
                assert off.max() < NEAR, (name, frame)
        assert answer[f"{name}-{frame}/smooth"].all()
    assert 0.25 < np.ptp(answer["actor-0/points"][0][:, 1]) < 0.35
