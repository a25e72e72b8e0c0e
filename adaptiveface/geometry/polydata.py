"""Meshes and scans as ``pyvista.PolyData``, upright in pyvista's default view; pyvista is imported when one is asked for."""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from ..errors import MissingExtraError, ParameterError
from .mesh import vertex_normals

if TYPE_CHECKING:
    from pyvista import PolyData

#: Where the axes of the head frame go: x out of the face, y to the subject's left, z up. A rotation, no mirror image.
AXES = [2, 0, 1]


def upright(vectors: np.ndarray) -> np.ndarray:
    """Points or vectors (..., 3) of the head frame in the axes of :func:`surface`."""
    return np.ascontiguousarray(np.asarray(vectors, float)[..., AXES])


def surface(vertices: np.ndarray, triangles: np.ndarray, **arrays: np.ndarray | None) -> PolyData:
    """A mesh for pyvista.

    Parameters
    ----------
    vertices : numpy.ndarray
        (N, 3) mm in the head frame (x to the subject's left, y up, z out of the face).
    triangles : numpy.ndarray
        (T, 3) int.
    arrays
        Point data by name: scalars (N,), or vectors (N, 3) in the head frame. None is left out; "_" in a name becomes " ".

    Returns
    -------
    pyvista.PolyData
        In mm, x out of the face, y to the subject's left, z up: pyvista's default view shows the head upright, from its
        left front; ``view_yz()`` looks straight at it. The array ``normals`` (N, 3) holds unit normals.

    Raises
    ------
    MissingExtraError
        pyvista is not installed (the extra ``notebooks``).
    """
    triangles = np.asarray(triangles)
    faces = np.column_stack([np.full(len(triangles), 3), triangles]).astype(np.int64)
    mesh = load_pyvista().PolyData(upright(vertices), faces.ravel())
    return _with_arrays(mesh, vertex_normals(np.asarray(vertices, float), triangles), arrays)


def cloud(points: np.ndarray, normals: np.ndarray, **arrays: np.ndarray | None) -> PolyData:
    """A point cloud for pyvista: points and unit normals (P, 3), head frame, mm; axes and ``arrays`` as in :func:`surface`.

    Raises :class:`MissingExtraError` without pyvista.
    """
    return _with_arrays(load_pyvista().PolyData(upright(points)), normals, arrays)


def expression_weights(names: Sequence[str], weights: Mapping[str, float]) -> np.ndarray:
    """(A,) weights by name, zero for the others; raises :class:`ParameterError` for a name that is not among ``names``."""
    unknown = [name for name in weights if name not in names]
    if unknown:
        raise ParameterError(f"{unknown[0]!r} is no expression here; there are: {', '.join(names)}")
    return np.array([float(weights.get(name, 0.0)) for name in names])


def correctives(shapes: np.ndarray | None) -> dict[str, np.ndarray]:
    """Arrays ``corrective 1`` ... of corrective shapes (K, N, 3), head frame, each scaled so that it moves up to 1 mm."""
    named = {}
    for k, shape in enumerate(() if shapes is None else np.asarray(shapes, float)):
        longest = np.linalg.norm(shape, axis=1).max(initial=0.0)
        named[f"corrective {k + 1}"] = shape / longest if longest > 0 else shape
    return named


def _with_arrays(mesh: PolyData, normals: np.ndarray, arrays: dict[str, np.ndarray | None]) -> PolyData:
    if not mesh.n_points:  # pyvista takes no empty arrays
        return mesh
    mesh["normals"] = upright(normals)
    mesh.point_data.active_normals_name = "normals"
    for name, values in arrays.items():
        if values is not None:
            values = np.asarray(values)
            mesh[name.replace("_", " ")] = upright(values) if values.ndim == 2 else values
    mesh.set_active_scalars(None)
    return mesh


def load_pyvista():
    """Import pyvista, set up for machines without a display and without network, and return it.

    On Linux without a display VTK is told to draw by EGL. Trame's WebAssembly view is left out: at its start it would load
    an archive from the network, and print a line under the cell. Raises :class:`MissingExtraError` without pyvista.
    """
    headless = sys.platform.startswith("linux") and not os.environ.get("DISPLAY")
    if headless and not os.environ.get("VTK_DEFAULT_OPENGL_WINDOW"):  # set but empty, VTK crashes
        os.environ["VTK_DEFAULT_OPENGL_WINDOW"] = "vtkEGLRenderWindow"
    sys.modules.setdefault("trame.widgets.vtklocal", None)
    try:
        import pyvista
    except ImportError:
        raise MissingExtraError('meshes for pyvista need it: python -m pip install "adaptiveface[notebooks]"') from None
    return pyvista
