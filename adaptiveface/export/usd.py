"""USD with blend shapes (UsdSkel) through ``usd-core``, the extra ``usd``."""

from __future__ import annotations

import math
import os
import re

import numpy as np
from scipy.spatial.transform import Rotation

from ..errors import FileFormatError, MissingExtraError
from ..timing import time_codes
from .animation import AnimatedMesh
from .gltf import METRES, quaternions


def _pxr():
    try:
        import pxr.Gf
        import pxr.Sdf
        import pxr.Usd
        import pxr.UsdGeom
        import pxr.UsdSkel
        import pxr.Vt
    except ImportError as error:
        raise MissingExtraError(f"USD needs usd-core: python -m pip install 'adaptiveface[usd]' ({error})") from None
    return pxr


def prim_name(name: str) -> str:
    """``name`` as USD allows it: letters, digits and underscores, not starting with a digit."""
    return re.sub(r"^(?=\d)|\W", "_", name, flags=re.ASCII) or "_"


def write_usd(path: str | os.PathLike, mesh: AnimatedMesh) -> None:
    """Write ``.usd``, ``.usda`` or ``.usdc``: metres, y up; the head's motion drives the one joint of a skeleton."""
    pxr = _pxr()
    Usd, UsdGeom, UsdSkel, Vt, Gf = pxr.Usd, pxr.UsdGeom, pxr.UsdSkel, pxr.Vt, pxr.Gf
    stage = Usd.Stage.CreateInMemory()
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    codes = time_codes(mesh.timestamps, mesh.fps)
    stage.SetTimeCodesPerSecond(mesh.fps)
    stage.SetFramesPerSecond(mesh.fps)
    stage.SetStartTimeCode(0)
    stage.SetEndTimeCode(math.ceil(codes[-1]))
    root = UsdSkel.Root.Define(stage, "/performance")
    stage.SetDefaultPrim(root.GetPrim())
    skeleton = UsdSkel.Skeleton.Define(stage, "/performance/skeleton")
    skeleton.CreateJointsAttr(["head"])
    identity = Vt.Matrix4dArray([Gf.Matrix4d(1.0)])
    skeleton.CreateBindTransformsAttr(identity)
    skeleton.CreateRestTransformsAttr(identity)
    names = [prim_name(name) for name in mesh.target_names]
    _write_mesh(pxr, stage, mesh, names)
    _write_animation(pxr, stage, mesh, names, codes)
    binding = UsdSkel.BindingAPI.Apply(skeleton.GetPrim())
    binding.CreateAnimationSourceRel().SetTargets(["/performance/animation"])
    if not stage.Export(os.fspath(path)):
        raise FileFormatError(f"{path}: USD could not write the file")


def _write_mesh(pxr, stage, mesh: AnimatedMesh, names: list[str]) -> None:
    UsdGeom, UsdSkel, Vt = pxr.UsdGeom, pxr.UsdSkel, pxr.Vt
    body = UsdGeom.Mesh.Define(stage, f"/performance/{prim_name(mesh.name)}")
    points = (METRES * mesh.neutral).astype(np.float32)
    body.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(points))
    body.CreateFaceVertexCountsAttr(Vt.IntArray.FromNumpy(np.full(len(mesh.triangles), 3, np.int32)))
    body.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(mesh.triangles.astype(np.int32).ravel()))
    body.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    body.CreateExtentAttr(Vt.Vec3fArray.FromNumpy(np.stack([points.min(axis=0), points.max(axis=0)])))
    if mesh.colours is not None:
        linear = ((mesh.colours / 255) ** 2.2).astype(np.float32)
        body.CreateDisplayColorPrimvar(UsdGeom.Tokens.vertex).Set(Vt.Vec3fArray.FromNumpy(linear))
    binding = UsdSkel.BindingAPI.Apply(body.GetPrim())
    binding.CreateJointIndicesPrimvar(True, 1).Set([0])
    binding.CreateJointWeightsPrimvar(True, 1).Set([1.0])
    binding.CreateSkeletonRel().SetTargets(["/performance/skeleton"])
    binding.CreateBlendShapesAttr(names)
    targets = []
    for name, target in zip(names, mesh.targets, strict=True):
        shape = UsdSkel.BlendShape.Define(stage, f"{body.GetPath()}/{name}")
        moving = np.flatnonzero(np.abs(target).max(axis=1) > 0)
        shape.CreateOffsetsAttr(Vt.Vec3fArray.FromNumpy((METRES * target[moving]).astype(np.float32)))
        shape.CreatePointIndicesAttr(Vt.IntArray.FromNumpy(moving.astype(np.int32)))
        targets.append(shape.GetPath())
    binding.CreateBlendShapeTargetsRel().SetTargets(targets)


def _write_animation(pxr, stage, mesh: AnimatedMesh, names: list[str], codes: np.ndarray) -> None:
    Gf, UsdSkel, Vt = pxr.Gf, pxr.UsdSkel, pxr.Vt
    animation = UsdSkel.Animation.Define(stage, "/performance/animation")
    animation.CreateJointsAttr(["head"])
    animation.CreateBlendShapesAttr(names)
    weights = animation.CreateBlendShapeWeightsAttr()
    translations, rotations = animation.CreateTranslationsAttr(), animation.CreateRotationsAttr()
    animation.CreateScalesAttr(Vt.Vec3hArray([Gf.Vec3h(1, 1, 1)]))
    for frame, (code, turn) in enumerate(zip(codes.tolist(), quaternions(mesh.rigid[:, :3, :3]), strict=True)):
        weights.Set(Vt.FloatArray.FromNumpy(mesh.weights[frame].astype(np.float32)), code)
        place = METRES * mesh.rigid[frame, :3, 3]
        translations.Set(Vt.Vec3fArray([Gf.Vec3f(*map(float, place))]), code)
        x, y, z, w = map(float, turn)
        rotations.Set(Vt.QuatfArray([Gf.Quatf(w, x, y, z)]), code)


def read_usd(path: str | os.PathLike) -> AnimatedMesh:
    """Read back a file of :func:`write_usd`; raises :class:`FileFormatError`."""
    pxr = _pxr()
    Usd, UsdGeom, UsdSkel = pxr.Usd, pxr.UsdGeom, pxr.UsdSkel
    if not os.path.isfile(path):
        raise FileFormatError(f"{path}: no such file")
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
    names = tuple(str(name) for name in animation.GetBlendShapesAttr().Get() or ())
    targets = np.zeros((len(names), len(neutral), 3))
    prim_paths = UsdSkel.BindingAPI(meshes[0]).GetBlendShapeTargetsRel().GetTargets()
    for row, prim_path in zip(targets, prim_paths, strict=True):
        shape = UsdSkel.BlendShape(stage.GetPrimAtPath(prim_path))
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
    return AnimatedMesh(body.GetPrim().GetName(), neutral, triangles, names, targets,
                        weights.reshape(len(codes), len(names)), times, rigid)  # fmt: skip
