"""Exports: round trips, the Khronos validator, three.js in Chromium, the commands, the streams."""

from __future__ import annotations

import functools
import http.server
import json
import os
import re
import shutil
import socket
import subprocess
import threading

import numpy as np
import pytest
from export_scene import FRAMES, received, save_run, tracked_result
from scipy.spatial.transform import Rotation
from web import validation
from written import read_glb_animation, read_obj_sequence

from adaptiveface import cli
from adaptiveface.errors import AdaptiveFaceError, FileFormatError, ParameterError
from adaptiveface.export.animation import actor_animation, character_animation
from adaptiveface.export.arkit_csv import HEADER, read_arkit_csv, timecode, write_arkit_csv
from adaptiveface.export.gltf import write_glb
from adaptiveface.export.obj_sequence import write_obj_sequence
from adaptiveface.export.stream import LOOPBACK, Address, Streamer
from adaptiveface.export.video import PANEL, character_panel, side_by_side, tracked_panel, write_video
from adaptiveface.retargeting import BUILT_IN
from adaptiveface.retargeting.arkit import ARKIT_NAMES
from adaptiveface.retargeting.loading import load_character
from adaptiveface.retargeting.retarget import retarget

METRE, CURVE = 1e-5 * 1e3, 1e-4  # the limits of a round trip: 1e-5 m in mm, and of curves
NODE_PACKAGES = ("gltf-validator@2.0.0-dev.3.10", "three@0.170.0")


@pytest.fixture(scope="module")
def scene():
    return tracked_result()


@pytest.fixture(scope="module")
def files(scene, tmp_path_factory):
    """One .glb of every built-in character and of the actor."""
    actor, result, _ = scene
    folder = tmp_path_factory.mktemp("glb")
    meshes = {name: character_animation(load_character(name), retarget(result)) for name in BUILT_IN}
    meshes["actor"] = actor_animation(result, actor)
    for name, mesh in meshes.items():
        write_glb(folder / f"{name}.glb", mesh)
    return folder, meshes


def absent(what: str) -> None:
    """Skip, or fail where the environment promises node, npm and chromium (``.ci/run``)."""
    (pytest.fail if os.environ.get("ADAPTIVEFACE_REQUIRE_NODE") else pytest.skip)(what)


@pytest.fixture(scope="session")
def node_modules(tmp_path_factory):
    """Folder with the validator and three.js; skips without node, npm or the package index (in CI: fails)."""
    if not (shutil.which("node") and shutil.which("npm")):
        absent("node and npm are not installed")
    folder = tmp_path_factory.mktemp("node")
    command = ["npm", "install", "--no-audit", "--no-fund", "--prefix", str(folder), *NODE_PACKAGES]
    try:
        subprocess.run(command, check=True, capture_output=True, timeout=180)
    except (subprocess.SubprocessError, OSError) as error:
        absent(f"npm cannot fetch {', '.join(NODE_PACKAGES)}: {str(error)[:120]}")
    return folder / "node_modules"


# ---- round trips ----


@pytest.mark.parametrize("name", [*BUILT_IN, "actor"])
def test_glb_round_trip(files, name):
    folder, meshes = files
    mesh, again = meshes[name], read_glb_animation(folder / f"{name}.glb")
    assert again.target_names == mesh.target_names and np.array_equal(again.triangles, mesh.triangles)
    np.testing.assert_allclose(again.neutral, mesh.neutral, atol=METRE)
    np.testing.assert_allclose(again.targets, mesh.targets, atol=METRE)
    np.testing.assert_allclose(again.weights, mesh.weights, atol=CURVE)
    np.testing.assert_allclose(again.timestamps, mesh.timestamps, atol=CURVE)
    np.testing.assert_allclose(again.head_pose[:, :3, 3], mesh.head_pose[:, :3, 3], atol=METRE)
    np.testing.assert_allclose(again.head_pose[:, :3, :3], mesh.head_pose[:, :3, :3], atol=CURVE)
    assert again.fps == pytest.approx(30, abs=0.01)


def test_glb_without_motion_or_shapes(tmp_path, files):
    from dataclasses import replace

    mesh = files[1]["hag"]
    still = replace(mesh, targets=mesh.targets[:0], target_names=(), weights=mesh.weights[:, :0])
    write_glb(tmp_path / "still.glb", still)
    assert read_glb_animation(tmp_path / "still.glb").weights.shape == (FRAMES, 0)
    one = replace(mesh, weights=mesh.weights[:1], timestamps=mesh.timestamps[:1], head_pose=mesh.head_pose[:1])
    write_glb(tmp_path / "one.glb", one)
    assert len(read_glb_animation(tmp_path / "one.glb")) == 1


