"""Runs inside Blender's Python (``bpy``): imports exported files as a user would and says what Blender makes of them.

``python evaluate.py jobs.json out.npz``. jobs: {"fps": [numerator, base], "files": {key: path}, "frames": {key: [frame,
...]}, "render": {key: png}}. Frames are those of the scene. out: key/points (K, V, 3), and
key/inside of a second mesh, in metres in world axes turned
back to y up, key/range (first, last, fps), key/keys: the frames of all keys of the shapes, key/materials. The package
itself is not imported: Blender comes with a numpy of its own.
"""

from __future__ import annotations

import json
import sys

import bpy
import numpy as np


def import_file(path: str, fps: list) -> None:
    """Into an empty scene of ``fps`` (numerator, base), as the docs' clicks do it."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.render.fps, scene.render.fps_base = int(fps[0]), float(fps[1])
    if path.endswith(".glb"):
        bpy.ops.import_scene.gltf(filepath=path)
    elif path.endswith(".obj"):
        bpy.ops.wm.obj_import(filepath=path, forward_axis="NEGATIVE_Z", up_axis="Y")
    else:
        bpy.ops.wm.usd_import(filepath=path)


def add_cache(path: str) -> None:
    """A mesh cache modifier on the mesh, with Blender's defaults except for the kind of file."""
    scene, body = bpy.context.scene, mesh_object()
    modifier = body.modifiers.new("cache", "MESH_CACHE")
    modifier.cache_format = "MDD" if path.endswith(".mdd") else "PC2"
    modifier.filepath = path
    scene.frame_start, scene.frame_end = 0, 250


def mesh_objects() -> list:
    """The objects with meshes, the one with the most vertices first: the skin, then what is inside."""
    return sorted((o for o in bpy.data.objects if o.type == "MESH"), key=lambda o: -len(o.data.vertices))


def mesh_object():
    """The object with the most vertices."""
    return mesh_objects()[0]


def points(frame: float, number: int = 0) -> np.ndarray:
    """(V, 3) m of one of the meshes as Blender evaluates them at a frame, y up as in the file."""
    scene = bpy.context.scene
    whole = int(np.floor(frame))
    scene.frame_set(whole, subframe=frame - whole)
    graph = bpy.context.evaluated_depsgraph_get()
    body = mesh_objects()[number].evaluated_get(graph)
    mesh = body.to_mesh()
    flat = np.empty(3 * len(mesh.vertices), np.float32)
    mesh.vertices.foreach_get("co", flat)
    world = np.array(body.matrix_world)
    body.to_mesh_clear()
    out = flat.reshape(-1, 3).astype(float) @ world[:3, :3].T + world[:3, 3]
    return out[:, [0, 2, 1]] * [1, 1, -1]  # Blender turns y up into z up


def key_frames() -> np.ndarray:
    """Frames of all keys of shape weights."""
    keys = mesh_object().data.shape_keys
    action = keys.animation_data.action if keys and keys.animation_data else None
    if action is None:
        return np.zeros(0)
    curves = [c for layer in action.layers for strip in layer.strips for bag in strip.channelbags for c in bag.fcurves]
    return np.array([key.co[0] for curve in curves if "key_blocks" in curve.data_path for key in curve.keyframe_points])


def render(path: str, frame: int) -> None:
    """A picture of the face by Workbench-free software rendering (Cycles on the CPU), camera in front of the head."""
    scene = bpy.context.scene
    scene.frame_set(frame)
    cloud = points(frame)[:, [0, 2, 1]] * [1, -1, 1]
    middle, size = (cloud.min(axis=0) + cloud.max(axis=0)) / 2, float(np.ptp(cloud, axis=0).max())
    camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    camera.location = middle + np.array([0.0, -1.9 * size, 0.05 * size])
    camera.rotation_euler = (np.pi / 2, 0.0, 0.0)
    camera.data.clip_start = 0.001
    light = bpy.data.objects.new("sun", bpy.data.lights.new("sun", "SUN"))
    light.data.energy, light.rotation_euler = 3.0, (0.7, 0.3, 0.2)
    for thing in (camera, light):
        scene.collection.objects.link(thing)
    scene.camera, scene.render.engine = camera, "CYCLES"
    scene.cycles.samples, scene.cycles.device = 16, "CPU"
    scene.world = bpy.data.worlds.new("world")
    scene.view_settings.view_transform = "Standard"
    scene.render.resolution_x = scene.render.resolution_y = 480
    scene.render.filepath = path
    bpy.ops.render.render(write_still=True)


def main(jobs_path: str, out_path: str) -> None:
    """Every job of the file; the answers as one npz."""
    with open(jobs_path, encoding="utf-8") as stream:
        jobs = json.load(stream)
    out = {}
    for key, path in jobs["files"].items():
        import_file(path, jobs["fps"])
        if key in jobs.get("caches", {}):
            add_cache(jobs["caches"][key])
        scene = bpy.context.scene
        out[f"{key}/points"] = np.stack([points(frame) for frame in jobs["frames"][key]])
        if len(mesh_objects()) > 1:
            out[f"{key}/inside"] = np.stack([points(frame, 1) for frame in jobs["frames"][key]])
        out[f"{key}/range"] = np.array([scene.frame_start, scene.frame_end, scene.render.fps / scene.render.fps_base])
        out[f"{key}/keys"] = key_frames()
        body = mesh_object()
        out[f"{key}/smooth"] = np.array([face.use_smooth for face in body.data.polygons])
        out[f"{key}/materials"] = np.array([slot.material.name for slot in body.material_slots if slot.material], str)
        out[f"{key}/colours"] = np.array([layer.name for layer in body.data.color_attributes], str)
        if key in jobs.get("render", {}):
            render(jobs["render"][key], int(jobs.get("shown", {}).get(key, jobs["frames"][key][-1])))
    np.savez(out_path, **out)


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2])
