"""Exports inside Blender itself (extra ``blender``): what it evaluates at four frames, against what was exported."""

from __future__ import annotations

import numpy as np
import pytest
from blender_runs import evaluate, needs_blender
from export_scene import tracked_result
from written import read_glb_animation

from adaptiveface.export.animation import actor_animation, character_animation, in_slider_range
from adaptiveface.export.gltf import write_glb
from adaptiveface.retargeting.loading import load_character
from adaptiveface.retargeting.retarget import retarget

FRAMES = (0, 7, 15, 23)
#: mm: what the docs promise.
NEAR = 0.05


@pytest.fixture(scope="module")
def scene():
    return tracked_result()


@pytest.fixture(scope="module")
def meshes(scene):
    actor, result, _ = scene
    return {
        "actor": actor_animation(result, actor),
        "bare": actor_animation(result),
        "hag": character_animation(load_character("hag"), retarget(result)),
    }


def centred(vertices: np.ndarray, mesh) -> np.ndarray:
    """(V, 3) m of vertices (V, 3) mm in the view frame, the median place of the head at the origin."""
    return 1e-3 * (vertices - np.median(mesh.head_pose[:, :3, 3], axis=0))


def test_weights_stay_where_sliders_end(scene, meshes):
    """Blender and USD clamp at 0 and 1: below, up to 0.83 mm of v4 were lost."""
    _, _, v4 = scene
    for name in ("actor", "bare"):
        mesh = meshes[name]
        assert mesh.weights.min() >= 0 and mesh.weights.max() <= 1
        for frame in FRAMES:
            assert np.linalg.norm(mesh.shape(frame) - v4[frame], axis=1).max() < NEAR
    np.testing.assert_array_equal(meshes["actor"].neutral, scene[0].neutral)  # all sliders at zero: the neutral


def test_moved_weights_interpolate_as_before():
    from dataclasses import replace

    actor, result, _ = tracked_result(frames=4)
    mesh = actor_animation(result, actor)
    rough = replace(mesh, weights=mesh.weights * np.linspace(-1.5, 2, len(mesh.target_names)))
    moved = in_slider_range(rough)
    assert moved.target_names[-1] == "offset" and moved.weights.min() >= 0 and moved.weights.max() <= 1 + 1e-12
    for share in (0.0, 0.3, 1.0):
        between = [replace(m, weights=(1 - share) * m.weights[1:2] + share * m.weights[2:3]).shape(0) for m in (rough, moved)]
        np.testing.assert_allclose(*between, atol=1e-9)


@needs_blender
def test_glb_in_blender(scene, meshes, tmp_path):
    _, result, _ = scene
    for name, mesh in meshes.items():
        write_glb(tmp_path / f"{name}.glb", mesh)
    answer = evaluate(
        tmp_path,
        {
            "fps": [30, 1],
            "files": {name: str(tmp_path / f"{name}.glb") for name in meshes},
            "frames": {name: FRAMES for name in meshes},
        },
    )
    for k, frame in enumerate(FRAMES):
        v4 = result.vertices[frame].astype(float) * [1, -1, -1]
        for name in ("actor", "bare"):
            off = np.linalg.norm(answer[f"{name}/points"][k] - centred(v4, meshes[name]), axis=1)
            assert 1e3 * off.max() < NEAR, (name, frame)
        mesh = meshes["hag"]
        off = np.linalg.norm(answer["hag/points"][k] - centred(mesh.shape(frame, posed=True), mesh), axis=1)
        assert 1e3 * off.max() < NEAR, frame
    for name in meshes:  # with the scene at the take's rate, keys are on frames
        keys = answer[f"{name}/keys"]
        np.testing.assert_allclose(keys, np.rint(keys), atol=1e-4)


def test_negative_coefficients_go_to_the_residual(scene, tmp_path):
    from dataclasses import replace

    actor, result, v4 = scene
    below = replace(result, coefficients=result.coefficients - np.float32(0.1))
    mesh = actor_animation(below, actor)
    assert mesh.weights.min() >= 0
    write_glb(tmp_path / "a.glb", mesh)
    again = read_glb_animation(tmp_path / "a.glb")
    assert max(np.linalg.norm(again.shape(f) - v4[f], axis=1).max() for f in FRAMES) < NEAR