def test_actor_reproduces_v4_within_a_tenth_of_a_millimetre(scene, files):
    actor, result, v4 = scene
    again = read_glb_animation(files[0] / "actor.glb")
    errors = [np.linalg.norm(again.shape(f) - v4[f], axis=1).max() for f in range(FRAMES)]
    assert max(errors) < 0.1
    assert again.target_names[:23] == actor.expression_names
    assert sum(name.startswith("corrective") for name in again.target_names) == 4
    np.testing.assert_allclose(again.weights[:, :23], result.coefficients, atol=CURVE)
    posed = again.shape(5, posed=True) * [1, -1, -1]
    assert np.linalg.norm(posed - result.vertices[5], axis=1).max() < 0.1
    bare = actor_animation(result)
    assert max(np.linalg.norm(bare.shape(f) - v4[f], axis=1).max() for f in range(FRAMES)) < 0.1


def test_csv_round_trip(scene, tmp_path):
    performance = retarget(scene[1])
    write_arkit_csv(tmp_path / "curves.csv", performance)
    again = read_arkit_csv(tmp_path / "curves.csv")
    np.testing.assert_allclose(again.curves, performance.curves, atol=CURVE)
    np.testing.assert_allclose(again.timestamps, performance.timestamps, atol=CURVE)
    np.testing.assert_allclose(again.head_pose[:, :3, :3], performance.head_pose[:, :3, :3], atol=CURVE)
    lines = (tmp_path / "curves.csv").read_text().splitlines()
    assert lines[0].startswith("Timecode,BlendShapeCount,EyeBlinkLeft,EyeLookDownLeft") and len(HEADER) == 63
    assert lines[0].endswith(
        "TongueOut,HeadYaw,HeadPitch,HeadRoll,LeftEyeYaw,LeftEyePitch,LeftEyeRoll,RightEyeYaw,RightEyePitch,RightEyeRoll"
    )
    assert lines[1].startswith("00:00:00:00.000,61,") and lines[3].startswith("00:00:00:04.000,61,")
    assert timecode(3723.5125) == "01:02:03:30.750"


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("", "first line"),
        ("a,b,c\n1,2,3\n", "first line"),
        (",".join(HEADER) + "\n", "no rows"),
        (",".join(HEADER) + "\n00:00:00:00.000,61,0.5\n", "line 2: 3 columns"),
        (",".join(HEADER) + "\nnow,61" + ",0" * 61 + "\n", "line 2: a timecode"),
        (",".join(HEADER) + "\n00:00:00:00.000,61" + ",nan" * 61 + "\n", "not finite"),
    ],
)
def test_broken_csv(tmp_path, text, reason):
    (tmp_path / "bad.csv").write_text(text)
    with pytest.raises(FileFormatError, match=reason):
        read_arkit_csv(tmp_path / "bad.csv")


def test_obj_sequence_round_trip(files, tmp_path):
    mesh = files[1]["baby"]
    from dataclasses import replace

    short = replace(mesh, weights=mesh.weights[:3], timestamps=mesh.timestamps[:3], head_pose=mesh.head_pose[:3])
    write_obj_sequence(tmp_path / "frames", short)
    vertices, triangles = read_obj_sequence(tmp_path / "frames")
    centre = np.median(short.head_pose[:, :3, 3], axis=0)
    expected = np.stack([short.shape(f, posed=True) - centre for f in range(3)])
    np.testing.assert_allclose(vertices, expected, atol=METRE)
    assert np.array_equal(triangles, mesh.triangles)


@pytest.mark.parametrize("suffix", [".usda", ".usdc"])
def test_usd_round_trip(files, tmp_path, suffix):
    pytest.importorskip("pxr", reason="the extra 'usd' is not installed")
    from pxr import Usd, UsdSkel
    from written import read_usd

    from adaptiveface.export.usd import write_usd

    mesh = files[1]["ogre"]
    path = tmp_path / f"ogre{suffix}"
    write_usd(path, mesh)
    again = read_usd(path)
    assert again.target_names == mesh.target_names and np.array_equal(again.triangles, mesh.triangles)
    np.testing.assert_allclose(again.neutral, mesh.neutral, atol=METRE)
    np.testing.assert_allclose(again.targets, mesh.targets, atol=METRE)
    np.testing.assert_allclose(again.weights, mesh.weights, atol=CURVE)
    np.testing.assert_allclose(again.head_pose, mesh.head_pose, atol=METRE)
    stage = Usd.Stage.Open(str(path))
    cache = UsdSkel.Cache()
    root = UsdSkel.Root(stage.GetDefaultPrim())
    cache.Populate(root, Usd.PrimDefaultPredicate)
    binding = cache.ComputeSkelBindings(root, Usd.PrimDefaultPredicate)[0]
    skinning = cache.GetSkinningQuery(binding.GetSkinningTargets()[0].GetPrim())
    assert skinning.HasBlendShapes()  # USD itself sees a mesh that its skeleton's animation morphs


