"""Write USD with blend shapes (UsdSkel) through ``usd-core``, the extra ``usd``."""

from __future__ import annotations

import errno
import itertools
import math
import os
import re
import shutil
import tempfile
from collections.abc import Collection, Sequence
from pathlib import Path

import numpy as np

from ..errors import MissingExtraError
from ..files import replacing
from ..formats.quaternions import quaternions
from ..formats.surface import linear_colours, normal_changes, unit_normals
from .animation import METRES, SKIN, AnimatedMesh


def _pxr():
    try:
        import pxr.Gf
        import pxr.Kind
        import pxr.Sdf
        import pxr.Usd
        import pxr.UsdGeom
        import pxr.UsdShade
        import pxr.UsdSkel
        import pxr.UsdUtils
        import pxr.Vt
    except ImportError as error:
        raise MissingExtraError(f"USD needs usd-core: python -m pip install 'adaptiveface[usd]' ({error})") from None
    return pxr


def prim_name(name: str) -> str:
    """``name`` as a name that USD allows: letters, digits and underscores, without a digit at the start."""
    return re.sub(r"^(?=\d)|\W", "_", name, flags=re.ASCII) or "_"


def prim_names(names: Sequence[str], taken: Collection[str] = ()) -> list[str]:
    """:func:`prim_name` of every name. Names that would collide with each other or with ``taken`` get a number."""
    out: list[str] = []
    for name in map(prim_name, names):
        numbered = (f"{name}_{k}" for k in itertools.count(2))
        out.append(next(n for n in itertools.chain([name], numbered) if n not in out and n not in taken))
    return out


def write_usd(path: str | os.PathLike, mesh: AnimatedMesh) -> None:
    """Write an animated mesh as ``.usd``, ``.usda``, ``.usdc`` or as a ``.usdz`` package, whole or not at all.

    Lengths are metres, and y points up. The head's motion drives the only joint of a skeleton, and the median position of the
    head is the origin. The shapes have normals. The surface is a UsdPreviewSurface with the mesh's colours. Time codes are
    frames.

    Raises
    ------
    MissingExtraError
        usd-core is not installed.
    AdaptiveFaceError
        The file cannot be written.
    """
    stage = _stage(_pxr(), mesh)
    with replacing(path) as temporary:
        if Path(path).suffix.lower() == ".usdz":
            _write_package(stage, temporary)
        else:
            _export(stage, temporary)


def _export(stage, path: Path) -> None:
    """Write the file and read it back, because USD may report success on a full disk."""
    try:
        written = stage.Export(os.fspath(path))
    except Exception:  # pxr.Tf.ErrorException, whose text is about USD's own source
        written = False
    if not written or not _complete(path):
        raise _failed(path)


def _write_package(stage, path: Path) -> None:
    """Write a package as Apple's AR Quick Look expects it: a .usdc file in an uncompressed zip."""
    pxr = _pxr()
    with tempfile.TemporaryDirectory() as folder:
        layer = Path(folder) / "performance.usdc"
        _export(stage, layer)
        if not pxr.UsdUtils.CreateNewARKitUsdzPackage(pxr.Sdf.AssetPath(os.fspath(layer)), os.fspath(path)):
            raise _failed(path)
    if not _complete(path):
        raise _failed(path)


def _failed(path: Path) -> OSError:
    """The error of a failed write. USD gives no reason: a disk with less than 1 MiB left counts as full."""
    full = shutil.disk_usage(path.parent).free < 1 << 20
    return OSError(errno.ENOSPC, os.strerror(errno.ENOSPC)) if full else OSError(errno.EIO, "USD failed")


def _complete(path: Path) -> bool:
    """Whether a file that was just written can be opened and holds the animation, which is written last."""
    try:
        stage = _pxr().Usd.Stage.Open(os.fspath(path))
        return bool(stage.GetPrimAtPath("/performance/animation"))
    except Exception:  # pxr.Tf.ErrorException
        return False


