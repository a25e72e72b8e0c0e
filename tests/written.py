"""Read back what the exporters write, and write a character's folder of shapes: for tests only."""

from __future__ import annotations

import os
import re
import struct
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from adaptiveface.errors import FileFormatError
from adaptiveface.export.animation import METRES, AnimatedMesh
from adaptiveface.export.obj_sequence import _FRAME
from adaptiveface.export.point_cache import _MAGIC, _PC2
from adaptiveface.export.usd import _pxr
from adaptiveface.files import open_regular, read_bytes, replacing_folder
from adaptiveface.formats import UNITS
from adaptiveface.formats.gltf.file import GltfFile
from adaptiveface.formats.obj import read_obj, write_obj

_UNIT = re.compile(r"# adaptiveface: lengths in (\w+)")
MAX_BYTES = 1 << 30


def read_glb_animation(path: str | os.PathLike) -> AnimatedMesh:
    """Read back a file of :func:`write_glb`; raises :class:`FileFormatError`."""
    file = GltfFile(Path(path))
    with file.errors():
        node = next(n for n, entry in enumerate(file.items("nodes")) if entry.get("name") == "head")
        mesh = file.items("meshes")[file.items("nodes")[node]["mesh"]]
        primitive = mesh["primitives"][0]
        curves = {}
        for channel in file.items("animations")[0]["channels"]:
            if channel["target"].get("node") != node:
                continue
            sampler = file.items("animations")[0]["samplers"][channel["sampler"]]
            times = file.accessor(sampler["input"]).astype(float)[:, 0]
            curves[channel["target"]["path"]] = file.accessor(sampler["output"]).astype(float)
        if not {"rotation", "translation"} <= curves.keys():
            raise file.error("its animation does not move the head")
        scale = float((file.items("nodes")[node].get("scale") or [1.0])[0])
        neutral = scale * file.accessor(primitive["attributes"]["POSITION"]).astype(float)
        targets = [scale * file.accessor(t["POSITION"], len(neutral)).astype(float) for t in primitive.get("targets", ())]
        rigid = np.tile(np.eye(4), (len(times), 1, 1))
        rigid[:, :3, :3] = Rotation.from_quat(curves["rotation"]).as_matrix()
        rigid[:, :3, 3] = curves["translation"] / METRES
        weights = curves.get("weights", np.zeros((0, 1))).reshape(len(times), len(targets))
        names = tuple(mesh.get("extras", {}).get("targetNames", ()))
        return AnimatedMesh(
            mesh["name"],
            neutral / METRES,
            file.triangles(primitive, len(neutral)),
            names,
            np.array(targets).reshape(len(targets), len(neutral), 3) / METRES,
            weights,
            times,
            rigid,
        )