# ---- the validator and three.js ----


def test_compact_files_are_small_and_near(files, node_modules, tmp_path):
    for name, mesh in files[1].items():
        path = tmp_path / f"{name}.glb"
        write_glb(path, mesh, compact=True)
        assert path.stat().st_size < 0.55 * (files[0] / f"{name}.glb").stat().st_size
        again = read_glb_animation(path)
        off = [np.linalg.norm(again.shape(f, posed=True) - mesh.shape(f, posed=True), axis=1).max() for f in range(FRAMES)]
        assert max(off) < 0.05
        assert np.abs(again.weights - mesh.weights).max() < 1e-4 and again.target_names == mesh.target_names
    assert not any(validation(node_modules, *sorted(tmp_path.iterdir())))


def test_khronos_validator_finds_nothing(files, node_modules):
    folder, meshes = files
    found = validation(node_modules, *(folder / f"{name}.glb" for name in meshes))
    assert found == [[]] * 4


_PAGE = """<!doctype html><title>loading</title>
<script type="importmap">{"imports": {"three": "/node_modules/three/build/three.module.js",
 "three/addons/": "/node_modules/three/examples/jsm/"}}</script>
<script type="module">
import * as THREE from 'three';
import { GLTFLoader } from 'three/addons/loaders/GLTFLoader.js';
const out = document.createElement('pre'); out.id = 'out'; document.body.append(out);
try {
  const gltf = await new GLTFLoader().loadAsync('/hag.glb');
  let face; gltf.scene.traverse(o => { if (o.isMesh) face = o; });
  const mixer = new THREE.AnimationMixer(gltf.scene), clip = gltf.animations[0];
  mixer.clipAction(clip).play();
  const scene = new THREE.Scene(); scene.add(gltf.scene, new THREE.HemisphereLight(0xffffff, 0x404040, 3));
  const camera = new THREE.PerspectiveCamera(30, 1, 0.01, 10); camera.position.z = 0.55;
  let renderer = null;
  try { renderer = new THREE.WebGLRenderer({preserveDrawingBuffer: true}); renderer.setSize(320, 320, false); }
  catch (error) { console.log(String(error)); }
  const look = time => {
    mixer.setTime(time); gltf.scene.updateMatrixWorld(true);
    const points = [], v = new THREE.Vector3();
    for (let i = 0; i < face.geometry.attributes.position.count; i += 7)
      points.push(face.getVertexPosition(i, v).toArray());
    const quaternion = face.getWorldQuaternion(new THREE.Quaternion()).toArray();
    let pixels = null;
    if (renderer) {
      renderer.render(scene, camera);
      const gl = renderer.getContext(), raw = new Uint8Array(320 * 320 * 4);
      gl.readPixels(0, 0, 320, 320, gl.RGBA, gl.UNSIGNED_BYTE, raw); pixels = Array.from(raw);
    }
    return {points, quaternion, pixels, weights: Array.from(face.morphTargetInfluences)};
  };
  const a = look(TIME_A), b = look(TIME_B);
  const moved = a.points.map((p, i) => Math.hypot(...p.map((x, k) => x - b.points[i][k])));
  out.textContent = JSON.stringify({names: Object.keys(face.morphTargetDictionary), duration: clip.duration,
    moved: Math.max(...moved), weights: [a.weights, b.weights], quaternion: [a.quaternion, b.quaternion],
    lit: a.pixels ? a.pixels.filter((x, i) => i % 4 < 3 && x > 40).length : null,
    changed: a.pixels ? a.pixels.filter((x, i) => Math.abs(x - b.pixels[i]) > 24).length : null});
} catch (error) { out.textContent = JSON.stringify({error: String(error && error.stack || error)}); }
</script>"""


