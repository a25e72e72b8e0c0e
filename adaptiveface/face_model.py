"""The statistical face model: mean head, identity modes, expression units, features (paper, section 3).

Shapes: V vertices, T triangles, M identity modes, E expression units, A generic expressions, F = 40 features,
Q eyeball vertices. Millimetres; head frame with x left-right (the subject's left is +x), y up, z out of the face.
"""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from functools import lru_cache
from importlib.resources import files

import numpy as np

from .feature_set import FeatureSet, landmark_set
from .files import replacing
from .frame import FEATURE_IDS
from .npz import Field, check_indices, load_checked

_FIELDS = {
    "mean": Field(("V", 3)),
    "triangles": Field(("T", 3), "iu"),
    "identity_modes": Field(("M", "V", 3)),
    "expressions": Field(("E", "V", 3)),
    "expression_names": Field(("E",), "U"),
    "generic_weights": Field(("A", "E")),
    "generic_names": Field(("A",), "U"),
    "frontal": Field(("V",), "b"),
    "depth_valid": Field(("V",), "b"),
    "feature_triangles": Field((40, 3), "iu"),
    "feature_weights": Field((40, 3)),
    "mirror": Field(("V",), "iu", optional=True),
    "eye_mean": Field(("Q", 3), optional=True),
    "eye_modes": Field(("M", "Q", 3), optional=True),
    "eye_triangles": Field(("U", 3), "iu", optional=True),
}


@dataclass(frozen=True)
class FaceModel:
    """A linear face model on one tracking mesh; the interface that the importers of other models share.

    mean (V, 3) mm; triangles (T, 3) int32; identity_modes (M, V, 3) mm per standard deviation; expressions (E, V, 3)
    displacements mm at full activation; generic_weights (A, E): the generic expressions of section 3 as mixtures of the
    units; frontal (V,) bool: the region that deforms; depth_valid (V,) bool: vertices that may take a depth
    correspondence (not inner lips, lid rims, hidden skin); feature_triangles (40, 3), feature_weights (40, 3): where
    the 2D features of ``frame.FEATURE_IDS`` sit on the surface. Optional: mirror (V,) the vertex on the other side;
    eye_mean (Q, 3), eye_modes (M, Q, 3), eye_triangles (U, 3): eyeballs, for pictures only; landmarks: the detector's
    other landmarks on this mesh.
    """

    name: str
    mean: np.ndarray
    triangles: np.ndarray
    identity_modes: np.ndarray
    expressions: np.ndarray
    expression_names: tuple[str, ...]
    generic_weights: np.ndarray
    generic_names: tuple[str, ...]
    frontal: np.ndarray
    depth_valid: np.ndarray
    feature_triangles: np.ndarray
    feature_weights: np.ndarray
    mirror: np.ndarray | None = None
    eye_mean: np.ndarray | None = None
    eye_modes: np.ndarray | None = None
    eye_triangles: np.ndarray | None = None
    landmarks: FeatureSet | None = None

    @property
    def feature_ids(self) -> np.ndarray:
        """(40,) int32 iBUG-68 numbers of the features."""
        return FEATURE_IDS

    @property
    def generic_expressions(self) -> np.ndarray:
        """(A, V, 3) mm: the FACS-inspired generic expressions of the average head (paper: A = 23)."""
        return np.tensordot(self.generic_weights, self.expressions, axes=1)

    def neutral(self, identity: np.ndarray) -> np.ndarray:
        """(V, 3) neutral head of identity coefficients (m,), m <= M, in standard deviations."""
        return self.mean + np.tensordot(identity, self.identity_modes[: len(identity)], axes=1)

    def eyes(self, identity: np.ndarray) -> np.ndarray | None:
        """(Q, 3) eyeball vertices of identity coefficients (m,), or None."""
        if self.eye_mean is None or self.eye_modes is None:
            return None
        return self.eye_mean + np.tensordot(identity, self.eye_modes[: len(identity)], axes=1)


def load_face_model(path: str | os.PathLike) -> FaceModel:
    """Read a model in this package's npz layout; raises :class:`FileFormatError` naming what is wrong."""
    data = load_checked(path, _FIELDS, max_bytes=1 << 30)
    n = len(data["mean"])
    for name in ("triangles", "feature_triangles", "mirror"):
        if name in data:
            check_indices(path, name, data[name], n)
            data[name] = data[name].astype(np.int32)
    if "eye_triangles" in data:
        check_indices(path, "eye_triangles", data["eye_triangles"], len(data["eye_mean"]))
        data["eye_triangles"] = data["eye_triangles"].astype(np.int32)
    for name, array in data.items():
        if array.dtype.kind == "f":
            data[name] = array.astype(float)
    # Stored in float32: make the barycentric weights sum to one again.
    data["feature_weights"] /= data["feature_weights"].sum(axis=1, keepdims=True)
    for name in ("expression_names", "generic_names"):
        data[name] = tuple(str(s) for s in data[name])
    return FaceModel(name=os.path.basename(path), **data)


def save_face_model(path: str | os.PathLike, model: FaceModel) -> None:
    """Write a model, an imported one say, in this package's npz layout (float32; read by :func:`load_face_model`)."""
    arrays = {name: np.asarray(getattr(model, name)) for name in _FIELDS if getattr(model, name) is not None}
    with replacing(path) as temporary, open(temporary, "wb") as file:
        np.savez_compressed(file, **{k: a.astype(np.float32) if a.dtype.kind == "f" else a for k, a in arrays.items()})


@lru_cache(maxsize=1)
def embedded_face_model() -> FaceModel:
    """The model that ships with the package (CC0; made by ``data_synth/build_face_model.py``)."""
    return replace(load_face_model(str(files("adaptiveface") / "assets" / "face_model.npz")), landmarks=landmark_set())
