"""Meshes for pyvista: upright, in millimetres, with the arrays that their docstrings name."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("pyvista", reason="the extra 'notebooks' is not installed")

from export_scene import tracked_result  # noqa: E402

from adaptiveface.errors import MissingExtraError, ParameterError  # noqa: E402
from adaptiveface.model.face_model import embedded_face_model  # noqa: E402
from adaptiveface.neutral.fuse import FusedScan  # noqa: E402
from adaptiveface.retargeting.loading import load_character  # noqa: E402


@pytest.fixture(scope="module")
def scene():
    """The result keeps v1: here the final mesh, moved 1 mm along the camera's x axis."""
    actor, result, v4 = tracked_result()
    return actor, replace(result, v1=result.vertices + np.float32([1, 0, 0])), v4


def test_a_head_stands_upright_and_looks_at_pyvistas_default_camera(scene):
    actor, _, _ = scene
    mesh = actor.mesh()
    assert mesh.n_points == len(actor.neutral) and mesh.n_cells == len(actor.triangles)
    face, skull = mesh.points[actor.frontal].mean(axis=0), mesh.points.mean(axis=0)
    assert face[0] > skull[0] + 20, "the face looks along x, towards the camera at (1, 1, 1)"
    brow, chin = actor.feature_vertices[[list(actor.feature_ids).index(k) for k in (19, 57)]]
    assert mesh.points[brow, 2] > mesh.points[chin, 2] + 50, "up is z"
    left, right = (list(actor.feature_ids).index(k) for k in (54, 48))
    corners = mesh.points[actor.feature_vertices]
    assert corners[left, 1] > corners[right, 1] + 20, "the subject's left is y"
    outwards = np.einsum("nd,nd->n", mesh["normals"], mesh.points - skull)
    assert (outwards > 0).mean() > 0.8, "no mirror image: normals still point outwards"
    assert mesh.volume > 1e6, "the faces are wound outwards, mm"


def test_an_actor_makes_expressions(scene):
    actor, _, _ = scene
    mesh = actor.mesh(jawOpen=0.5)
    jaw = 0.5 * actor.blendshapes[actor.expression_names.index("jawOpen")]
    np.testing.assert_allclose(mesh["displacement"], jaw[:, [2, 0, 1]], atol=1e-6)
    np.testing.assert_allclose(mesh["distance"], np.linalg.norm(jaw, axis=1), atol=1e-6)
    np.testing.assert_allclose(mesh.points - actor.mesh().points, mesh["displacement"], atol=1e-3)
    with pytest.raises(ParameterError, match="'grin' is no expression here; there are: jawOpen"):
        actor.mesh(grin=1.0)


def test_a_result_gives_any_stage_of_any_frame(scene):
    actor, result, v4 = scene
    mesh = result.mesh(-1)
    np.testing.assert_allclose(mesh.points, v4[-1][:, [2, 0, 1]], atol=2e-3)
    np.testing.assert_allclose(mesh["distance"], 1.0, atol=1e-3)
    assert result.mesh(3, "v1")["distance"].max() == 0
    neutral = result.mesh(5, reference=actor.neutral)["displacement"]
    np.testing.assert_allclose(neutral, (v4[5] - actor.neutral)[:, [2, 0, 1]], atol=2e-3)
    names = [name for name in mesh.array_names if name.startswith("corrective")]
    assert len(names) == len(result.correctives) > 0
    assert np.linalg.norm(mesh["corrective 1"], axis=1).max() == pytest.approx(1.0)
    without = replace(result, v1=None, correctives=None).mesh(0)
    assert set(without.array_names) == {"normals"}
    for stage, message in (("v2", "is not in this result: track with --keep-stages"), ("v9", "is none of v1, v2, v3, v4")):
        with pytest.raises(ParameterError, match=message):
            result.mesh(0, stage)
    with pytest.raises(IndexError):
        result.mesh(24)


def test_a_character_keeps_its_colours():
    character = load_character("hag")
    mesh = character.mesh(jawOpen=1.0)
    assert mesh["colours"].shape == character.colours.shape and mesh["colours"].dtype == np.uint8
    assert mesh["distance"].max() > 5 and character.mesh()["distance"].max() == 0


def test_a_scan_is_a_cloud_with_normals():
    model = embedded_face_model()
    points = model.mean[model.frontal]
    normals = np.tile([0.0, 0.0, 1.0], (len(points), 1))
    empty = np.zeros(0)
    scan = FusedScan(points, normals, np.arange(len(points)), empty, empty, empty, (), ())
    mesh = scan.mesh()
    np.testing.assert_allclose(mesh.points, points[:, [2, 0, 1]], atol=1e-3)
    assert (mesh["normals"] == [1.0, 0.0, 0.0]).all() and mesh["views"][-1] == len(points) - 1
    assert mesh.n_verts == len(points)


def test_the_scan_of_an_actor(scene):
    actor = replace(scene[0], scan_points=np.eye(3), scan_normals=np.eye(3))
    np.testing.assert_array_equal(actor.scan_mesh().points, np.eye(3)[:, [2, 0, 1]])
    assert scene[0].scan_mesh().n_points == len(scene[0].scan_points)


def test_without_pyvista_the_error_names_the_extra(scene, monkeypatch):
    monkeypatch.setitem(sys.modules, "pyvista", None)
    with pytest.raises(MissingExtraError, match="adaptiveface.notebooks"):
        scene[0].mesh()


WITHOUT_NETWORK = """
import asyncio, sys
from adaptiveface.model.face_model import embedded_face_model
from adaptiveface.geometry.polydata import surface
model = embedded_face_model()
import pyvista as pv
mesh = surface(model.mean, model.triangles)
from trame_pyvista.jupyter import launch_server

async def launch():
    await launch_server(server="test").ready

asyncio.run(launch())
print("trame_vtklocal.module.wasm" in sys.modules)
"""


def test_trame_says_nothing_and_loads_no_archive(tmp_path):
    """Its WebAssembly view would print a line, and load an archive from the network, as soon as it is there."""
    pytest.importorskip("trame_pyvista", reason="the extra 'notebooks' is not installed")
    env = {k: v for k, v in os.environ.items() if k != "DISPLAY"} | {"HOME": str(tmp_path)}
    env.pop("VTK_WASM_DIR_OVERRIDE", None)
    run = subprocess.run([sys.executable, "-c", WITHOUT_NETWORK], env=env, capture_output=True, text=True, timeout=300)
    assert run.stdout == "False\n" and "wasm" not in run.stderr, run.stdout + run.stderr
