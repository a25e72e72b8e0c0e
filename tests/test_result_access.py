"""Results from Python: frames, slices, names of coordinate frames, tables, and the recipes in the docs."""

from __future__ import annotations

import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from blender_runs import blender_python, needs_blender
from export_scene import save_run, tracked_result

from adaptiveface.errors import MissingExtraError
from adaptiveface.result import Result
from adaptiveface.retargeting.arkit import ARKIT_NAMES
from adaptiveface.retargeting.retarget import retarget

RECIPES = Path(__file__).resolve().parents[1] / "docs" / "python.md"
CONSOLE = "# in Blender's Python console"


@pytest.fixture(scope="module")
def scene():
    actor, result, v4 = tracked_result()
    tracked = result.tracked.copy()
    tracked[[3, 4]] = False
    reasons = tuple("no face" if not ok else "" for ok in tracked)
    return actor, replace(result, tracked=tracked, reasons=reasons), v4


@pytest.fixture(scope="module")
def folder(scene, tmp_path_factory):
    return save_run(tmp_path_factory.mktemp("recipes"), *scene[:2])


def test_a_result_says_itself_in_one_line(scene, folder):
    _, result, _ = scene
    assert repr(result) == "Result(24 frames, 22 tracked, 0.77 s, 6979 vertices, 23 expressions)"
    assert repr(Result.load(folder / "result.npz")) == str(result) == repr(result)
    assert repr(result[:0]).startswith("Result(0 frames")
    assert repr(result[3]) == "ResultFrame(3, 0.100 s, not tracked: no face)" and "tracked)" in repr(result[0])


def test_frames_by_number(scene, folder):
    _, result, v4 = scene
    for source in (result, Result.load(folder / "result.npz")):
        for key in (0, 7, -1, np.int64(5)):
            frame = source[key]
            index = range(24)[key]
            assert frame.index == index and frame.timestamp == pytest.approx(index / 30)
            assert np.array_equal(frame.camera_vertices, result.vertices[index])
            np.testing.assert_allclose(frame.head_vertices, v4[index], atol=1e-3)
            assert frame.curves["jawOpen"] == pytest.approx(float(result.coefficients[index, 0]))
        assert [frame.index for frame in source] == list(range(24))
        assert [frame.tracked for frame in source].count(False) == 2
    for key in (24, -25):
        with pytest.raises(IndexError):
            result[key]
    with pytest.raises(TypeError):
        result["jawOpen"]


@pytest.mark.parametrize("key", [slice(5, 15), slice(None, None, 2), slice(-3, None), slice(None, None, -1), slice(3, 3)])
def test_slices_are_results(scene, tmp_path, key):
    _, result, _ = scene
    part = result[key]
    chosen = list(range(24))[key]
    assert len(part) == len(chosen) == len(part.reasons) and part.expression_names == result.expression_names
    assert np.array_equal(part.vertices, result.vertices[chosen]) and part.v1 is None
    assert np.array_equal(part.timestamps, result.timestamps[chosen])
    assert np.array_equal(part.correctives, result.correctives) and np.array_equal(part.frontal, result.frontal)
    if len(part):
        part.save(tmp_path / "part.npz")
        assert len(Result.load(tmp_path / "part.npz")) == len(part)


def test_as_many_frames_as_vertices_are_told_apart(scene):
    """Only what has an entry per frame is cut, whatever lengths agree by chance."""
    _, result, _ = scene
    same = replace(result, expression_names=result.expression_names + ("more",))  # 24 names for 24 frames
    assert len(same[:5].expression_names) == 24


def test_vertices_by_the_name_of_their_frame(scene):
    _, result, v4 = scene
    assert result.camera_vertices is result.vertices
    np.testing.assert_allclose(result.head_vertices, v4, atol=1e-3)


def test_curves_are_a_table_over_time(scene):
    pandas = pytest.importorskip("pandas", reason="the extra 'pandas' is not installed")
    _, result, _ = scene
    curves = result.curves()
    assert isinstance(curves.index, pandas.TimedeltaIndex) and curves.index.name == "time"
    np.testing.assert_allclose(curves.index.total_seconds(), result.timestamps, atol=1e-8)
    assert tuple(curves.columns) == result.expression_names
    np.testing.assert_array_equal(curves.to_numpy(), result.coefficients.astype(float))
    np.testing.assert_array_equal(result.curves(initial=True), result.coefficients_initial.astype(float))
    gaps = result.curves(gaps=True)
    assert gaps.isna().all(axis=1).tolist() == (~result.tracked).tolist()
    arkit = retarget(result).table()
    assert tuple(arkit.columns) == ARKIT_NAMES and len(arkit) == 24
    assert len(curves.resample("100ms").mean()) == 8


def test_without_pandas_one_line_says_what_to_install(scene, monkeypatch):
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(MissingExtraError, match=r"adaptiveface\[pandas\]"):
        scene[1].curves()


# ---- the recipes ----


def blocks() -> list[str]:
    return re.findall(r"```python\n(.*?)```", RECIPES.read_text(encoding="utf-8"), re.DOTALL)


def test_recipes_run(folder, monkeypatch, capsys):
    for name in ("pandas", "xarray", "trimesh", "pyvista"):
        pytest.importorskip(name)
    monkeypatch.chdir(folder)
    recipes = [block for block in blocks() if not block.startswith(CONSOLE)]
    assert len(recipes) == 7 and len(blocks()) == 8
    names: dict = {}
    for recipe in recipes:
        exec(compile(recipe, str(RECIPES), "exec"), names)
    assert (folder / "frame.ply").stat().st_size > 1000 and (folder / "curves.csv").is_file()
    from PIL import Image

    with Image.open(folder / "frame.png") as picture:
        assert len(picture.convert("RGB").getcolors(1 << 20)) > 50  # something was drawn
    said = capsys.readouterr().out
    assert "Result(24 frames" in said and "mm/s" in said and "cm2" in said
    gap = float(re.search(r"^([\d.e-]+) mm$", said, re.MULTILINE)[1])
    assert gap < 1e-3


@needs_blender
def test_recipe_for_blenders_console(folder):
    (recipe,) = (block for block in blocks() if block.startswith(CONSOLE))
    check = "\nprint('made', len(bpy.data.objects['frame 10'].data.vertices), len(mesh.polygons))\n"
    run = subprocess.run(
        [blender_python(), "-c", recipe + check],
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=120,
        env={"PATH": "/usr/bin:/bin", "HOME": str(folder)},
    )
    assert "made 6979" in run.stdout, run.stdout + run.stderr
