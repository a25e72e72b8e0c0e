"""Takes of one to three frames: tracked, reported and exported in every format, with the actor's rig and without."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from export_scene import tracked_result
from PIL import Image
from recordings import talking_head
from written import read_glb_animation, read_obj_sequence, read_point_cache, read_usd

from adaptiveface.cli import main
from adaptiveface.export.animation import actor_animation
from adaptiveface.export.arguments import FORMATS
from adaptiveface.export.arkit_csv import read_arkit_csv
from adaptiveface.result import Result


def frames_in(path, kind: str) -> int:
    """How many frames a program that reads the file sees."""
    if kind == "obj":
        return len(read_obj_sequence(path)[0])
    if kind == "gif":
        return Image.open(path).n_frames
    if kind == "mp4":
        video, count = cv2.VideoCapture(str(path)), 0
        while video.read()[0]:
            count += 1
        return count
    if kind in ("mdd", "pc2"):
        return len(read_point_cache(path))
    return len({"glb": read_glb_animation, "usd": read_usd, "usdz": read_usd, "arkit-csv": read_arkit_csv}[kind](path))


@pytest.fixture(scope="module", params=[1, 2, 3])
def short(request, tmp_path_factory):
    """(number of frames, folder with result.npz and the actor under another name)."""
    folder = tmp_path_factory.mktemp("short")
    actor, result, _ = tracked_result(frames=request.param)
    result.save(folder / "result.npz")
    actor.save(folder / "rig.npz")
    return request.param, folder


@pytest.mark.parametrize("rig", [True, False], ids=["rig", "bare"])
@pytest.mark.parametrize("character", ["actor", "hag"])
@pytest.mark.parametrize("kind", FORMATS)
def test_every_format_holds_every_frame(short, tmp_path, kind, character, rig):
    if kind.startswith("usd"):
        pytest.importorskip("pxr")
    count, folder = short
    out = tmp_path / f"out{FORMATS[kind]}"
    words = ["export", folder / "result.npz", "--format", kind, "--character", character, "--out", out, "--smooth"]
    assert main([str(word) for word in words + (["--actor", folder / "rig.npz"] if rig else [])]) == 0
    found = frames_in(out, kind)
    assert found == count or kind == "gif" and 1 <= found < count  # it shows 15 pictures a second


def test_one_frame_without_a_rig_is_its_own_neutral(short):
    count, folder = short
    result = Result.load(folder / "result.npz")
    mesh = actor_animation(result)
    assert (len(mesh.targets) == 0) == (count == 1)
    posed = mesh.shape(0, posed=True) * [1, -1, -1]
    assert np.linalg.norm(posed - result.vertices[0], axis=1).max() < 0.1


@pytest.mark.parametrize("count", [1, 2, 3])
def test_a_short_recording_is_tracked_and_reported(tmp_path, capsys, count):
    talking_head(tmp_path / "take", count).save(tmp_path / "actor.npz")
    words = ["track", tmp_path / "take", "--actor", tmp_path / "actor.npz", "--out", tmp_path / "r.npz"]
    assert main([str(word) for word in [*words, "--report", tmp_path / "report"]]) == 0
    assert f"{count} frames: {count} tracked" in capsys.readouterr().out
    assert len(Result.load(tmp_path / "r.npz")) == count and (tmp_path / "report" / "report.html").stat().st_size > 10_000
