"""Recordings and actors that cannot be used: refused with the file and the reason, never a traceback or a hang."""

from __future__ import annotations

import io
import shutil
import zipfile

import numpy as np
import pytest
from PIL import Image
from recordings import SMALL, edit_intrinsics, refusals, talking_head
from scenes import exact_actor
from test_cli import fails, run

from adaptiveface.errors import FileFormatError, TrackingError
from adaptiveface.geometry.frame import RgbdFrame
from adaptiveface.model.actor import Actor
from adaptiveface.pipeline import capture_source, track_source
from adaptiveface.result import Result
from adaptiveface.sensors import Recording, RecordingWriter


@pytest.fixture(scope="module")
def good(tmp_path_factory):
    """(recording, actor.npz) that work."""
    folder = tmp_path_factory.mktemp("bad_input")
    talking_head(folder / "take", frames=4).save(folder / "actor.npz")
    return folder / "take", folder / "actor.npz"


@pytest.fixture
def copy(good, tmp_path):
    """A copy of the good recording, to be damaged."""
    shutil.copytree(good[0], tmp_path / "take")
    return tmp_path / "take"


def every_depth_image(folder, damage):
    for path in (folder / "depth").iterdir():
        damage(path)


RUINED = {
    "every frame missing": (lambda f: every_depth_image(f, lambda p: p.unlink()), "no depth images"),
    "every frame truncated": (
        lambda f: every_depth_image(f, lambda p: p.write_bytes(p.read_bytes()[:300])),
        "4 broken",
    ),
    "every frame of another size": (
        lambda f: every_depth_image(f, lambda p: Image.new("I;16", (8, 8), 5000).save(p)),
        "8 x 8 pixels",
    ),
    "every frame all zero": (
        lambda f: every_depth_image(f, lambda p: Image.new("I;16", (320, 240), 0).save(p)),
        "every pixel is zero",
    ),
    "NaN intrinsics": (lambda f: edit_intrinsics(f, intrinsic_matrix=[float("nan")] * 9), "intrinsic_matrix = nan"),
    "absurd depth scale": (lambda f: edit_intrinsics(f, depth_scale=1e-9), "depth_scale = 1e-09"),
    "depth scale a thousandfold": (lambda f: edit_intrinsics(f, depth_scale=100_000), "depth"),
    "no features and no colour": (lambda f: (f / "features.csv").unlink(), "neither colour images nor features.csv"),
    "features of no face": (
        lambda f: (f / "features.csv").write_text("frame,feature,u,v,confidence\n0,36,5,5,1\n"),
        "no face",
    ),
    "a table of rubbish": (lambda f: (f / "features.csv").write_bytes(bytes(range(256)) * 9), "features.csv"),
}


@pytest.mark.parametrize("name", RUINED)
def test_ruined_recordings_end_with_one_line(copy, tmp_path, capsys, name):
    damage, reason = RUINED[name]
    damage(copy)
    for command in ("capture", "track"):
        assert reason in fails(capsys, command, copy, "--out", tmp_path / "out.npz")
    assert not (tmp_path / "out.npz").exists()


def test_an_empty_room_has_no_face(tmp_path, good, detector):
    """Colour and depth of a wall: the detector finds nothing, capture and tracking say so."""
    rng = np.random.default_rng(0)
    with RecordingWriter(tmp_path / "wall", SMALL) as writer:
        for k in range(4):
            depth = np.full((240, 320), 900, np.float32) + rng.normal(0, 1, (240, 320)).astype(np.float32)
            colour = np.full((240, 320, 3), 120, np.uint8) + rng.integers(0, 9, (240, 320, 3)).astype(np.uint8)
            writer.write(RgbdFrame(depth, SMALL, colour, k, k / 30))
    source = Recording(tmp_path / "wall")
    with pytest.raises(TrackingError, match="wall: no face found in any of 4 frames"):
        capture_source(source, detector=detector)
    with pytest.raises(TrackingError, match="wall: the face was found in none of 4 frames"):
        track_source(source, Actor.load(good[1]), detector=detector)


def test_frames_of_rubbish_among_good_ones(copy, good, tmp_path, capsys):
    """Noise that is a valid image reaches the tracker: it must not crash it, and the face must be found again."""
    rng = np.random.default_rng(1)
    noise = rng.integers(1, 65_536, (240, 320)).astype(np.uint16)
    Image.fromarray(noise).save(copy / "depth" / "00001.png")
    status, *_ = run(capsys, "track", copy, "--actor", good[1], "--out", tmp_path / "r.npz")
    result = Result.load(tmp_path / "r.npz")
    assert status == 0 and result.tracked[[0, 2, 3]].all()