def _stage(pxr, mesh: AnimatedMesh):
    Usd, UsdGeom, UsdSkel, Vt, Gf = pxr.Usd, pxr.UsdGeom, pxr.UsdSkel, pxr.Vt, pxr.Gf
    stage = Usd.Stage.CreateInMemory()
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    stage.SetTimeCodesPerSecond(mesh.fps)
    stage.SetFramesPerSecond(mesh.fps)
    stage.SetStartTimeCode(0)
    stage.SetEndTimeCode(math.ceil(mesh.codes[-1]))
    root = UsdSkel.Root.Define(stage, "/performance")
    pxr.Usd.ModelAPI(root).SetKind(pxr.Kind.Tokens.component)
    UsdGeom.XformCommonAPI(root).SetTranslate(Gf.Vec3d(*map(float, -METRES * mesh.centre)))
    stage.SetDefaultPrim(root.GetPrim())
    skeleton = UsdSkel.Skeleton.Define(stage, "/performance/skeleton")
    skeleton.CreateJointsAttr(["head"])
    identity = Vt.Matrix4dArray([Gf.Matrix4d(1.0)])
    skeleton.CreateBindTransformsAttr(identity)
    skeleton.CreateRestTransformsAttr(identity)
    names = prim_names(mesh.target_names)
    body = _write_mesh(pxr, stage, mesh, names)
    UsdGeom.Scope.Define(stage, "/performance/materials")
    _write_material(pxr, stage, mesh, body, "skin")
    weights = mesh.weights
    if mesh.inside is not None:  # the one animation moves both meshes
        more = prim_names(mesh.inside.target_names, taken=names)
        inside = _write_mesh(pxr, stage, mesh.inside, more, taken=(body.GetPrim().GetName(),))
        _write_material(pxr, stage, mesh.inside, inside, "insides")
        names, weights = names + more, np.column_stack([weights, mesh.inside.weights])
    _write_animation(pxr, stage, mesh, names, weights)
    binding = UsdSkel.BindingAPI.Apply(skeleton.GetPrim())
    binding.CreateAnimationSourceRel().SetTargets(["/performance/animation"])
    return stage


def _write_mesh(pxr, stage, mesh: AnimatedMesh, names: list[str], taken: tuple[str, ...] = ()):
    UsdGeom, UsdSkel, Vt = pxr.UsdGeom, pxr.UsdSkel, pxr.Vt
    name = prim_names([mesh.name], taken=("skeleton", "animation", "materials", *taken))[0]
    body = UsdGeom.Mesh.Define(stage, f"/performance/{name}")
    points = (METRES * mesh.neutral).astype(np.float32)
    normals = unit_normals(mesh.neutral, mesh.triangles)
    body.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(points))
    body.CreateNormalsAttr(Vt.Vec3fArray.FromNumpy(normals))
    body.SetNormalsInterpolation(UsdGeom.Tokens.vertex)
    body.CreateFaceVertexCountsAttr(Vt.IntArray.FromNumpy(np.full(len(mesh.triangles), 3, np.int32)))
    body.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(mesh.triangles.astype(np.int32).ravel()))
    body.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    body.CreateDoubleSidedAttr(True)
    body.CreateExtentAttr(Vt.Vec3fArray.FromNumpy(np.stack([points.min(axis=0), points.max(axis=0)])))
    binding = UsdSkel.BindingAPI.Apply(body.GetPrim())
    binding.CreateJointIndicesPrimvar(True, 1).Set([0])
    binding.CreateJointWeightsPrimvar(True, 1).Set([1.0])
    binding.CreateSkeletonRel().SetTargets(["/performance/skeleton"])
    binding.CreateBlendShapesAttr(names)
    targets = []
    for label, name, target in zip(mesh.target_names, names, mesh.targets, strict=True):
        shape = UsdSkel.BlendShape.Define(stage, f"{body.GetPath()}/{name}")
        turned = normal_changes(mesh.neutral, target, mesh.triangles, normals)
        moving = np.flatnonzero((target != 0).any(axis=1) | turned.any(axis=1))
        shape.CreateOffsetsAttr(Vt.Vec3fArray.FromNumpy((METRES * target[moving]).astype(np.float32)))
        shape.CreateNormalOffsetsAttr(Vt.Vec3fArray.FromNumpy(turned[moving]))
        shape.CreatePointIndicesAttr(Vt.IntArray.FromNumpy(moving.astype(np.int32)))
        if name != label:
            shape.GetPrim().SetDisplayName(label)
        targets.append(shape.GetPath())
    binding.CreateBlendShapeTargetsRel().SetTargets(targets)
    return body


