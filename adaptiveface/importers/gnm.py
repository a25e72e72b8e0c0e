"""GNM Head (Google's Generative aNthropometric Model, version 3): ``gnm_head.npz``.

Fields used, as the model's own code documents them: ``template_vertex_positions`` (V, 3) and ``vertex_identity_basis``
(I, V, 3), ``expression_basis`` (E, V, 3) in metres, ``expression_names`` (E,), ``triangles`` (T, 3), ``vertex_groups``
(G, V) weights with ``vertex_group_names`` (G,). Joints, teeth, tongue and eyeballs are left out.
"""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from ..files.npz import Field, check_indices, load_checked
from ..model.face_model import FaceModel
from .assemble import MAX_BYTES, ForeignModel, assemble, check_size

MM_PER_UNIT = 1000.0
SKIN_GROUPS = ("skin_exterior", "skin")  # the first that the file has
_FIELDS = {
    "template_vertex_positions": Field(("V", 3)),
    "vertex_identity_basis": Field(("I", "V", 3)),
    "expression_basis": Field(("E", "V", 3)),
    "expression_names": Field(("E",), "U", optional=True),
    "triangles": Field(("T", 3), "iu"),
    "vertex_groups": Field(("G", "V"), "f", optional=True),
    "vertex_group_names": Field(("G",), "U", optional=True),
}


def load_gnm(path: str | os.PathLike, feature_vertices=None, identity_modes: int = 100) -> FaceModel:
    """Read a GNM head.

    Its expressions are principal components per region of the face; the generic expressions are both signs of those
    that move the face most. Raises :class:`FileFormatError` naming the file and the reason.
    """
    path = Path(path)
    data = load_checked(path, _FIELDS, max_bytes=MAX_BYTES)
    template = data["template_vertex_positions"]
    check_size(path, len(template), len(data["triangles"]))
    check_indices(path, "triangles", data["triangles"], len(template))
    expressions = data["expression_basis"]
    names = data.get("expression_names", [f"pca{k:03d}" for k in range(len(expressions))])
    foreign = ForeignModel(
        path,
        MM_PER_UNIT * template.astype(float),
        data["triangles"].astype(int),
        (MM_PER_UNIT * data["vertex_identity_basis"][:identity_modes]).astype(np.float32),
        (MM_PER_UNIT * expressions).astype(np.float32),
        tuple(map(str, names)),
        units=False,
        skin=_skin(data),
    )
    return assemble(foreign, feature_vertices)


def _skin(data: dict) -> np.ndarray | None:
    names = [str(n) for n in data.get("vertex_group_names", [])]
    if "vertex_groups" not in data:
        return None
    for group in SKIN_GROUPS:
        if group in names:
            return data["vertex_groups"][names.index(group)] > 0.5
    return None