class _Quiet(http.server.SimpleHTTPRequestHandler):
    extensions_map = http.server.SimpleHTTPRequestHandler.extensions_map | {".js": "text/javascript"}

    def log_message(self, *_) -> None:
        pass


def test_three_js_in_chromium_sees_the_face_move(files, node_modules, tmp_path):
    browser = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if browser is None:
        absent("chromium is not installed")
    folder, meshes = files
    mesh = meshes["hag"]
    frames = (0, int(np.abs(mesh.weights - mesh.weights[0]).sum(axis=1).argmax()))
    page = _PAGE.replace("TIME_A", str(mesh.timestamps[frames[0]])).replace("TIME_B", str(mesh.timestamps[frames[1]]))
    (tmp_path / "page.html").write_text(page)
    shutil.copy(folder / "hag.glb", tmp_path)
    os.symlink(node_modules, tmp_path / "node_modules")
    handler = functools.partial(_Quiet, directory=str(tmp_path))
    with http.server.ThreadingHTTPServer((LOOPBACK, 0), handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        command = [
            browser,
            "--headless=new",
            "--no-sandbox",
            "--disable-dev-shm-usage",
            "--use-angle=swiftshader",
            "--enable-unsafe-swiftshader",
            "--disable-background-networking",
            f"--user-data-dir={tmp_path / 'u'}",
            "--virtual-time-budget=60000",
            "--timeout=90000",
            "--dump-dom",
            f"http://{LOOPBACK}:{server.server_port}/page.html",
        ]
        run = subprocess.run(command, capture_output=True, text=True, timeout=180)
        server.shutdown()
    found = re.search(r'<pre id="out">(\{.*?\})</pre>', run.stdout, re.DOTALL)
    assert found, f"no answer from the page: {run.stdout[-500:]} {run.stderr[-500:]}"
    answer = json.loads(found[1].replace("&gt;", ">").replace("&lt;", "<").replace("&amp;", "&"))
    assert "error" not in answer, answer
    assert answer["names"] == list(mesh.target_names)
    assert answer["duration"] == pytest.approx(mesh.timestamps[-1], abs=1e-3)
    for k, frame in enumerate(frames):
        np.testing.assert_allclose(answer["weights"][k], mesh.weights[frame], atol=1e-4)
    shapes = mesh.shape(frames[0])[::7] - mesh.shape(frames[1])[::7]
    assert answer["moved"] == pytest.approx(1e-3 * np.linalg.norm(shapes, axis=1).max(), rel=0.02)
    assert answer["moved"] > 0.003 and answer["quaternion"][0] != answer["quaternion"][1]
    if answer["lit"] is not None:  # with WebGL: the pictures differ too
        assert answer["lit"] > 3000 and answer["changed"] > 500


# ---- video ----


@pytest.mark.parametrize("suffix", [".mp4", ".gif"])
def test_video_shows_tracked_mesh_and_character(scene, files, tmp_path, suffix):
    import cv2
    from PIL import Image

    _, result, _ = scene
    panels = [tracked_panel(result), character_panel(files[1]["hag"])]
    path = tmp_path / f"video{suffix}"
    write_video(path, side_by_side(panels, ["tracked", "hag"], range(6)), 30.0)
    if suffix == ".gif":
        with Image.open(path) as image:
            assert image.size == (PANEL, PANEL // 2) and image.n_frames == 3
        return
    capture = cv2.VideoCapture(str(path))
    assert (int(capture.get(3)), int(capture.get(4))) == (2 * PANEL, PANEL)
    frames = []
    while True:
        good, frame = capture.read()
        if not good:
            break
        frames.append(frame)
    assert len(frames) == 6
    middle = frames[0][PANEL // 2 - 40 : PANEL // 2 + 40]
    assert (middle[:, :PANEL] < 230).any() and (middle[:, PANEL:] < 230).any()


def test_video_without_frames(tmp_path):
    with pytest.raises(AdaptiveFaceError, match="no frames"):
        write_video(tmp_path / "no.mp4", iter(()), 30.0)


# ---- commands ----


@pytest.fixture(scope="module")
def saved(scene, tmp_path_factory):
    return save_run(tmp_path_factory.mktemp("run"), *scene[:2])


@pytest.mark.parametrize(
    ("options", "output"),
    [
        (["--character", "baby"], "result-baby.glb"),
        ([], "result-actor.glb"),
        (["--character", "hag", "--correctives", "--smooth"], "result-hag.glb"),
        (["--format", "arkit-csv", "--filter", "kalman"], "result-arkit.csv"),
        (["--character", "ogre", "--format", "usd", "--coefficients", "initial"], "result-ogre.usdc"),
    ],
)
def test_export_command(saved, options, output, capsys):
    if "usd" in options:
        pytest.importorskip("pxr", reason="the extra 'usd' is not installed")
    assert cli.main(["export", str(saved / "result.npz"), *options]) == 0
    assert (saved / output).stat().st_size > 1000
    assert output in capsys.readouterr().out
    if "--correctives" in options:
        mesh = read_glb_animation(saved / output)
        assert any(name.startswith("corrective") for name in mesh.target_names)


def test_correctives_carried_to_a_character_do_something(saved):
    plain = saved / "plain.glb"
    assert cli.main(["export", str(saved / "result.npz"), "--character", "hag", "--out", str(plain)]) == 0
    rich = saved / "rich.glb"
    cli.main(["export", str(saved / "result.npz"), "--character", "hag", "--correctives", "--out", str(rich)])
    a, b = read_glb_animation(plain), read_glb_animation(rich)
    assert np.linalg.norm(a.shape(10) - b.shape(10), axis=1).max() > 0.5


def test_compare_shows_initial_and_resolved_side_by_side(saved, monkeypatch):
    shown = {}
    monkeypatch.setattr(
        "adaptiveface.export.command.write_performance_video",
        lambda out, result, meshes, *_, **__: shown.update({mesh.name: mesh.weights for mesh in meshes}),
    )
    options = ["--character", "hag", "--format", "gif", "--compare"]
    assert cli.main(["export", str(saved / "result.npz"), *options]) == 0
    assert list(shown) == ["hag, initial", "hag, resolved"]
    assert np.abs(shown["hag, initial"] - shown["hag, resolved"]).max() > 0.02


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        (["--character", "nobody"], "neither built in"),
        (["--out", "x.txt"], "must end in .glb"),
        (["--out", "/dev/null/at/all/x.glb"], "cannot be made"),
        (["--format", "mp4", "--source", "synthetic:1"], "another"),
        (["--format", "usd", "--compact"], "not for usd"),
        (["--coefficients", "arkit", "--correctives"], "does not go with"),
    ],
)
def test_export_refuses_in_one_line(saved, options, reason, capsys):
    assert cli.main(["export", str(saved / "result.npz"), *options]) == cli.EXIT_ERROR
    error = capsys.readouterr().err
    assert reason in error and error.count("\n") == 1


# ---- streams ----


@pytest.mark.parametrize(
    ("text", "host", "port"),
    [
        ("", LOOPBACK, 1),
        ("39540", LOOPBACK, 39540),
        ("192.168.1.7", "192.168.1.7", 1),
        ("pc:4000", "pc", 4000),
        ("[::1]:77", "::1", 77),
        (":5005", LOOPBACK, 5005),
    ],
)
def test_addresses_stay_on_this_machine_unless_a_host_is_named(text, host, port):
    assert Address.parse(text, 1) == Address(host, port)


@pytest.mark.parametrize("text", ["pc:0", "pc:70000", "pc:http", "1:2:x"])
def test_bad_addresses(text):
    with pytest.raises(ParameterError):
        Address.parse(text, 1)


def test_vmc_and_osc_messages(scene):
    pytest.importorskip("pythonosc", reason="the extra 'osc' is not installed")
    from adaptiveface.tracking.types import SampleState, TrackedFrame

    actor, result, v4 = scene
    listeners = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(2)]
    for listener in listeners:
        listener.bind((LOOPBACK, 0))
    vmc, osc = (Address(LOOPBACK, listener.getsockname()[1]) for listener in listeners)
    streamer = Streamer(actor, 23, vmc, osc)
    frame = 12
    for index in (0, frame):
        x = result.coefficients[index].astype(float)
        rigid = result.head_pose[index].astype(float)
        streamer.send(
            TrackedFrame(
                index, index / 30, True, rigid, v4[index], v4[index], v4[index], v4[index], x, x, SampleState.LEARNED, 0
            )
        )
        if index == 0:
            received(listeners[0]), received(listeners[1])
    messages = received(listeners[0])
    assert messages[0] == ("/VMC/Ext/OK", [1]) and messages[-1] == ("/VMC/Ext/Blend/Apply", [])
    values = {m[1][0]: m[1][1] for m in messages if m[0] == "/VMC/Ext/Blend/Val"}
    assert set(values) >= {name[0].upper() + name[1:] for name in ARKIT_NAMES}
    truth = retarget(result).curves[frame]
    got = [values[name[0].upper() + name[1:]] for name in ARKIT_NAMES]
    np.testing.assert_allclose(got, truth, atol=1e-4)
    turns = {m[1][0]: m[1][4:] for m in messages if m[0] == "/VMC/Ext/Bone/Pos"}
    both = (Rotation.from_quat(turns["Neck"]) * Rotation.from_quat(turns["Head"])).as_quat()
    plain = received(listeners[1])
    pose = next(m[1] for m in plain if m[0] == "/adaptiveface/head")
    np.testing.assert_allclose(both * np.sign(both[3]), np.array([1, -1, -1, 1]) * pose[3:], atol=1e-6)  # Unity's axes
    step = (result.head_pose[frame] - result.head_pose[0])[:3, 3] * [1e-3, -1e-3, -1e-3]
    np.testing.assert_allclose(pose[:3], step, atol=1e-6)
    assert sum(m[0] == "/adaptiveface/blendshape" for m in plain) == 52
    lost = TrackedFrame(9, 0.3, False, np.eye(4), v4[0], v4[0], v4[0], v4[0], x, x, SampleState.UNTRACKED, 0)
    streamer.send(lost)
    assert received(listeners[0]) == [("/VMC/Ext/OK", [0])]
    for listener in listeners:
        listener.close()


