"""The personal rig: everything about one person that tracking needs, saved and loaded as ``actor.npz``."""

from __future__ import annotations

import os
from dataclasses import dataclass, field, fields, replace
from typing import TYPE_CHECKING

import numpy as np

from .appearance import FIELDS as APPEARANCE_FIELDS
from .appearance import Appearance
from .errors import FileFormatError
from .feature_set import FIELDS as FEATURE_FIELDS
from .feature_set import FeatureSet, from_arrays
from .files import replacing
from .frame import FEATURE_IDS, LANDMARKS
from .npz import Field, check_indices, load_checked
from .polydata import cloud, expression_weights, surface

if TYPE_CHECKING:
    from .face_model import FaceModel
    from .polydata import PolyData

#: A rig of 100,000 vertices and 100 expressions has half of it.
MAX_BYTES = 256 << 20
#: A set of landmarks is stored under its own names with this in front.
_LANDMARK = "landmark_"
_LANDMARK_FIELDS = {_LANDMARK + name: replace(entry, optional=True) for name, entry in FEATURE_FIELDS.items()}
_FIELDS = {
    "neutral": Field(("N", 3)),
    "blendshapes": Field(("A", "N", 3)),
    "triangles": Field(("T", 3), "iu"),
    "frontal": Field(("N",), "b"),
    "expression_names": Field(("A",), "U"),
    "feature_triangles": Field((40, 3), "iu"),
    "feature_weights": Field((40, 3)),
    "feature_ids": Field((40,), "iu"),
    "scan_points": Field(("P", 3), optional=True),
    "scan_normals": Field(("P", 3), optional=True),
    "identity": Field(("M",), optional=True),
    "depth_valid": Field(("N",), "b", optional=True),
    **APPEARANCE_FIELDS,
    **_LANDMARK_FIELDS,
}


@dataclass(frozen=True)
class Actor:
    """Neutral face and personal generic expressions of one person (paper, section 3).

    neutral (N, 3) mm, head frame: b0; blendshapes (A, N, 3) mm, displacements from the neutral: the columns of B;
    triangles (T, 3) int32; frontal (N,) bool: the region that deforms; depth_valid (N,) bool: vertices that may take a
    depth correspondence; expression_names (A,); feature_triangles (40, 3), feature_weights (40, 3): the 2D features on
    the surface; scan_points, scan_normals (P, 3): the fused neutral scan; identity (M,): fitted coefficients;
    appearance: how the neutral looks around its features, where they were detected in colour pictures; landmarks: the
    detector's other landmarks on this mesh, or None.
    """

    neutral: np.ndarray
    blendshapes: np.ndarray
    triangles: np.ndarray
    frontal: np.ndarray
    expression_names: tuple[str, ...]
    feature_triangles: np.ndarray
    feature_weights: np.ndarray
    depth_valid: np.ndarray
    scan_points: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    scan_normals: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    identity: np.ndarray = field(default_factory=lambda: np.zeros(0))
    feature_ids: np.ndarray = field(default_factory=lambda: FEATURE_IDS)
    appearance: Appearance | None = None
    landmarks: FeatureSet | None = None

    @classmethod
    def untransferred(cls, model: FaceModel, neutral: np.ndarray) -> Actor:
        """The rig of a known neutral (N, 3) mm with the model's own expressions, for faces that are rendered from it."""
        return cls(
            neutral,
            model.generic_expressions,
            model.triangles,
            model.frontal,
            model.generic_names,
            model.feature_triangles,
            model.feature_weights,
            model.depth_valid,
        )

    @property
    def feature_vertices(self) -> np.ndarray:
        """(40,) int32: the vertex nearest to each feature."""
        return self.feature_triangles[np.arange(len(self.feature_triangles)), self.feature_weights.argmax(axis=1)]

    def mesh(self, **weights: float) -> PolyData:
        """The neutral face plus expressions as ``pyvista.PolyData`` in mm: ``actor.mesh(jawOpen=0.7)``.

        Axes: x out of the face, y to the subject's left, z up. Arrays: ``displacement`` (N, 3) from the neutral, its length
        ``distance`` (N,), ``normals`` (N, 3). Raises :class:`ParameterError` for a name that is no expression, and
        :class:`MissingExtraError` without pyvista.
        """
        x = expression_weights(self.expression_names, weights)
        moved = np.tensordot(x, self.blendshapes, axes=1)
        return surface(self.neutral + moved, self.triangles, displacement=moved, distance=np.linalg.norm(moved, axis=1))

    def scan_mesh(self) -> PolyData:
        """The points of the neutral scan as ``pyvista.PolyData``, axes as in :meth:`mesh`; empty where none were kept."""
        return cloud(self.scan_points, self.scan_normals)

    def save(self, path: str | os.PathLike) -> None:
        """Write ``actor.npz`` (float32), whole or not at all."""
        apart = ("appearance", "landmarks")
        known = {entry.name: getattr(self, entry.name) for entry in fields(self) if entry.name not in apart}
        known |= self.appearance.arrays() if self.appearance else {}
        if self.landmarks is not None:
            known |= {_LANDMARK + name: getattr(self.landmarks, name) for name in FEATURE_FIELDS}
        arrays = {}
        for name, value in known.items():
            value = np.asarray(value)
            arrays[name] = value.astype(np.float32) if value.dtype.kind == "f" else value
        with replacing(path) as temporary, open(temporary, "wb") as stream:
            np.savez_compressed(stream, **arrays)

    @classmethod
    def load(cls, path: str | os.PathLike) -> Actor:
        """Read ``actor.npz``; raises :class:`FileFormatError` naming the file and the array."""
        data = load_checked(path, _FIELDS, max_bytes=MAX_BYTES)
        n = len(data["neutral"])
        for name in ("triangles", "feature_triangles", *({"appearance_triangles", "landmark_triangles"} & set(data))):
            check_indices(path, name, data[name], n)
            data[name] = data[name].astype(np.int32)
        for name, array in data.items():
            if array.dtype.kind == "f":
                data[name] = array.astype(float)
        data["expression_names"] = tuple(str(s) for s in data["expression_names"])
        data.setdefault("depth_valid", data["frontal"])
        _check_plausible(path, data)
        appearance, landmarks = Appearance.take(path, data), _take_landmarks(path, data)
        return cls(**data, appearance=appearance, landmarks=landmarks)


