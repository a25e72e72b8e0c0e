"""``export --meshopt``: gltfpack's file, decoded by three.js, against what was exported."""

from __future__ import annotations

import json
import os
import subprocess

import numpy as np
import pytest
from export_scene import tracked_result
from scipy.spatial import cKDTree
from web import install

from adaptiveface import cli
from adaptiveface.errors import MissingExtraError
from adaptiveface.export import meshopt
from adaptiveface.export.animation import AnimatedMesh, actor_animation
from adaptiveface.export.gltf import write_glb
from adaptiveface.export.inside_parts import with_insides

FRAMES = (0, 5, 11)

_THREE = """
import fs from 'fs'; import * as THREE from 'three';
globalThis.self = globalThis; globalThis.ProgressEvent ??= class {};
const { GLTFLoader } = await import('three/addons/loaders/GLTFLoader.js');
const { MeshoptDecoder } = await import('three/addons/libs/meshopt_decoder.module.js');
await MeshoptDecoder.ready;
const [file, times] = [process.argv[2], JSON.parse(process.argv[3])], data = fs.readFileSync(file);
const loader = new GLTFLoader().setMeshoptDecoder(MeshoptDecoder);
const gltf = await loader.parseAsync(data.buffer.slice(data.byteOffset, data.byteOffset + data.length), '');
const mixer = new THREE.AnimationMixer(gltf.scene), action = mixer.clipAction(gltf.animations[0]);
action.setLoop(THREE.LoopOnce); action.clampWhenFinished = true;
const meshes = []; gltf.scene.traverse(o => { if (o.isMesh) meshes.push(o); });
const out = meshes.map(mesh => times.map(time => {
  action.reset().play(); mixer.setTime(time); gltf.scene.updateMatrixWorld(true);
  const v = new THREE.Vector3(), points = [];
  for (let i = 0; i < mesh.geometry.attributes.position.count; i++)
    points.push(mesh.getVertexPosition(i, v).applyMatrix4(mesh.matrixWorld).toArray());
  return points;
}));
const names = meshes.map(mesh => Object.keys(mesh.morphTargetDictionary));
console.log(JSON.stringify({points: out, names}));
"""


@pytest.fixture(scope="module")
def mesh() -> AnimatedMesh:
    actor, result = tracked_result(frames=12)[:2]
    return with_insides(actor_animation(result, actor), result, actor)


@pytest.mark.slow
def test_three_js_shows_what_was_exported(mesh, tmp_path, monkeypatch):
    modules = install(tmp_path, "three@0.170.0", "gltfpack@1.3.0")
    monkeypatch.setenv("PATH", f"{modules / '.bin'}{os.pathsep}{os.environ['PATH']}")
    write_glb(tmp_path / "plain.glb", mesh)
    meshopt.write_meshopt_glb(tmp_path / "packed.glb", mesh)
    plain, packed = ((tmp_path / name).stat().st_size for name in ("plain.glb", "packed.glb"))
    assert packed < 0.2 * plain
    (tmp_path / "read.mjs").write_text(_THREE)
    times = json.dumps([frame / mesh.fps for frame in FRAMES])
    shown = []
    for name in ("plain.glb", "packed.glb"):
        command = ["node", "read.mjs", name, times]
        run = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=300, check=True)
        shown.append(json.loads(run.stdout))
    assert shown[0]["names"] == shown[1]["names"]
    for before, after in zip(shown[0]["points"], shown[1]["points"], strict=True):
        # The vertices come in another order: each is known by where it is in all frames together.
        paths = [1e3 * np.array(points).transpose(1, 0, 2).reshape(-1, 3 * len(FRAMES)) for points in (before, after)]
        assert paths[0].shape == paths[1].shape
        for one, other in (paths, paths[::-1]):
            assert cKDTree(one).query(other)[0].max() < 0.05 * np.sqrt(len(FRAMES))


def test_without_the_tool_the_line_that_installs_it_is_said(mesh, tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(MissingExtraError, match="npm install --global gltfpack"):
        meshopt.write_meshopt_glb(tmp_path / "x.glb", mesh)
    tracked_result(frames=2)[1].save(tmp_path / "result.npz")
    assert cli.main(["export", str(tmp_path / "result.npz"), "--meshopt"]) == cli.EXIT_ERROR
    assert not list(tmp_path.glob("*.glb"))


@pytest.mark.skipif(os.name == "nt", reason="a shell script stands for the tool")
def test_a_tool_that_fails_leaves_the_old_file(mesh, tmp_path, monkeypatch):
    failing = tmp_path / "gltfpack"
    failing.write_text("#!/bin/sh\necho cannot read >&2\nexit 3\n")
    failing.chmod(0o755)
    monkeypatch.setattr(meshopt, "find_gltfpack", lambda: str(failing))
    out = tmp_path / "x.glb"
    out.write_bytes(b"old")
    with pytest.raises(meshopt.AdaptiveFaceError, match="cannot read"):
        meshopt.write_meshopt_glb(out, mesh)
    assert out.read_bytes() == b"old" and not list(tmp_path.glob("*.part*"))
