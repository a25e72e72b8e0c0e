"""Read the Basel Face Model 2017 and 2019 (Gerig et al. 2018, "Morphable Face Models - An Open Framework"), HDF5 files.

The files have statismo's layout. ``shape/model`` holds mean (3 V,), pcaBasis (3 V, M), which is orthonormal, and pcaVariance
(M,). ``expression/model`` holds the same, and its mean is a displacement. ``shape/representer/cells`` holds the triangles (3,
T). Lengths are millimetres; y points up, and the face looks towards +z.
"""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from ..errors import FileFormatError, MissingExtraError
from ..files import open_regular
from ..files.archive import FREE_BYTES, MOST_PER_BYTE
from ..model.face_model import FaceModel
from .assemble import MAX_BYTES, ForeignModel, assemble, check_size


def load_basel(
    path: str | os.PathLike, feature_vertices=None, identity_modes: int = 100, expression_modes: int = 60
) -> FaceModel:
    """Read a Basel Face Model (2017 or 2019, any of its masks).

    Its expressions are principal components named pca000, pca001, ..., in mm per standard deviation. The generic expressions
    are the strongest of them with both signs.

    Parameters
    ----------
    path : path-like
        The .h5 file.
    feature_vertices : array-like or path-like, optional
        As for :func:`~adaptiveface.importers.load_ict_facekit`.
    identity_modes, expression_modes : int
        Largest numbers of modes to read.

    Raises
    ------
    FileFormatError
        The message names the file and the reason.
    MissingExtraError
        h5py is not installed.
    """
    path = Path(path)
    h5py = _import_h5py()
    open_regular(path, MAX_BYTES).close()
    try:
        with h5py.File(path, "r") as file:
            foreign = _read(_Reader(h5py, file, path), path, identity_modes, expression_modes)
    except (OSError, RuntimeError, KeyError, ValueError, TypeError, MemoryError) as error:
        if isinstance(error, FileFormatError):
            raise
        raise FileFormatError(f"{path}: not a readable HDF5 file ({error})") from error
    return assemble(foreign, feature_vertices)


def _import_h5py():
    try:
        import h5py
    except ImportError as error:
        raise MissingExtraError('reading .h5 models needs h5py: pip install "adaptiveface[importers]"') from error
    return h5py


class _Reader:
    """Reads datasets by name, and checks them first. Links out of the file are refused."""

    def __init__(self, h5py, file, path: Path) -> None:
        self._h5py, self._file, self._path = h5py, file, path
        self._left = MAX_BYTES

    def dataset(self, name: str, kind: str, dimensions: int):
        group, parts = self._file, name.split("/")
        for part in parts:
            if not isinstance(group, self._h5py.Group) or part not in group:
                raise FileFormatError(f"{self._path}: the dataset '{name}' is missing")
            if not isinstance(group.get(part, getlink=True), self._h5py.HardLink):
                raise FileFormatError(f"{self._path}: '{name}' is a link to elsewhere; such files are refused")
            group = group[part]
        if not isinstance(group, self._h5py.Dataset) or group.ndim != dimensions or group.dtype.kind not in kind:
            raise FileFormatError(f"{self._path}: '{name}' is not a {dimensions}-dimensional array of numbers")
        if group.is_virtual or group.external:
            raise FileFormatError(f"{self._path}: '{name}' is stored in another file; such files are refused")
        return group

    def read(self, name: str, kind: str, dimensions: int, columns: int | None = None) -> np.ndarray:
        data = self.dataset(name, kind, dimensions)
        shape = data.shape if columns is None else (data.shape[0], min(columns, data.shape[1]))
        needed = int(np.prod(shape, dtype=object)) * data.dtype.itemsize
        if needed > FREE_BYTES + MOST_PER_BYTE * data.id.get_storage_size():
            raise FileFormatError(f"{self._path}: '{name}' promises {needed} bytes, far more than its size explains")
        self._left -= needed
        if self._left < 0:
            raise FileFormatError(f"{self._path}: its arrays need more than {MAX_BYTES >> 20} MiB")
        return data[:] if columns is None else data[:, : shape[1]]


def _read(reader: _Reader, path: Path, identity_modes: int, expression_modes: int) -> ForeignModel:
    length = reader.dataset("shape/model/mean", "f", 1).shape[0]
    cells = reader.dataset("shape/representer/cells", "iu", 2).shape
    if length % 3 or 3 not in cells:
        raise FileFormatError(f"{path}: mean of {length} numbers, cells {cells}; 3 V numbers and (3, T) are expected")
    check_size(path, length // 3, max(cells))
    mean = reader.read("shape/model/mean", "f", 1).astype(float)
    mean = mean + _vector(reader, path, "expression/model/mean", length)
    triangles = reader.read("shape/representer/cells", "iu", 2).astype(int)
    triangles = triangles.T if triangles.shape[0] == 3 else triangles
    identity, expression = (
        _basis(reader, path, f"{part}/model", length, modes)
        for part, modes in (("shape", identity_modes), ("expression", expression_modes))
    )
    names = tuple(f"pca{k:03d}" for k in range(len(expression)))
    return ForeignModel(path, mean.reshape(-1, 3), triangles, identity, expression, names, units=False)


def _vector(reader: _Reader, path: Path, name: str, length: int) -> np.ndarray:
    values = reader.read(name, "f", 1)
    if len(values) != length:
        raise FileFormatError(f"{path}: '{name}' has {len(values)} numbers, expected {length}")
    return values


def _basis(reader: _Reader, path: Path, model: str, length: int, modes: int) -> np.ndarray:
    """(M, V, 3) float32 components, multiplied by their standard deviations."""
    basis = reader.read(f"{model}/pcaBasis", "f", 2, columns=modes)
    variance = reader.read(f"{model}/pcaVariance", "f", 1)[: basis.shape[1]]
    if basis.shape != (length, len(variance)):
        raise FileFormatError(f"{path}: '{model}/pcaBasis' is {basis.shape}, expected ({length}, {len(variance)})")
    if not (np.isfinite(variance).all() and (variance >= 0).all()):
        raise FileFormatError(f"{path}: '{model}/pcaVariance' holds negative or NaN values")
    return (basis * np.sqrt(variance)).T.reshape(len(variance), -1, 3).astype(np.float32)