def _take_landmarks(path: str | os.PathLike, data: dict) -> FeatureSet | None:
    """The stored landmarks, taken out of ``data``; raises :class:`FileFormatError` where they are not whole."""
    found = {name: data.pop(_LANDMARK + name) for name in FEATURE_FIELDS if _LANDMARK + name in data}
    if not found:
        return None
    missing = [_LANDMARK + name for name in FEATURE_FIELDS if name not in found]
    if missing:
        raise FileFormatError(f"{path}: landmarks without the array {missing[0]!r}")
    weights, deviation, yaw = found["weights"], found["deviation"], found["yaw"]
    if len(weights) and (weights.min() < -0.01 or np.abs(weights.sum(axis=1) - 1).max() > 0.01):
        raise FileFormatError(f"{path}: rows of '{_LANDMARK}weights' are not barycentric (0 to 1, sum 1)")
    if min(deviation.min(initial=1.0), found["personal"].min(initial=1.0)) <= 0:
        raise FileFormatError(f"{path}: '{_LANDMARK}deviation' or '{_LANDMARK}personal' holds a value that is not positive")
    if not yaw.size or (np.diff(yaw) <= 0).any() or np.abs(yaw).max() > 180:
        raise FileFormatError(f"{path}: '{_LANDMARK}yaw' does not rise from -180 to 180 degrees")
    if len(found["ids"]) and not 0 <= found["ids"].min() <= found["ids"].max() < LANDMARKS:
        raise FileFormatError(f"{path}: '{_LANDMARK}ids' are not numbers of landmarks, 0 to {LANDMARKS - 1}")
    return from_arrays(found)


def _check_plausible(path: str | os.PathLike, data: dict) -> None:
    """Raise :class:`FileFormatError` for arrays that are well formed but describe no face in millimetres."""
    if not (data["frontal"].any() and len(data["triangles"]) and len(data["blendshapes"])):
        raise FileFormatError(f"{path}: no frontal vertices, no triangles or no blendshapes")
    size = float(np.ptp(data["neutral"][data["frontal"]], axis=0).max())
    if not 50 <= size <= 1000:
        raise FileFormatError(f"{path}: the face in 'neutral' is {size:g} mm across; 50 to 1000 mm are expected")
    if np.abs(data["neutral"]).max() > 10_000 or np.abs(data["blendshapes"]).max() > 500:
        raise FileFormatError(f"{path}: 'neutral' or 'blendshapes' hold lengths that no head has (millimetres?)")
    weights = data["feature_weights"]
    if weights.min() < -0.01 or np.abs(weights.sum(axis=1) - 1).max() > 0.01:
        raise FileFormatError(f"{path}: rows of 'feature_weights' are not barycentric (0 to 1, sum 1)")
