"""Read GNM Head (Google's Generative aNthropometric Model, version 3) from ``gnm_head.npz``.

:class:`GnmFile` lists the arrays that are read, as the model's own code documents them. Joints, teeth, tongue and eyeballs are
left out.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..files.records import array, read, record
from ..model.face_model import FaceModel
from .assemble import MAX_BYTES, ForeignModel, assemble, check_size

MM_PER_UNIT = 1000.0
SKIN_GROUPS = ("skin_exterior", "skin")  # the first one in the file is used


@record
@dataclass(frozen=True)
class GnmFile:
    """The arrays of a GNM head that are read. V vertices, T triangles, I identity modes, E expressions, G groups."""

    template: np.ndarray = array("V 3", name="template_vertex_positions", doc="average head", unit="m")
    identity_modes: np.ndarray = array(
        "I V 3", name="vertex_identity_basis", doc="identity modes", unit="m per standard deviation"
    )
    expressions: np.ndarray = array("E V 3", name="expression_basis", doc="expression modes", unit="m per standard deviation")
    triangles: np.ndarray = array("T 3", "i4", "vertex numbers", below="V")
    expression_names: tuple[str, ...] | None = array("E", "U", "names of the expression modes", optional=True, default=None)
    vertex_groups: np.ndarray | None = array("G V", doc="share of each vertex in each group", optional=True, default=None)
    vertex_group_names: tuple[str, ...] = array("G", "U", "names of the groups", optional=True, default=())


def load_gnm(path: str | os.PathLike, feature_vertices=None, identity_modes: int = 100) -> FaceModel:
    """Read a GNM head.

    Its expressions are principal components of single regions of the face. The generic expressions are those that move the face
    most, with both signs.

    Parameters
    ----------
    path : path-like
        The file.
    feature_vertices : array-like or path-like, optional
        As for :func:`~adaptiveface.importers.load_ict_facekit`.
    identity_modes : int
        Largest number of identity modes to read.

    Raises
    ------
    FileFormatError
        The message names the file and the reason.
    """
    path = Path(path)
    file = GnmFile(**read(GnmFile, path, max_bytes=MAX_BYTES))
    check_size(path, len(file.template), len(file.triangles))
    names = file.expression_names
    foreign = ForeignModel(
        path,
        MM_PER_UNIT * file.template.astype(float),
        file.triangles,
        (MM_PER_UNIT * file.identity_modes[:identity_modes]).astype(np.float32),
        (MM_PER_UNIT * file.expressions).astype(np.float32),
        tuple(f"pca{k:03d}" for k in range(len(file.expressions))) if names is None else names,
        units=False,
        skin=_skin(file),
    )
    return assemble(foreign, feature_vertices)


def _skin(file: GnmFile) -> np.ndarray | None:
    """Which vertices (V,) belong to the skin; None if the file does not tell."""
    if file.vertex_groups is None:
        return None
    for group in SKIN_GROUPS:
        if group in file.vertex_group_names:
            return file.vertex_groups[file.vertex_group_names.index(group)] > 0.5
    return None
