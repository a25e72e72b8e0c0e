"""Prints a table: program, export, what the program itself makes of it, in numbers. Programs that are absent have no row.

``python tests/evaluate_exports.py [result.npz actor.npz] [--pictures DIR]``: by default a small made-up performance. Blender
is any Python with ``bpy`` (``ADAPTIVEFACE_BLENDER_PYTHON``, or this one); Khronos' validator, three.js, three-vrm,
model-viewer and Babylon.js come from npm.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import shutil
import subprocess
import tempfile
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import numpy as np
from blender_runs import blender_python, evaluate
from evaluate_viewers import viewer_rows
from export_scene import tracked_result

from adaptiveface import Actor, Result
from adaptiveface.export.animation import AnimatedMesh, actor_animation, character_animation
from adaptiveface.export.arkit_csv import read_arkit_csv, write_arkit_csv
from adaptiveface.export.gltf import write_glb
from adaptiveface.export.inside_parts import with_insides
from adaptiveface.export.obj_sequence import write_obj_sequence
from adaptiveface.export.point_cache import write_point_cache
from adaptiveface.export.usd import write_usd
from adaptiveface.livelink import read_take
from adaptiveface.retargeting.loading import load_character
from adaptiveface.retargeting.retarget import retarget

REAL_TAKE = Path(__file__).resolve().parents[2] / "shared/recordings/people/arkit/range_of_motion.csv"
NODE_PACKAGES = ("gltf-validator@2.0.0-dev.3.10", "three@0.170.0")
WRITERS: dict[str, Callable] = {
    "glb": write_glb,
    "compact.glb": partial(write_glb, compact=True),
    "usdc": write_usd,
    "usdz": write_usd,
    "pc2": write_point_cache,
    "mdd": write_point_cache,
}
Row = tuple[str, str, str]

_THREE = """
import fs from 'fs'; import * as THREE from 'three';
globalThis.self = globalThis; globalThis.ProgressEvent ??= class {};
const { GLTFLoader } = await import('three/addons/loaders/GLTFLoader.js');
const jobs = JSON.parse(fs.readFileSync(process.argv[2])), out = {};
for (const [name, file] of Object.entries(jobs.files)) {
  const data = fs.readFileSync(file);
  const gltf = await new GLTFLoader().parseAsync(data.buffer.slice(data.byteOffset, data.byteOffset + data.length), '');
  const faces = []; gltf.scene.traverse(o => { if (o.isMesh) faces.push(o); });
  faces.sort((a, b) => b.geometry.attributes.position.count - a.geometry.attributes.position.count);
  const mixer = new THREE.AnimationMixer(gltf.scene);
  const action = mixer.clipAction(gltf.animations[0]); action.setLoop(THREE.LoopOnce); action.clampWhenFinished = true;
  out[name] = faces.map(face => jobs.times[name].map(time => {
    action.reset().play(); mixer.setTime(time); gltf.scene.updateMatrixWorld(true);
    const v = new THREE.Vector3(), points = [];
    for (let i = 0; i < face.geometry.attributes.position.count; i++)
      points.push(face.getVertexPosition(i, v).applyMatrix4(face.matrixWorld).toArray());
    return points;
  }));
}
fs.writeFileSync(process.argv[3], JSON.stringify(out));
"""
_VALIDATE = """
const validator = require(process.argv[1] + '/gltf-validator'), fs = require('fs');
(async () => {
  for (const file of process.argv.slice(2)) {
    const found = (await validator.validateBytes(new Uint8Array(fs.readFileSync(file)))).issues;
    console.log(found.numErrors, found.numWarnings);
  }
})();
"""


class Exports:
    """The files of every mesh in a folder, and four frames to look at; the actor is held against v4 of the result."""

    def __init__(self, folder: Path, meshes: dict[str, AnimatedMesh], result: Result) -> None:
        self.folder, self.meshes, self.result = folder, meshes, result
        self.frames = {name: [int(f) for f in np.linspace(0, len(m) - 1, 4)] for name, m in meshes.items()}
        self.paths: dict[tuple[str, str], Path] = {}
        for name, mesh in meshes.items():
            for kind, write in WRITERS.items():
                self.paths[name, kind] = folder / kind / f"{name}.{kind}"
                self.paths[name, kind].parent.mkdir(exist_ok=True)
                write(self.paths[name, kind], mesh)
            self.paths[name, "obj"] = folder / f"{name}-obj"
            write_obj_sequence(self.paths[name, "obj"], mesh)

    def wanted(self, name: str, frame: int) -> np.ndarray:
        """(V, 3) mm that a program should show: v4 for the actor, what the weights make of a character."""
        mesh = self.meshes[name]
        shape = self.result.vertices[frame] * [1.0, -1.0, -1.0] if name == "actor" else mesh.shape(frame, posed=True)
        return shape - mesh.centre

    def said(self, name: str, points: np.ndarray, inside: np.ndarray | None = None) -> str:
        """How far points (4, V, 3) m are from what is wanted, and those of the inside parts, which may follow the skin's."""
        mesh = self.meshes[name]
        n, frames = len(mesh.neutral), self.frames[name]
        skin = [1e3 * p[:n] - self.wanted(name, f) for p, f in zip(points, frames, strict=True)]
        text = f"within {np.linalg.norm(skin, axis=2).max():.5f} mm"
        if mesh.inside is None:
            return text
        inside = points[:, n:] if inside is None else inside
        off = [1e3 * p - mesh.inside.shape(f, posed=True) + mesh.centre for p, f in zip(inside, frames, strict=True)]
        return text + f", eyes and teeth within {np.linalg.norm(off, axis=2).max():.5f} mm"

    def codes(self, name: str) -> list[float]:
        """Times of the four frames in frames of the scene."""
        return self.meshes[name].codes[self.frames[name]].tolist()


