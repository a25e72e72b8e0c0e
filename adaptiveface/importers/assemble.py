"""Make a :class:`FaceModel` from the arrays of a foreign file: check them, cut out the skin, find features and expressions."""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import scipy.sparse as sp
from scipy.sparse.csgraph import connected_components

from ..errors import FileFormatError, TrackingError, abbreviated
from ..files import read_text
from ..geometry.frame import FEATURE_IDS
from ..model.face_model import FaceModel, embedded_face_model
from .association import associate

MAX_VERTICES, MAX_TRIANGLES, MAX_BYTES = 200_000, 400_000, 2 << 30
MIN_VERTICES = 200
HEAD_WIDTH_MM = (90.0, 400.0)  # range of the mean head's width; beyond it, the unit of length is wrong
PCA_GENERIC = 11  # components that become generic expressions, each with both signs; with jawOpen, these are 23
PCA_SIGMAS = 2.0
NEGLIGIBLE_MM = 1e-3


@dataclass(frozen=True)
class ForeignModel:
    """The arrays of a foreign model, in our units.

    Attributes
    ----------
    path : Path
        The file, for messages.
    mean : (V, 3)
        Average head, mm.
    triangles : (T, 3)
        Vertex numbers.
    identity_modes : (M, V, 3) float32
        Displacements per standard deviation, mm.
    expressions : (E, V, 3) float32
        Displacements, mm.
    names : (E,)
        Names of the expressions.
    units : bool
        Whether the expressions are activations in [0, 1] with ARKit names. Otherwise, they are principal components, per
        standard deviation.
    skin : (V,) bool or None
        With None, the skin is the largest connected part.
    """

    path: Path
    mean: np.ndarray
    triangles: np.ndarray
    identity_modes: np.ndarray
    expressions: np.ndarray
    names: tuple[str, ...]
    units: bool
    skin: np.ndarray | None = None


def assemble(foreign: ForeignModel, feature_vertices=None) -> FaceModel:
    """Make the face model.

    Parameters
    ----------
    foreign : ForeignModel
        The arrays.
    feature_vertices : array-like or path-like, optional
        As for :func:`read_feature_vertices`. By default, the features are found by fitting our own model.

    Raises
    ------
    FileFormatError
        The message names the file and the reason.
    """
    _check(foreign)
    chosen = None if feature_vertices is None else read_feature_vertices(feature_vertices, len(foreign.mean))
    foreign, number = _skin_only(foreign)
    if chosen is not None:
        chosen = number[chosen]
        if (chosen < 0).any():
            raise FileFormatError(f"{foreign.path}: feature_vertices name vertices that are not on the skin")
    try:
        found = associate(foreign.mean, foreign.triangles, chosen)
    except (TrackingError, np.linalg.LinAlgError, RuntimeError) as error:  # RuntimeError: a singular factorisation
        raise FileFormatError(f"{foreign.path}: the mean mesh is not recognised as a face in mm ({error})") from error
    weights, generic_names = _generic(foreign, found.frontal)
    return FaceModel(
        name=foreign.path.name,
        mean=foreign.mean + found.offset,
        triangles=foreign.triangles.astype(np.int32),
        identity_modes=foreign.identity_modes,
        expressions=foreign.expressions,
        expression_names=foreign.names,
        generic_weights=weights,
        generic_names=generic_names,
        frontal=found.frontal,
        depth_valid=found.depth_valid,
        feature_triangles=found.feature_triangles,
        feature_weights=found.feature_weights,
    )


def check_size(path: Path, vertices: int, triangles: int) -> None:
    """Raise :class:`FileFormatError` for sizes that no face model has, before memory is allocated for them."""
    if not MIN_VERTICES <= vertices <= MAX_VERTICES:
        raise FileFormatError(f"{path}: {vertices} vertices; a face model has {MIN_VERTICES} to {MAX_VERTICES}")
    if not MIN_VERTICES <= triangles <= MAX_TRIANGLES:
        raise FileFormatError(f"{path}: {triangles} triangles; a face model has {MIN_VERTICES} to {MAX_TRIANGLES}")


def _check(foreign: ForeignModel) -> None:
    path, n = foreign.path, len(foreign.mean)
    check_size(path, n, len(foreign.triangles))
    for name in ("mean", "identity_modes", "expressions"):
        if not np.isfinite(getattr(foreign, name)).all():
            raise FileFormatError(f"{path}: {name} holds NaN or infinite values")
    if foreign.triangles.min() < 0 or foreign.triangles.max() >= n:
        raise FileFormatError(f"{path}: triangles point outside 0..{n - 1}")
    if len(foreign.identity_modes) == 0 or len(foreign.expressions) == 0:
        raise FileFormatError(f"{path}: no identity modes or no expressions")
    width = np.ptp(foreign.mean[:, 0])
    if not HEAD_WIDTH_MM[0] < width < HEAD_WIDTH_MM[1]:
        raise FileFormatError(f"{path}: the mean head is {width:.3g} mm wide, so its unit of length is not as expected")


def _skin_only(foreign: ForeignModel) -> tuple[ForeignModel, np.ndarray]:
    """The skin without eyeballs, teeth and lashes, and the new number of each old vertex, which is -1 if it is cut away."""
    n = len(foreign.mean)
    skin = _largest_part(foreign.triangles, n) if foreign.skin is None else foreign.skin
    triangles = foreign.triangles[skin[foreign.triangles].all(axis=1)]
    if len(triangles) < MIN_VERTICES:
        raise FileFormatError(f"{foreign.path}: its skin has {len(triangles)} triangles only")
    used = np.unique(triangles)
    number = np.full(n, -1)
    number[used] = np.arange(len(used))
    cut = replace(
        foreign,
        mean=foreign.mean[used].astype(float),
        triangles=number[triangles],
        skin=None,
        identity_modes=np.ascontiguousarray(foreign.identity_modes[:, used], np.float32),
        expressions=np.ascontiguousarray(foreign.expressions[:, used], np.float32),
    )
    return _without_empty(cut), number