def _write_material(pxr, stage, mesh: AnimatedMesh, body, name: str) -> None:
    """Define a surface with the colours of the vertices, which ``displayColor`` holds, or with one colour."""
    UsdGeom, UsdShade, Sdf, Gf, Vt = pxr.UsdGeom, pxr.UsdShade, pxr.Sdf, pxr.Gf, pxr.Vt
    path = f"/performance/materials/{name}"
    material = UsdShade.Material.Define(stage, path)
    surface = UsdShade.Shader.Define(stage, f"{path}/surface")
    surface.CreateIdAttr("UsdPreviewSurface")
    surface.CreateInput("roughness", Sdf.ValueTypeNames.Float).Set(0.6)
    surface.CreateInput("metallic", Sdf.ValueTypeNames.Float).Set(0.0)
    colour = surface.CreateInput("diffuseColor", Sdf.ValueTypeNames.Color3f)
    if mesh.colours is None:
        skin = Gf.Vec3f(*map(float, linear_colours(SKIN)))
        colour.Set(skin)
        body.CreateDisplayColorPrimvar(UsdGeom.Tokens.constant).Set(Vt.Vec3fArray([skin]))
    else:
        linear = linear_colours(mesh.colours).astype(np.float32)
        body.CreateDisplayColorPrimvar(UsdGeom.Tokens.vertex).Set(Vt.Vec3fArray.FromNumpy(linear))
        reader = UsdShade.Shader.Define(stage, f"{path}/colours")
        reader.CreateIdAttr("UsdPrimvarReader_float3")
        reader.CreateInput("varname", Sdf.ValueTypeNames.String).Set("displayColor")
        colour.ConnectToSource(reader.CreateOutput("result", Sdf.ValueTypeNames.Float3))
    material.CreateSurfaceOutput().ConnectToSource(surface.ConnectableAPI(), "surface")
    UsdShade.MaterialBindingAPI.Apply(body.GetPrim()).Bind(material)


def _write_animation(pxr, stage, mesh: AnimatedMesh, names: list[str], amounts: np.ndarray) -> None:
    Gf, UsdSkel, Vt = pxr.Gf, pxr.UsdSkel, pxr.Vt
    animation = UsdSkel.Animation.Define(stage, "/performance/animation")
    animation.CreateJointsAttr(["head"])
    animation.CreateBlendShapesAttr(names)
    weights = animation.CreateBlendShapeWeightsAttr()
    translations, rotations = animation.CreateTranslationsAttr(), animation.CreateRotationsAttr()
    animation.CreateScalesAttr(Vt.Vec3hArray([Gf.Vec3h(1, 1, 1)]))
    turns = quaternions(mesh.head_pose[:, :3, :3])
    for frame, (code, turn) in enumerate(zip(map(float, mesh.codes), turns, strict=True)):
        weights.Set(Vt.FloatArray.FromNumpy(amounts[frame].astype(np.float32)), code)
        place = METRES * mesh.head_pose[frame, :3, 3]
        translations.Set(Vt.Vec3fArray([Gf.Vec3f(*map(float, place))]), code)
        x, y, z, w = map(float, turn)
        rotations.Set(Vt.QuatfArray([Gf.Quatf(w, x, y, z)]), code)