def read_obj_sequence(folder: str | Path) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (F, V, 3) mm and triangles (T, 3) of a folder of :func:`write_obj_sequence`, in any unit.

    Raises :class:`FileFormatError` for a folder without frames or frames of different meshes.
    """
    paths = sorted(p for p in Path(folder).iterdir() if _FRAME.fullmatch(p.name))
    if not paths:
        raise FileFormatError(f"{folder}: no frames such as face_00000.obj")
    frames, triangles = [], None
    for path in paths:
        vertices, corners = read_obj(path)
        if triangles is not None and (len(vertices) != len(frames[0]) or not np.array_equal(corners, triangles)):
            raise FileFormatError(f"{path}: another mesh than {paths[0].name}")
        frames.append(_millimetres(path) * vertices)
        triangles = corners
    return np.stack(frames), triangles


def _millimetres(path: Path) -> float:
    """Millimetres per unit of a file that :func:`obj_text` made. Earlier versions wrote millimetres, unsaid."""
    with open(path, encoding="utf-8", errors="replace") as stream:
        found = _UNIT.match(stream.readline(100))
    return UNITS.get(found[1], 1.0) if found else 1.0


def write_obj_shapes(folder: str | Path, mesh: AnimatedMesh) -> None:
    """``neutral.obj`` and one ``NAME.obj`` per morph target at weight 1, in mm: a folder that loads as a character.

    Raises :class:`AdaptiveFaceError` as :func:`write_obj_sequence` does.
    """
    with replacing_folder(folder, lambda name: name.endswith(".obj")) as new:
        write_obj(new / "neutral.obj", mesh.neutral, mesh.triangles, mesh.colours)
        for name, target in zip(mesh.target_names, mesh.targets, strict=True):
            write_obj(new / f"{name}.obj", mesh.neutral + target, mesh.triangles, mesh.colours)


def read_point_cache(path: str | os.PathLike) -> np.ndarray:
    """(F, V, 3) float32 of an ``.mdd`` or ``.pc2`` file, in its own unit; raises :class:`FileFormatError`."""
    path = Path(path)
    content = read_bytes(path, MAX_BYTES)
    try:
        if path.suffix.lower() == ".mdd":
            count, points = struct.unpack_from(">ii", content)
            kind, offset = ">f4", 8 + 4 * count
        else:
            magic, version, points, _, _, count = _PC2.unpack_from(content)
            kind, offset = "<f4", _PC2.size
            if magic != _MAGIC or version != 1:
                raise FileFormatError(f"{path}: not a point cache of version 1")
    except struct.error:
        raise FileFormatError(f"{path}: shorter than its header") from None
    size = 12 * count * points
    if count < 0 or points < 0 or len(content) != offset + size:
        raise FileFormatError(f"{path}: {count} frames of {points} points take {offset + size} bytes, not {len(content)}")
    return np.frombuffer(content, kind, offset=offset).astype(np.float32).reshape(count, points, 3)


def read_usd(path: str | os.PathLike) -> AnimatedMesh:
    """Read back a file of :func:`write_usd`; raises :class:`FileFormatError`."""
    pxr = _pxr()
    Usd, UsdGeom, UsdSkel = pxr.Usd, pxr.UsdGeom, pxr.UsdSkel
    open_regular(path, MAX_BYTES).close()
    try:
        stage = Usd.Stage.Open(os.fspath(path))
    except Exception as error:  # pxr.Tf.ErrorException, which only exists once pxr is imported
        raise FileFormatError(f"{path}: not a USD file ({str(error).splitlines()[-1][:120]})") from None
    meshes = [prim for prim in stage.Traverse() if prim.IsA(UsdGeom.Mesh)]
    animations = [prim for prim in stage.Traverse() if prim.IsA(UsdSkel.Animation)]
    if not meshes or not animations:
        raise FileFormatError(f"{path}: no mesh with a UsdSkel animation")
    body, animation = UsdGeom.Mesh(meshes[0]), UsdSkel.Animation(animations[0])
    scale = UsdGeom.GetStageMetersPerUnit(stage) / METRES
    neutral = scale * np.array(body.GetPointsAttr().Get(), float)
    animated = [str(name) for name in animation.GetBlendShapesAttr().Get() or ()]
    names = [str(name) for name in UsdSkel.BindingAPI(meshes[0]).GetBlendShapesAttr().Get() or ()]
    columns = [animated.index(name) for name in names]
    targets = np.zeros((len(names), len(neutral), 3))
    prim_paths = UsdSkel.BindingAPI(meshes[0]).GetBlendShapeTargetsRel().GetTargets()
    for k, (row, prim_path) in enumerate(zip(targets, prim_paths, strict=True)):
        shape = UsdSkel.BlendShape(stage.GetPrimAtPath(prim_path))
        names[k] = shape.GetPrim().GetDisplayName() or names[k]
        indices = np.array(shape.GetPointIndicesAttr().Get(), int)
        if len(indices):
            row[indices] = scale * np.array(shape.GetOffsetsAttr().Get(), float)
    codes = animation.GetTranslationsAttr().GetTimeSamples()
    weights = np.array([animation.GetBlendShapeWeightsAttr().Get(code) for code in codes], float)
    rigid = np.tile(np.eye(4), (len(codes), 1, 1))
    for pose, code in zip(rigid, codes, strict=True):
        turn = animation.GetRotationsAttr().Get(code)[0]
        pose[:3, :3] = Rotation.from_quat([*turn.GetImaginary(), turn.GetReal()]).as_matrix()
        pose[:3, 3] = scale * np.array(animation.GetTranslationsAttr().Get(code)[0], float)
    triangles = np.array(body.GetFaceVertexIndicesAttr().Get(), np.int32).reshape(-1, 3)
    times = np.array(codes) / stage.GetTimeCodesPerSecond()
    return AnimatedMesh(
        body.GetPrim().GetName(),
        neutral,
        triangles,
        tuple(names),
        targets,
        weights.reshape(len(codes), len(animated))[:, columns],
        times,
        rigid,
    )
