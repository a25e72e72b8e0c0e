"""Define the statistical face model: mean head, identity modes, expression units and features (paper, section 3).

Shapes: V vertices, T triangles, M identity modes, E expression units, A generic expressions, F = 40 features,
Q eyeball vertices. Millimetres; head frame with x left-right (the subject's left is +x), y up, z out of the face.
"""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from functools import lru_cache
from importlib.resources import files

import numpy as np

from ..files.npz import write_npz
from ..files.records import array, arrays, read, record
from ..geometry.frame import FEATURE_IDS
from .feature_set import FeatureSet, landmark_set


@record
@dataclass(frozen=True)
class FaceModel:
    """A linear face model on a tracking mesh. All importers of other models make one.

    ``landmarks`` are the detector's other landmarks on this mesh, or None.
    """

    name: str
    mean: np.ndarray = array("V 3", doc="average head", unit="mm")
    triangles: np.ndarray = array("T 3", "i4", "vertex numbers", below="V")
    identity_modes: np.ndarray = array("M V 3", doc="displacements per standard deviation", unit="mm")
    expressions: np.ndarray = array("E V 3", doc="displacements at full activation", unit="mm")
    expression_names: tuple[str, ...] = array("E", "U", "names of the expression units")
    generic_weights: np.ndarray = array("A E", doc="generic expressions of section 3 as mixtures of the units")
    generic_names: tuple[str, ...] = array("A", "U", "names of the generic expressions")
    frontal: np.ndarray = array("V", "b", "the region that deforms")
    depth_valid: np.ndarray = array("V", "b", "vertices that may take a depth match: no inner lips, lid rims, hidden skin")
    feature_triangles: np.ndarray = array("40 3", "i4", "corners of the triangle that each 2D feature sits on", below="V")
    feature_weights: np.ndarray = array("40 3", doc="barycentric weights of its place there")
    mirror: np.ndarray | None = array("V", "i4", "vertex on the other side", below="V", optional=True, default=None)
    eye_mean: np.ndarray | None = array("Q 3", doc="eyeballs, for pictures only", unit="mm", optional=True, default=None)
    eye_modes: np.ndarray | None = array(
        "M Q 3", doc="their displacements per standard deviation", unit="mm", optional=True, default=None
    )
    eye_triangles: np.ndarray | None = array("U 3", "i4", "their vertex numbers", below="Q", optional=True, default=None)
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
    data = read(FaceModel, path, max_bytes=1 << 30, double=True)
    # Stored in float32: make the barycentric weights sum to one again.
    data["feature_weights"] /= data["feature_weights"].sum(axis=1, keepdims=True)
    return FaceModel(name=os.path.basename(path), **data)


def save_face_model(path: str | os.PathLike, model: FaceModel) -> None:
    """Write a model, such as an imported one, in this package's npz layout (float32). :func:`load_face_model` reads it."""
    write_npz(path, arrays(model), compressed=True)


@lru_cache(maxsize=1)
def embedded_face_model() -> FaceModel:
    """The model that ships with the package (CC0; made by ``data_synth/build_face_model.py``)."""
    return replace(load_face_model(str(files("adaptiveface") / "assets" / "face_model.npz")), landmarks=landmark_set())
