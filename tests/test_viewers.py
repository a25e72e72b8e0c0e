"""Our .glb in model-viewer and in Babylon.js as they come: the head is large and in the middle."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import web
from export_scene import tracked_result
from scipy.spatial.transform import Rotation
from viewer_pages import page

from adaptiveface.export.animation import AnimatedMesh, actor_animation, character_animation
from adaptiveface.export.gltf import write_glb
from adaptiveface.formats.gltf.file import GltfFile
from adaptiveface.geometry.mesh import transform_points
from adaptiveface.retargeting.loading import load_character
from adaptiveface.retargeting.retarget import retarget


@pytest.fixture(scope="module")
def meshes() -> dict[str, AnimatedMesh]:
    """The actor and a character; the performer starts far from where the head is most of the time."""
    actor, result, _ = tracked_result()
    return {
        "actor": actor_animation(result, actor),
        "hag": character_animation(load_character("hag"), retarget(result)),
    }


@pytest.fixture(scope="session")
def modules(tmp_path_factory):
    return web.install(tmp_path_factory.mktemp("viewers"), web.MODEL_VIEWER, *web.BABYLON)


def resting_head(path) -> np.ndarray:
    """(4, 4) where a viewer sees the head before the animation plays, m; our own reader takes such heads as unturned."""
    performance, head = GltfFile(path).items("nodes")
    out = np.eye(4)
    out[:3, :3] = Rotation.from_quat(head["rotation"]).as_matrix()
    out[:3, 3] = np.add(head["translation"], performance["translation"])
    return out


@pytest.mark.parametrize("name", ["actor", "hag"])
def test_at_rest_the_head_is_where_its_first_frame_is(meshes, tmp_path, name):
    mesh = meshes[name]
    write_glb(tmp_path / "x.glb", mesh)
    placed = transform_points(resting_head(tmp_path / "x.glb"), 1e-3 * mesh.neutral)
    expected = 1e-3 * (transform_points(mesh.head_pose[0], mesh.neutral) - mesh.centre)
    np.testing.assert_allclose(placed, expected, atol=1e-6)


def test_one_frame_has_a_rest_pose_too(meshes, tmp_path):
    mesh = meshes["hag"]
    one = replace(mesh, weights=mesh.weights[:1], timestamps=mesh.timestamps[:1], head_pose=mesh.head_pose[:1])
    write_glb(tmp_path / "one.glb", one)
    middle = resting_head(tmp_path / "one.glb") @ np.append(1e-3 * (mesh.neutral.max(axis=0) + mesh.neutral.min(axis=0)) / 2, 1)
    assert np.abs(middle[:3]).max() < 0.1


@pytest.mark.parametrize(("viewer", "playing"), [("model-viewer", False), ("model-viewer", True), ("babylon", True)])
@pytest.mark.parametrize("name", ["actor", "hag"])
def test_viewers_frame_the_face_without_a_setting(meshes, modules, tmp_path, name, viewer, playing):
    write_glb(tmp_path / "x.glb", meshes[name])
    answer = web.ask(tmp_path / "page", modules, page(viewer, playing), {"x.glb": tmp_path / "x.glb"})
    assert answer["animations"] == ["performance"]
    picture = web.picture(answer["picture"], tmp_path / f"{name}-{viewer}.png")
    size = len(picture)
    rows, columns = np.nonzero((picture < 245).any(axis=2))
    height = np.ptp(rows) / size
    middle = np.array([rows.min() + rows.max(), columns.min() + columns.max()]) / 2 / size
    assert 0.4 < height < 0.98, height  # Babylon.js leaves a third of the picture free round everything
    assert np.abs(middle - 0.5).max() < 0.1, middle
    skin = picture[rows, columns].astype(int)
    assert (skin[:, 0] >= skin[:, 2]).mean() > 0.6  # skin, not the inside of a skull or an empty page
