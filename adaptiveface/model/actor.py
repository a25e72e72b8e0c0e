"""Save and load the personal rig, ``actor.npz``: everything about a person that tracking needs."""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ..errors import FileFormatError
from ..files.npz import write_npz
from ..files.records import array, arrays, part, read, record
from ..geometry.frame import FEATURE_IDS
from ..geometry.polydata import cloud, expression_weights, surface
from .appearance import Appearance
from .feature_set import FeatureSet, checked_set
from .skin import Skin

if TYPE_CHECKING:
    from ..geometry.polydata import PolyData
    from .face_model import FaceModel

#: A rig of 100,000 vertices and 100 expressions takes half of it.
MAX_BYTES = 256 << 20
#: The detector's landmarks are stored under their own names with this in front.
_LANDMARK = "landmark_"


@record
@dataclass(frozen=True)
class Actor:
    """Neutral face and personal generic expressions of one person (paper, section 3).

    N vertices, T triangles, A expressions; P points of the neutral scan, M identity coefficients.

    ``appearance`` describes how the neutral looks around its features, if they were detected in colour pictures. ``skin``
    describes how the whole face looks in the same pictures. ``landmarks`` are the detector's other landmarks on this mesh. Each
    of the three may be None.
    """

    neutral: np.ndarray = array("N 3", doc="neutral face b0, head frame", unit="mm")
    blendshapes: np.ndarray = array("A N 3", doc="displacements from the neutral, the columns of B", unit="mm")
    triangles: np.ndarray = array("T 3", "i4", "vertex numbers", below="N")
    frontal: np.ndarray = array("N", "b", "the region that deforms")
    expression_names: tuple[str, ...] = array("A", "U", "names of the expressions")
    feature_triangles: np.ndarray = array("40 3", "i4", "corners of the triangle that each 2D feature sits on", below="N")
    feature_weights: np.ndarray = array("40 3", doc="barycentric weights of its place there")
    depth_valid: np.ndarray = array("N", "b", "vertices that may take a depth match; by default `frontal`", optional=True)
    scan_points: np.ndarray = array(
        "P 3", doc="fused neutral scan, head frame", unit="mm", optional=True, default_factory=lambda: np.zeros((0, 3))
    )
    scan_normals: np.ndarray = array("P 3", doc="its unit normals", optional=True, default_factory=lambda: np.zeros((0, 3)))
    identity: np.ndarray = array(
        "M", doc="fitted identity coefficients, standard deviations", optional=True, default_factory=lambda: np.zeros(0)
    )
    feature_ids: np.ndarray = array("40", "i4", "iBUG-68 numbers of the features", default_factory=lambda: FEATURE_IDS)
    appearance: Appearance | None = part(Appearance, "appearance_")
    landmarks: FeatureSet | None = part(FeatureSet, _LANDMARK)
    skin: Skin | None = part(Skin, "skin_", renewed=("slopes", "coherence"))

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
        """The points of the neutral scan as ``pyvista.PolyData``, with the axes of :meth:`mesh`; empty if none were kept."""
        return cloud(self.scan_points, self.scan_normals)

    def save(self, path: str | os.PathLike) -> None:
        """Write ``actor.npz`` (float32), whole or not at all."""
        write_npz(path, arrays(self), compressed=True)

    @classmethod
    def load(cls, path: str | os.PathLike) -> Actor:
        """Read ``actor.npz``; raises :class:`FileFormatError` naming the file and the array."""
        data = read(cls, path, max_bytes=MAX_BYTES, double=True)
        data.setdefault("depth_valid", data["frontal"])
        _check_plausible(path, data)
        if data["appearance"] is not None:
            data["appearance"] = Appearance.checked(path, data["appearance"])
        if data["landmarks"] is not None:
            data["landmarks"] = checked_set(path, data["landmarks"], _LANDMARK)
        if data["skin"] is not None:
            data["skin"] = Skin.checked(path, data["skin"])
        return cls(**data)


def _check_plausible(path: str | os.PathLike, data: dict) -> None:
    """Raise :class:`FileFormatError` for well-formed arrays that do not describe a face in millimetres."""
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
