"""FLAME (Li et al. 2017, "Learning a model of facial shape and expression from 4D scans"), as an ``.npz`` export.

``v_template`` (V, 3) and ``shapedirs`` (V, 3, 400) metres per standard deviation (300 identity, then 100 expression),
``f`` (T, 3). With ``weights`` (V, 5) and ``J_regressor`` (5, V) the jaw joint becomes a jawOpen unit.
"""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from ..errors import FileFormatError
from ..files import open_regular
from ..files.npz import Field, check_indices, load_checked
from ..geometry.mesh import rotation_vector_matrix
from ..model.face_model import FaceModel
from .assemble import MAX_BYTES, ForeignModel, assemble, check_size

MM_PER_UNIT = 1000.0
IDENTITY_COMPONENTS = 300
JAW_JOINT = 2
JAW_RADIANS = 0.4
_FIELDS = {
    "v_template": Field(("V", 3)),
    "shapedirs": Field(("V", 3, "K")),
    "f": Field(("T", 3), "iu"),
    "weights": Field(("V", "J"), optional=True),
    "J_regressor": Field(("J", "V"), optional=True),
    "posedirs": Field(("V", 3, "P"), optional=True),
}
#: Pickles run code while they are read; this line is for an environment that can be thrown away.
CONVERSION = (
    "python -c \"import pickle, numpy as np; d = pickle.load(open('{name}', 'rb'), encoding='latin1'); "
    "np.savez('{stem}.npz', **{{k: np.array(d[k].todense() if hasattr(d[k], 'todense') else d[k]) for k in "
    "('v_template', 'shapedirs', 'posedirs', 'f', 'weights', 'J_regressor')}})\""
)


def load_flame(
    path: str | os.PathLike,
    feature_vertices=None,
    identity_modes: int = 100,
    expression_modes: int = 60,
    identity_components: int = IDENTITY_COMPONENTS,
) -> FaceModel:
    """Read a FLAME model exported as npz.

    ``identity_components``: how many of the leading ``shapedirs`` are identity (300 in FLAME 2016 to 2023). The
    expressions are pca000, pca001, ... and, where the skinning is there, jawOpen (0.4 rad about the jaw joint). Raises
    :class:`FileFormatError` naming the file and the reason; pickles are refused with the line that converts them.
    """
    path = Path(path)
    refuse_pickle(path)
    data = load_checked(path, _FIELDS, max_bytes=MAX_BYTES)
    template, directions = data["v_template"], data["shapedirs"]
    check_size(path, len(template), len(data["f"]))
    check_indices(path, "f", data["f"], len(template))
    if directions.shape[2] <= identity_components:
        raise FileFormatError(
            f"{path}: 'shapedirs' has {directions.shape[2]} components; more than {identity_components} are expected, "
            "expressions last (identity_components= sets how many are identity)"
        )
    identity = _modes(directions[:, :, : min(identity_modes, identity_components)])
    expressions = _modes(directions[:, :, identity_components : identity_components + expression_modes])
    names = [f"pca{k:03d}" for k in range(len(expressions))]
    if "weights" in data and "J_regressor" in data and data["weights"].shape[1] > JAW_JOINT:
        expressions = np.concatenate([expressions, _jaw_open(data)[None].astype(np.float32)])
        names.append("jawOpen")
    foreign = ForeignModel(
        path, MM_PER_UNIT * template.astype(float), data["f"].astype(int), identity, expressions, tuple(names), units=False
    )
    return assemble(foreign, feature_vertices)


def refuse_pickle(path: Path) -> None:
    """Raise :class:`FileFormatError` for a pickle, by its name or first byte, with the way to convert it."""
    with open_regular(path, MAX_BYTES) as file:
        first = file.read(1)
    if path.suffix in (".pkl", ".pickle") or first == b"\x80":
        line = CONVERSION.format(name=path.name, stem=path.stem)
        raise FileFormatError(
            f"{path}: pickles are refused, because reading one runs whatever it holds. Convert it in an isolated "
            f"environment (a container without network, with numpy, scipy and chumpy): {line}"
        )


def _modes(directions: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(np.moveaxis(MM_PER_UNIT * directions, 2, 0), np.float32)


def _jaw_open(data: dict) -> np.ndarray:
    """(V, 3) mm: the mean with the jaw joint turned, minus the mean, by linear blend skinning with pose correctives."""
    template, weight = data["v_template"].astype(float), data["weights"][:, JAW_JOINT].astype(float)
    turn = rotation_vector_matrix(np.array([JAW_RADIANS, 0.0, 0.0]))
    shaped = template
    if "posedirs" in data and data["posedirs"].shape[2] >= 9 * JAW_JOINT:
        # The correctives follow the rotations of all joints but the root, nine entries each.
        ours = slice(9 * (JAW_JOINT - 1), 9 * JAW_JOINT)
        shaped = template + data["posedirs"][:, :, ours] @ (turn - np.eye(3)).ravel()
    joint = data["J_regressor"][JAW_JOINT] @ template
    turned = (shaped - joint) @ turn.T + joint
    return MM_PER_UNIT * (shaped + weight[:, None] * (turned - shaped) - template)