def _largest_part(triangles: np.ndarray, n: int) -> np.ndarray:
    rows, columns = triangles.ravel(), np.roll(triangles, 1, axis=1).ravel()
    _, label = connected_components(sp.coo_matrix((np.ones(len(rows), bool), (rows, columns)), (n, n)), directed=False)
    return label == np.bincount(label).argmax()


def _without_empty(foreign: ForeignModel) -> ForeignModel:
    """Leave out the components that move only teeth, tongue or eyeballs, because they would leave the fit undetermined."""
    moving = [
        np.abs(modes).max(axis=(1, 2), initial=0.0) > NEGLIGIBLE_MM for modes in (foreign.identity_modes, foreign.expressions)
    ]
    if foreign.units:
        moving[1][:] = True
    if not (moving[0].any() and moving[1].any()):
        raise FileFormatError(f"{foreign.path}: no identity mode or no expression moves the skin")
    names = tuple(name for name, moves in zip(foreign.names, moving[1], strict=True) if moves)
    return replace(
        foreign, identity_modes=foreign.identity_modes[moving[0]], names=names, expressions=foreign.expressions[moving[1]]
    )


# -- features given by the user -------------------------------------------------------------------------------------


def read_feature_vertices(given, n_vertices: int) -> np.ndarray:
    """Vertex numbers (40,) of the features.

    Parameters
    ----------
    given : array-like or path-like
        40 numbers in the order of ``FEATURE_IDS``, 68 numbers in iBUG's order, or a text file of either.
    n_vertices : int
        Number of the mesh's vertices.

    Raises
    ------
    FileFormatError
        There are more or fewer numbers, or one points outside the mesh.
    """
    name = "feature_vertices"
    if isinstance(given, (str, os.PathLike)):
        name = os.fspath(given)
        try:
            given = [int(word) for word in read_text(given, 100_000).replace(",", " ").split()]
        except FileFormatError:
            raise
        except ValueError as error:
            raise FileFormatError(f"{name}: not a text file of vertex numbers ({abbreviated(error)})") from error
    numbers = np.asarray(given)
    if numbers.shape not in ((40,), (68,)) or numbers.dtype.kind not in "iu":
        raise FileFormatError(f"{name}: {numbers.shape} {numbers.dtype}; 40 or 68 vertex numbers are expected")
    numbers = numbers if len(numbers) == 40 else numbers[FEATURE_IDS]
    if numbers.min() < 0 or numbers.max() >= n_vertices:
        raise FileFormatError(f"{name}: vertex numbers point outside 0..{n_vertices - 1}")
    return numbers.astype(int)


# -- generic expressions --------------------------------------------------------------------------------------------


def _generic(foreign: ForeignModel, frontal: np.ndarray) -> tuple[np.ndarray, tuple[str, ...]]:
    """Weights (A, E) and names of the generic expressions."""
    if foreign.units:
        return arkit_generic(foreign.names, foreign.path)
    return component_generic(foreign.expressions, foreign.names, frontal)


def arkit_generic(names: tuple[str, ...], path) -> tuple[np.ndarray, tuple[str, ...]]:
    """Weights (A, E) and names of our own model's generic expressions, as mixtures of units with ARKit names.

    Expressions whose units are all missing are left out. A unit without a side (browInnerUp, cheekPuff) may be split into a
    Left and a Right half. Raises :class:`FileFormatError` if no unit is known.
    """
    own = embedded_face_model()
    column = {name: k for k, name in enumerate(names)}
    rows, kept = [], []
    for generic, weights in zip(own.generic_names, own.generic_weights, strict=True):
        row = np.zeros(len(names))
        for k in np.flatnonzero(weights):
            unit = own.expression_names[k]
            parts = [unit] if unit in column else [p for p in (unit + "Left", unit + "Right") if p in column]
            row[[column[p] for p in parts]] += weights[k]
        if row.any():
            rows.append(row)
            kept.append(generic)
    if not rows:
        raise FileFormatError(f"{path}: none of the expressions has an ARKit name ({', '.join(names[:3])}, ...)")
    return np.array(rows), tuple(kept)


def component_generic(expressions, names, frontal: np.ndarray) -> tuple[np.ndarray, tuple[str, ...]]:
    """Weights (A, E) and names of generic expressions made of principal components.

    They are the components that move the face most, with both signs, at 2 standard deviations, because coefficients lie in
    [0, 1]. FLAME's jawOpen is no component, and is used unchanged.
    """
    rows, kept = [], []
    energy = (expressions[:, frontal].astype(float) ** 2).sum(axis=(1, 2))
    unit = [k for k, name in enumerate(names) if name == "jawOpen"]
    strongest = [k for k in np.argsort(-energy, kind="stable") if k not in unit and energy[k] > 0][:PCA_GENERIC]
    for k, sign, label in [(k, 1.0, "") for k in unit] + [
        (k, s * PCA_SIGMAS, label) for k in sorted(strongest) for s, label in ((1, "+"), (-1, "-"))
    ]:
        row = np.zeros(len(names))
        row[k] = sign
        rows.append(row)
        kept.append(names[k] + label)
    return np.array(rows), tuple(kept)