def blender_rows(exports: Exports, pictures: Path | None) -> Iterator[Row]:
    """Vertices, keys and colours inside Blender."""
    files, frames, caches, render = {}, {}, {}, {}
    jaw = exports.result.coefficients[:, exports.result.expression_names.index("jawOpen")]
    for (name, kind), path in exports.paths.items():
        if kind == "obj":
            for frame in exports.frames[name]:
                files[f"{name} obj {frame}"], frames[f"{name} obj {frame}"] = path / f"face_{frame:05d}.obj", [0]
            continue
        key = f"{name} {kind}"
        files[key], frames[key] = path.with_suffix(".obj") if kind in ("pc2", "mdd") else path, exports.codes(name)
        caches |= {key: str(path)} if kind in ("pc2", "mdd") else {}
        if pictures is not None and kind in ("glb", "usdc"):
            render[key] = str(pictures / f"blender-{name}-{kind}.png")
    rate = next(iter(exports.meshes.values())).fps
    answer = evaluate(
        exports.folder,
        {
            "fps": [round(rate), round(rate) / rate],
            "files": {k: str(p) for k, p in files.items()},
            "frames": frames,
            "caches": caches,
            "render": render,
            "shown": dict.fromkeys(render, int(exports.meshes["actor"].codes[jaw.argmax()])),  # the mouth is open
        },
    )
    for name, kind in exports.paths:
        if kind == "obj":
            points = np.concatenate([answer[f"{name} obj {frame}/points"] for frame in exports.frames[name]])
            yield "Blender", f"{name}, OBJ sequence", f"four frames {exports.said(name, points)}"
            continue
        key = f"{name} {kind}"
        keys = answer[f"{key}/keys"]
        said = f"four frames {exports.said(name, answer[f'{key}/points'], answer.get(f'{key}/inside'))}"
        said += f"; {len(keys)} keys, {np.abs(keys - np.rint(keys)).max():.4f} frames off at most" if len(keys) else ""
        colours = ", ".join(answer[f"{key}/colours"])
        yield "Blender", f"{name}, .{kind}", said + (f"; vertex colours {colours}" if colours else "")


def usd_rows(exports: Exports) -> Iterator[Row]:
    """USD's validators and its own skinning."""
    from pxr import Usd, UsdGeom, UsdSkel, UsdValidation

    def placed(body, code: float) -> np.ndarray:
        """(V, 3) m in the world."""
        place = np.array(UsdGeom.XformCache(code).GetLocalToWorldTransform(body.GetPrim()))
        return np.array(body.GetPointsAttr().Get(code), float) @ place[:3, :3] + place[3, :3]

    validators = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    for (name, kind), path in exports.paths.items():
        if not kind.startswith("usd"):
            continue
        errors = len(UsdValidation.ValidationContext(validators).Validate(Usd.Stage.Open(str(path))))
        stage = Usd.Stage.Open(str(path))
        span = f"{stage.GetStartTimeCode():g} to {stage.GetEndTimeCode():g} at {stage.GetTimeCodesPerSecond():g} a second"
        UsdSkel.BakeSkinning(stage.Traverse())
        bodies = [UsdGeom.Mesh(prim) for prim in stage.Traverse() if prim.IsA(UsdGeom.Mesh)]
        meshes = [np.stack([placed(body, code) for code in exports.codes(name)]) for body in bodies]
        yield (
            f"USD {'.'.join(map(str, Usd.GetVersion()[1:]))}",
            f"{name}, .{kind}",
            f"skinned {exports.said(name, *meshes)}; {errors} errors of {len(validators)} validators; {span}",
        )


