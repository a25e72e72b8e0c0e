"""USD exports: what USD's validators, its own skinning and Blender make of them."""

from __future__ import annotations

import zipfile
from dataclasses import replace

import numpy as np
import pytest
from blender_runs import evaluate, needs_blender
from export_scene import animated_meshes, tracked_result

pytest.importorskip("pxr", reason="the extra 'usd' is not installed")

from written import read_usd

from adaptiveface import cli
from adaptiveface.export.usd import prim_names, write_usd

FRAMES = (0, 7, 15, 23)
NEAR = 0.05  # mm


@pytest.fixture(scope="module")
def meshes():
    return animated_meshes()


@pytest.fixture(scope="module")
def files(meshes, tmp_path_factory):
    folder = tmp_path_factory.mktemp("usd")
    paths = {}
    for name, mesh in meshes.items():
        for suffix in ("usda", "usdc", "usdz"):
            paths[f"{name}.{suffix}"] = folder / f"{name}.{suffix}"
            write_usd(paths[f"{name}.{suffix}"], mesh)
    assert sorted(path.name for path in folder.iterdir()) == sorted(paths)
    return paths


def expected(mesh, frame: int) -> np.ndarray:
    """(V, 3) m as a file should show the frame: the head's median place at the origin."""
    return 1e-3 * (mesh.shape(frame, posed=True) - mesh.centre)


def test_all_validators_find_nothing(files):
    from pxr import Usd, UsdValidation

    validators = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    assert len(validators) > 20
    for path in files.values():
        errors = UsdValidation.ValidationContext(validators).Validate(Usd.Stage.Open(str(path)))
        assert not errors, (path, [error.GetMessage() for error in errors])


def test_usds_own_skinning_makes_every_frame(files, meshes):
    """Baked by UsdSkel: blend shapes, skeleton and the root's place together."""
    from pxr import Usd, UsdGeom, UsdSkel

    for key, path in files.items():
        mesh = meshes[key.split(".")[0]]
        stage = Usd.Stage.Open(str(path))
        assert UsdSkel.BakeSkinning(stage.Traverse())
        body = next(UsdGeom.Mesh(prim) for prim in stage.Traverse() if prim.IsA(UsdGeom.Mesh))
        for frame in FRAMES:
            place = np.array(UsdGeom.XformCache(frame).GetLocalToWorldTransform(body.GetPrim()))
            points = np.array(body.GetPointsAttr().Get(frame), float) @ place[:3, :3] + place[3, :3]
            off = np.linalg.norm(points - expected(mesh, frame), axis=1)
            assert 1e3 * off.max() < NEAR, (key, frame)


def test_times_are_frames(files):
    from pxr import Usd

    for path in files.values():
        stage = Usd.Stage.Open(str(path))
        assert stage.GetTimeCodesPerSecond() == 30 and stage.GetFramesPerSecond() == 30
        assert (stage.GetStartTimeCode(), stage.GetEndTimeCode()) == (0, 23)
        weights = stage.GetPrimAtPath("/performance/animation").GetAttribute("blendShapeWeights")
        assert weights.GetTimeSamples() == list(range(24))


def test_surface_has_normals_and_the_meshs_colours(files, meshes):
    from pxr import Usd, UsdGeom, UsdShade

    for key, path in files.items():
        stage, mesh = Usd.Stage.Open(str(path)), meshes[key.split(".")[0]]
        body = next(UsdGeom.Mesh(prim) for prim in stage.Traverse() if prim.IsA(UsdGeom.Mesh))
        normals = np.array(body.GetNormalsAttr().Get())
        assert normals.shape == mesh.neutral.shape and np.allclose(np.linalg.norm(normals, axis=1), 1, atol=1e-4)
        material = UsdShade.MaterialBindingAPI(body).ComputeBoundMaterial()[0]
        surface = material.ComputeSurfaceSource()[0]
        assert surface.GetIdAttr().Get() == "UsdPreviewSurface"
        diffuse = surface.GetInput("diffuseColor")
        if mesh.colours is None:
            np.testing.assert_allclose(diffuse.Get(), [0.604, 0.392, 0.301], atol=1e-3)
        else:
            reader = UsdShade.Shader(diffuse.GetConnectedSources()[0][0].source.GetPrim())
            assert reader.GetInput("varname").Get() == "displayColor"
            colours = np.array(body.GetDisplayColorAttr().Get())
            assert colours.shape == mesh.neutral.shape and 0 <= colours.min() < colours.max() <= 1


def test_package_is_one_uncompressed_layer(files):
    with zipfile.ZipFile(files["hag.usdz"]) as package:
        (entry,) = package.infolist()
        assert entry.filename.endswith(".usdc") and entry.compress_type == zipfile.ZIP_STORED
        assert (entry.header_offset + 30 + len(entry.filename) + len(entry.extra)) % 64 == 0 or entry.extra
    again = read_usd(files["hag.usdz"])
    assert len(again) == 24 and "jawOpen" in again.target_names


def test_names_that_collide_stay_apart(meshes, tmp_path):
    """Sixteen shapes were twelve prims."""
    names = ("jaw open", "jaw-open", "jaw_open", "1", "_1", "é", "ü", "")
    mesh = meshes["hag"]
    some = replace(
        mesh, name="animation", target_names=names, targets=mesh.targets[: len(names)], weights=mesh.weights[:, : len(names)]
    )
    assert len(set(prim_names(names))) == len(names)
    write_usd(tmp_path / "names.usda", some)
    again = read_usd(tmp_path / "names.usda")
    assert again.target_names[:-1] == names[:-1] and len(set(again.target_names)) == len(names)
    np.testing.assert_allclose(again.weights, some.weights, atol=1e-6)
    np.testing.assert_allclose(again.targets, some.targets, atol=1e-4)


def test_one_frame(meshes, tmp_path):
    mesh = meshes["hag"]
    one = replace(mesh, weights=mesh.weights[:1], timestamps=mesh.timestamps[:1], head_pose=mesh.head_pose[:1])
    write_usd(tmp_path / "one.usdz", one)
    assert len(read_usd(tmp_path / "one.usdz")) == 1


@pytest.mark.parametrize(("kind", "name"), [("usdz", "result-hag.usdz"), ("usd", "named.usdz"), ("usd", "named.usda")])
def test_command(tmp_path, kind, name):
    tracked_result()[1].save(tmp_path / "result.npz")
    options = ["--out", str(tmp_path / name)] if name.startswith("named") else []
    assert cli.main(["export", str(tmp_path / "result.npz"), "--character", "hag", "--format", kind, *options]) == 0
    assert len(read_usd(tmp_path / name)) == 24


@needs_blender
def test_usd_in_blender(files, meshes, tmp_path):
    keys = [key for key in files if not key.endswith("a")]
    answer = evaluate(
        tmp_path, {"fps": [30, 1], "files": {key: str(files[key]) for key in keys}, "frames": dict.fromkeys(keys, FRAMES)}
    )
    for key in keys:
        mesh = meshes[key.split(".")[0]]
        for k, frame in enumerate(FRAMES):
            off = np.linalg.norm(answer[f"{key}/points"][k] - expected(mesh, frame), axis=1)
            assert 1e3 * off.max() < NEAR, (key, frame)
        assert list(answer[f"{key}/range"]) == [0, 23, 30]
        np.testing.assert_allclose(answer[f"{key}/keys"], np.rint(answer[f"{key}/keys"]), atol=1e-4)
        assert list(answer[f"{key}/materials"]) == ["skin"] and list(answer[f"{key}/colours"]) == ["displayColor"]