class _Source:
    """Six frames of a head that opens its mouth, rendered from a known rig."""

    name, fps, has_features = "rendered", 30.0, True

    def __init__(self, actor) -> None:
        from scenes import CAMERA, coefficients, head_pose, posed_shape, render_frame

        self.camera = CAMERA
        shapes = [posed_shape(actor, coefficients(actor, jawOpen=0.12 * f)) for f in range(6)]
        self.frames = [render_frame(actor, shape, head_pose(), index) for index, shape in enumerate(shapes)]

    def __len__(self) -> int:
        return len(self.frames)

    def read(self, index: int):
        return self.frames[index]


def streamed_jaw(actor, saved, monkeypatch, *options: str) -> tuple[list[float], str]:
    """JawOpen of every frame of :class:`_Source` as ``adaptiveface stream`` sends it, and the port."""
    source = _Source(actor)
    monkeypatch.setattr("adaptiveface.sensors.open_source", lambda *_: source)
    listener = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    listener.bind((LOOPBACK, 0))
    port = str(listener.getsockname()[1])
    assert cli.main(["stream", "any", "--vmc", port, "--actor", str(saved / "actor.npz"), "--fast", *options]) == 0
    messages = received(listener)
    listener.close()
    return [m[1][1] for m in messages if m[0] == "/VMC/Ext/Blend/Val" and m[1][0] == "JawOpen"], port