# ---- actors ---------------------------------------------------------------------------------------------------------
@pytest.fixture(scope="module")
def small_actor() -> Actor:
    """The exact rig cut down to its first 300 vertices, so that mutations hit every array often."""
    whole = exact_actor()
    keep = 300
    triangles = whole.triangles[(whole.triangles < keep).all(axis=1)]
    features = np.arange(120).reshape(40, 3).astype(np.int32)
    return Actor(
        whole.neutral[:keep],
        whole.blendshapes[:3, :keep],
        triangles,
        whole.frontal[:keep],
        whole.expression_names[:3],
        features,
        whole.feature_weights,
        whole.depth_valid[:keep],
    )


def test_damaged_actor_files_are_refused_or_load(small_actor, tmp_path):
    """300 seeded mutations of the file's bytes."""
    path = tmp_path / "actor.npz"
    small_actor.save(path)
    assert refusals(path, Actor.load, 300) > 150


def test_actor_files_with_damaged_arrays_are_refused_or_load(small_actor, tmp_path):
    """300 seeded mutations of single arrays inside an intact archive, half of them in the array's header."""
    path = tmp_path / "actor.npz"
    small_actor.save(path)
    with zipfile.ZipFile(path) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    refused = 0
    for seed in range(300):
        rng = np.random.default_rng(seed)
        name = sorted(members)[rng.integers(len(members))]
        content = bytearray(members[name])
        reach = min(len(content), 128) if seed % 2 else len(content)
        for _ in range(rng.integers(1, 6)):
            content[rng.integers(reach)] = rng.integers(256)
        with zipfile.ZipFile(path, "w") as archive:
            for member, intact in members.items():
                archive.writestr(member, bytes(content) if member == name else intact)
        try:
            loaded = Actor.load(path)
            assert np.isfinite(loaded.neutral).all() and loaded.triangles.max() < len(loaded.neutral)
        except FileFormatError as error:
            assert str(path) in str(error)
            refused += 1
    assert refused > 100


def change(path, **arrays):
    with np.load(path) as data:
        content = dict(data) | arrays
    np.savez(path, **{name: value for name, value in content.items() if value is not None})


WRONG_ACTORS = {
    "missing": (lambda a: dict(neutral=None), "'neutral' is missing"),
    "another count": (lambda a: dict(frontal=a.frontal[:-1]), "'frontal' has shape"),
    "NaN": (lambda a: dict(neutral=np.full_like(a.neutral, np.nan)), "'neutral' holds NaN"),
    "pickles": (lambda a: dict(identity=np.array([{}], object)), "Python objects"),
    "wild triangles": (lambda a: dict(triangles=a.triangles + 10**6), "'triangles' points outside"),
    "negative features": (lambda a: dict(feature_triangles=-1 - a.feature_triangles), "'feature_triangles' points"),
    "metres": (lambda a: dict(neutral=a.neutral / 1000), "mm across"),
    "no face": (lambda a: dict(frontal=np.zeros_like(a.frontal)), "no frontal vertices"),
    "no blendshapes": (
        lambda a: dict(blendshapes=a.blendshapes[:0], expression_names=np.array([], "U1")),
        "blendshapes",
    ),
    "wild blendshapes": (lambda a: dict(blendshapes=a.blendshapes * 1e6), "lengths that no head has"),
    "weights": (lambda a: dict(feature_weights=a.feature_weights * 2), "not barycentric"),
    "text where numbers belong": (lambda a: dict(neutral=np.full(a.neutral.shape, "x")), "'neutral' has dtype"),
}


@pytest.mark.parametrize("name", WRONG_ACTORS)
def test_wrong_actors_end_with_one_line(good, small_actor, tmp_path, capsys, name):
    wrong, reason = WRONG_ACTORS[name]
    path = tmp_path / "actor.npz"
    small_actor.save(path)
    change(path, **wrong(small_actor))
    line = fails(capsys, "track", good[0], "--actor", path, "--out", tmp_path / "out.npz")
    assert str(path) in line and reason in line


def test_an_array_larger_than_memory_is_refused_by_its_header(small_actor, tmp_path):
    path = tmp_path / "actor.npz"
    small_actor.save(path)
    stream = io.BytesIO()
    np.lib.format.write_array_header_1_0(stream, dict(descr="<f4", fortran_order=False, shape=(10**12, 3)))
    with zipfile.ZipFile(path) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    with zipfile.ZipFile(path, "w") as archive:
        for name, content in members.items():
            archive.writestr(name, stream.getvalue() if name == "scan_points.npy" else content)
    with pytest.raises(FileFormatError, match="'scan_points' promises 12000000000000 bytes and holds"):
        Actor.load(path)