def web_rows(exports: Exports, modules: Path) -> Iterator[Row]:
    """Khronos' validator and three.js."""
    kinds = {f"{name}, .{kind}": (name, path) for (name, kind), path in exports.paths.items() if kind.endswith("glb")}
    names, files = list(kinds), [str(path) for _, path in kinds.values()]
    run = subprocess.run(["node", "-e", _VALIDATE, str(modules), *files], capture_output=True, text=True, check=True)
    for name, line in zip(names, run.stdout.splitlines(), strict=True):
        size = Path(kinds[name][1]).stat().st_size / 1e6
        yield "glTF validator", name, f"{size:.1f} MB; " + "{} errors, {} warnings".format(*line.split())
    script, jobs, answer = (modules.parent / n for n in ("three.mjs", "jobs.json", "answer.json"))
    script.write_text(_THREE)
    times = {key: exports.meshes[name].timestamps[exports.frames[name]].tolist() for key, (name, _) in kinds.items()}
    jobs.write_text(json.dumps({"files": dict(zip(names, files, strict=True)), "times": times}))
    subprocess.run(["node", str(script), str(jobs), str(answer)], check=True, cwd=modules.parent)
    for name, meshes in json.loads(answer.read_text()).items():
        yield "three.js", name, f"four frames {exports.said(kinds[name][0], *map(np.array, meshes))}"


def take_rows(folder: Path) -> Iterator[Row]:
    """A real take of Live Link Face, read and written again."""
    write_arkit_csv(folder / "again.csv", read_arkit_csv(REAL_TAKE))
    take, again = read_take(REAL_TAKE), read_take(folder / "again.csv")
    off = max(np.abs(getattr(take, n) - getattr(again, n)).max() for n in ("timestamps", "curves", "head", "eyes"))
    yield "Live Link Face", "real take, .csv", f"{len(take)} rows of 61 values come back within {off:.1e}"


def npm(folder: Path) -> Path | None:
    """node_modules with what the web rows need, or None."""
    if not (shutil.which("node") and shutil.which("npm")):
        return None
    command = ["npm", "install", "--no-audit", "--no-fund", "--prefix", str(folder), *NODE_PACKAGES]
    done = subprocess.run(command, capture_output=True, timeout=180)
    return folder / "node_modules" if done.returncode == 0 else None


def rows(folder: Path, meshes: dict[str, AnimatedMesh], result: Result, pictures: Path | None = None) -> Iterator[Row]:
    """Rows of the table, from every program that is here."""
    exports = Exports(folder, meshes, result)
    if blender_python() is not None:
        yield from blender_rows(exports, pictures)
    if importlib.util.find_spec("pxr"):
        yield from usd_rows(exports)
    modules = npm(folder)
    if modules is not None:
        yield from web_rows(exports, modules)
        yield from viewer_rows(folder, {name: exports.paths[name, "glb"] for name in meshes}, result, pictures)
    if REAL_TAKE.is_file():
        yield from take_rows(folder)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("result", nargs="?", type=Path)
    parser.add_argument("actor", nargs="?", type=Path)
    parser.add_argument("--pictures", type=Path, help="folder for renders")
    args = parser.parse_args()
    actor, result = (Actor.load(args.actor), Result.load(args.result)) if args.result else tracked_result()[:2]
    if args.pictures:
        args.pictures.mkdir(parents=True, exist_ok=True)
    meshes = {
        "actor": with_insides(actor_animation(result, actor), result, actor),
        "hag": character_animation(load_character("hag"), retarget(result, actor=actor)),
    }
    print("| program | export | evaluated inside it |\n|---|---|---|")
    with tempfile.TemporaryDirectory() as folder:
        for row in rows(Path(folder), meshes, result, args.pictures and args.pictures.resolve()):
            print("| " + " | ".join(row) + " |", flush=True)


if __name__ == "__main__":
    main()