def test_stream_command_tracks_and_sends(scene, saved, capsys, monkeypatch):
    pytest.importorskip("pythonosc", reason="the extra 'osc' is not installed")
    jaw, port = streamed_jaw(scene[0], saved, monkeypatch)
    assert len(jaw) == 6 and jaw[0] < 0.1
    assert jaw[-1] == pytest.approx(0.6, abs=0.12) and np.all(np.diff(jaw) > 0)
    assert f"VMC to {LOOPBACK}:{port}" in capsys.readouterr().out


@pytest.mark.parametrize("change, most", [("sparsity=1000", 0.02), ("upper=0.3", 0.301)])
def test_stream_solves_with_the_parameters_of_the_run(scene, saved, monkeypatch, change, most):
    """A price that no expression is worth, and a lower ceiling: the stream follows both."""
    pytest.importorskip("pythonosc", reason="the extra 'osc' is not installed")
    jaw, _ = streamed_jaw(scene[0], saved, monkeypatch, "--set", f"blendshapes.{change}")
    assert len(jaw) == 6 and max(jaw) < most


def test_usd_validators_find_nothing(files, tmp_path):
    pytest.importorskip("pxr", reason="the extra 'usd' is not installed")
    try:
        from pxr import Usd, UsdValidation
    except ImportError:
        pytest.skip("this usd-core has no validators")
    from adaptiveface.export.usd import write_usd

    write_usd(tmp_path / "actor.usdc", files[1]["actor"])
    validators = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    assert validators
    errors = UsdValidation.ValidationContext(validators).Validate(Usd.Stage.Open(str(tmp_path / "actor.usdc")))
    assert not errors, [error.GetMessage() for error in errors]
