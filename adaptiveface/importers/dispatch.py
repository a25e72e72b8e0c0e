"""Import a face model of any known format, which is told by its content, not by its name."""

from __future__ import annotations

import os
from pathlib import Path

from ..errors import FileFormatError, ParameterError
from ..files import Archive, open_regular
from ..model.face_model import FaceModel, load_face_model
from .assemble import MAX_BYTES
from .basel import load_basel
from .flame import load_flame, refuse_pickle
from .gnm import load_gnm
from .ict import NEUTRAL, load_ict_facekit

_HDF5, _ZIP = b"\x89HDF", b"PK\x03\x04"
_KNOWN = "an ICT-FaceKit folder, a Basel .h5, a FLAME, GNM or adaptiveface .npz"


def import_face_model(path: str | os.PathLike, **options) -> FaceModel:
    """Read a face model of any format that this package knows.

    Parameters
    ----------
    path : path-like
        The file or folder.
    **options
        Options of its loader, such as ``feature_vertices`` and ``identity_modes``.

    Raises
    ------
    FileFormatError
        The message names the file and the reason.
    ParameterError
        Options are given for a file of this package, which takes none.
    """
    path = Path(path)
    if path.is_dir():
        if not (path / NEUTRAL).is_file():
            raise FileFormatError(f"{path}: a folder without {NEUTRAL}; expected {_KNOWN}")
        return load_ict_facekit(path, **options)
    refuse_pickle(path)
    with open_regular(path, MAX_BYTES) as file:
        magic = file.read(4)
    if magic == _HDF5:
        return load_basel(path, **options)
    if magic != _ZIP:
        raise FileFormatError(f"{path}: not a face model; expected {_KNOWN}")
    names = _members(path)
    if "v_template.npy" in names:
        return load_flame(path, **options)
    if "template_vertex_positions.npy" in names:
        return load_gnm(path, **options)
    if "identity_modes.npy" in names:
        if options:
            raise ParameterError(f"{path}: a model of this package takes no options ({', '.join(options)})")
        return load_face_model(path)
    raise FileFormatError(f"{path}: an npz with none of the arrays of a known model; expected {_KNOWN}")


def _members(path: Path) -> set[str]:
    with Archive(path, MAX_BYTES) as archive:
        return set(archive.namelist())
