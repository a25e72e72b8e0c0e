"""Read FLAME (Li et al. 2017, "Learning a model of facial shape and expression from 4D scans") from an ``.npz`` export.

:class:`FlameFile` lists the arrays. If the file has the skinning of the joints, the jaw joint becomes the expression jawOpen.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..errors import FileFormatError
from ..files import open_regular
from ..files.records import array, read, record
from ..geometry.mesh import rotation_vector_matrix
from ..model.face_model import FaceModel
from .assemble import MAX_BYTES, ForeignModel, assemble, check_size

MM_PER_UNIT = 1000.0
IDENTITY_COMPONENTS = 300
JAW_JOINT = 2
JAW_RADIANS = 0.4
#: The line that converts a pickle. Pickles run code while they are read, so it is meant for a disposable environment.
CONVERSION = (
    "python -c \"import pickle, numpy as np; d = pickle.load(open('{name}', 'rb'), encoding='latin1'); "
    "np.savez('{stem}.npz', **{{k: np.array(d[k].todense() if hasattr(d[k], 'todense') else d[k]) for k in "
    "('v_template', 'shapedirs', 'posedirs', 'f', 'weights', 'J_regressor')}})\""
)


@record
@dataclass(frozen=True)
class FlameFile:
    """The arrays of a FLAME export that are read. V vertices, T triangles, K components, J joints, P pose correctives."""

    template: np.ndarray = array("V 3", name="v_template", doc="average head", unit="m")
    directions: np.ndarray = array(
        "V 3 K", name="shapedirs", doc="components, identity first, then expressions", unit="m per standard deviation"
    )
    triangles: np.ndarray = array("T 3", "i4", name="f", doc="vertex numbers", below="V")
    weights: np.ndarray | None = array("V J", doc="share of each joint in each vertex", optional=True, default=None)
    joint_regressor: np.ndarray | None = array(
        "J V", name="J_regressor", doc="joints as weighted sums of the vertices", optional=True, default=None
    )
    pose_directions: np.ndarray | None = array(
        "V 3 P",
        name="posedirs",
        doc="correctives for the rotations of all joints but the root, nine entries each",
        unit="m",
        optional=True,
        default=None,
    )


def load_flame(
    path: str | os.PathLike,
    feature_vertices=None,
    identity_modes: int = 100,
    expression_modes: int = 60,
    identity_components: int = IDENTITY_COMPONENTS,
) -> FaceModel:
    """Read a FLAME model exported as npz.

    The expressions are principal components and, if the file has the skinning, jawOpen: a turn of 0.4 rad about the jaw joint.

    Parameters
    ----------
    path : path-like
        The file.
    feature_vertices : array-like or path-like, optional
        As for :func:`~adaptiveface.importers.load_ict_facekit`.
    identity_modes, expression_modes : int
        Largest numbers of modes to read.
    identity_components : int
        How many of the leading ``shapedirs`` are identity. They are 300 in FLAME 2016 to 2023.

    Raises
    ------
    FileFormatError
        The message names the file and the reason. For a pickle, it also shows the line that converts it.
    """
    path = Path(path)
    refuse_pickle(path)
    file = FlameFile(**read(FlameFile, path, max_bytes=MAX_BYTES))
    directions = file.directions
    check_size(path, len(file.template), len(file.triangles))
    if directions.shape[2] <= identity_components:
        raise FileFormatError(
            f"{path}: 'shapedirs' has {directions.shape[2]} components; more than {identity_components} are expected, "
            "expressions last (identity_components= sets how many are identity)"
        )
    identity = _modes(directions[:, :, : min(identity_modes, identity_components)])
    expressions = _modes(directions[:, :, identity_components : identity_components + expression_modes])
    names = [f"pca{k:03d}" for k in range(len(expressions))]
    if (jaw_open := _jaw_open(file)) is not None:
        expressions = np.concatenate([expressions, jaw_open[None].astype(np.float32)])
        names.append("jawOpen")
    foreign = ForeignModel(
        path, MM_PER_UNIT * file.template.astype(float), file.triangles, identity, expressions, tuple(names), units=False
    )
    return assemble(foreign, feature_vertices)


def refuse_pickle(path: Path) -> None:
    """Raise :class:`FileFormatError` with the way to convert the file if its name or first byte is a pickle's."""
    with open_regular(path, MAX_BYTES) as file:
        first = file.read(1)
    if path.suffix in (".pkl", ".pickle") or first == b"\x80":
        line = CONVERSION.format(name=path.name, stem=path.stem)
        raise FileFormatError(
            f"{path}: pickles are refused, because reading one runs any code that it holds. Convert it in an isolated "
            f"environment (a container without network, with numpy, scipy and chumpy): {line}"
        )


def _modes(directions: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(np.moveaxis(MM_PER_UNIT * directions, 2, 0), np.float32)


def _jaw_open(file: FlameFile) -> np.ndarray | None:
    """The displacements (V, 3) of an open jaw, mm, by linear blend skinning with pose correctives; None without skinning."""
    if file.weights is None or file.joint_regressor is None or file.weights.shape[1] <= JAW_JOINT:
        return None
    template, weight = file.template.astype(float), file.weights[:, JAW_JOINT].astype(float)
    turn = rotation_vector_matrix(np.array([JAW_RADIANS, 0.0, 0.0]))
    shaped = template
    if file.pose_directions is not None and file.pose_directions.shape[2] >= 9 * JAW_JOINT:
        ours = slice(9 * (JAW_JOINT - 1), 9 * JAW_JOINT)  # the root has no entries
        shaped = template + file.pose_directions[:, :, ours] @ (turn - np.eye(3)).ravel()
    joint = file.joint_regressor[JAW_JOINT] @ template
    turned = (shaped - joint) @ turn.T + joint
    return MM_PER_UNIT * (shaped + weight[:, None] * (turned - shaped) - template)
