"""Read ``.npz`` files from untrusted sources: no pickles, and sizes are checked before memory is allocated.

The header of each member (name, dtype, shape, size) is read and checked before the array itself.
"""

from __future__ import annotations

import os
import zipfile
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import FileFormatError, abbreviated
from . import Archive, blocks, map_member, replacing

MAX_BYTES = 8 << 30
#: Largest size of the whole file, whose large arrays may stay on the disk.
MAX_FILE_BYTES = 1 << 40
#: Size from which an array that may stay on the disk does so, bytes. Smaller ones are read, so the file is not kept open.
MAPPED_FROM = 128 << 20


@dataclass(frozen=True)
class Field:
    """Requirements for one array.

    ``shape`` holds sizes as numbers or names; equal names must have equal sizes. ``kind`` lists the allowed kinds of dtype, and
    an ``optional`` array may be missing.
    """

    shape: tuple[int | str, ...]
    kind: str = "f"
    optional: bool = False


def _checked_header(archive: Archive, info: zipfile.ZipInfo, name: str, path: Path) -> tuple[tuple[int, ...], np.dtype, int]:
    """Shape, dtype and size in bytes of an array, from a header that fits the size of its member in the archive."""
    with archive.open(info) as member:
        version = np.lib.format.read_magic(member)
        if version not in ((1, 0), (2, 0)):
            raise FileFormatError(f"{path}: array '{name}' has the unknown npy version {version}")
        read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        shape, _, dtype = read(member)
        begins = member.tell()
    if dtype.hasobject:
        raise FileFormatError(f"{path}: array '{name}' holds Python objects; pickles are refused")
    needed = int(np.prod(shape, dtype=object)) * dtype.itemsize
    if begins + needed != info.file_size:
        held = info.file_size - begins
        raise FileFormatError(f"{path}: array '{name}' promises {abbreviated(needed)} bytes and holds {held}")
    return shape, dtype, needed


def _check(path: Path, name: str, field: Field, shape, dtype: np.dtype, sizes: dict[str, int]) -> None:
    if dtype.kind not in field.kind:
        raise FileFormatError(f"{path}: array '{name}' has dtype {abbreviated(dtype)}, expected kind '{field.kind}'")
    if len(shape) != len(field.shape):
        raise FileFormatError(f"{path}: array '{name}' has shape {abbreviated(shape)}, expected {field.shape}")
    for got, want in zip(shape, field.shape, strict=True):
        expected = sizes.setdefault(want, got) if isinstance(want, str) else want
        if got != expected:
            raise FileFormatError(f"{path}: array '{name}' has shape {abbreviated(shape)}, expected {field.shape} with {sizes}")


def load_checked(
    path: str | os.PathLike,
    fields: Mapping[str, Field],
    max_bytes: int = MAX_BYTES,
    mapped: Collection[str] = (),
    mapped_from: int | None = None,
) -> dict:
    """Read the named arrays of an npz and check names, dtypes, shapes, finiteness and total size.

    Parameters
    ----------
    path : path-like
        The npz file.
    fields : mapping of str to Field
        The arrays to read. Other members of the file are ignored.
    max_bytes : int
        Largest size of all arrays that are read into memory.
    mapped : collection of str
        Arrays that stay on the disk if they are large and uncompressed. They are checked block by block, and do not count
        towards ``max_bytes``.
    mapped_from : int, optional
        Size from which an array is large, bytes; by default :data:`MAPPED_FROM`.

    Returns
    -------
    dict
        Arrays by name, without the optional ones that are missing.

    Raises
    ------
    FileFormatError
        The message names the file and the array.
    """
    path = Path(path)
    out: dict[str, np.ndarray] = {}
    sizes: dict[str, int] = {}
    total, large = 0, MAPPED_FROM if mapped_from is None else mapped_from
    try:
        with Archive(path, MAX_FILE_BYTES) as archive:
            members = set(archive.namelist())
            for name, field in fields.items():
                if f"{name}.npy" not in members:
                    if field.optional:
                        continue
                    raise FileFormatError(f"{path}: the array '{name}' is missing")
                info = archive.member(f"{name}.npy")
                shape, dtype, needed = _checked_header(archive, info, name, path)
                _check(path, name, field, shape, dtype, sizes)
                array = None
                if name in mapped and info.file_size >= large:
                    array = map_member(path, info, partial(_check_values, path, name))
                if array is None:
                    total += needed
                    if total > max_bytes:
                        raise FileFormatError(f"{path}: its arrays need more than {max_bytes >> 20} MiB")
                    array = _read_array(archive, name, path)
                out[name] = array
    except FileFormatError:
        raise
    except Exception as error:  # damaged archives and headers raise anything, from zlib.error to tokenize.TokenError
        raise FileFormatError(f"{path}: not a readable npz file ({abbreviated(error, 120)})") from error
    return out


def _read_array(archive: Archive, name: str, path: Path) -> np.ndarray:
    """The array ``name``, whose header is checked already, read into memory."""
    with archive.open(f"{name}.npy") as member:
        array: np.ndarray = np.lib.format.read_array(member, allow_pickle=False)
    _check_values(path, name, array)
    return array


def _check_values(path: Path, name: str, array: np.ndarray) -> None:
    if array.dtype.kind == "f" and not np.isfinite(array).all():
        raise FileFormatError(f"{path}: array '{name}' holds NaN or infinite values")
    if array.dtype.kind == "U" and not _is_text(array):
        raise FileFormatError(f"{path}: array '{name}' holds characters that do not exist")


def _is_text(array: np.ndarray) -> bool:
    """Whether a unicode array holds only valid characters. NumPy stores any 32 bits, on which Python fails later."""
    codes = np.frombuffer(array.tobytes(), np.dtype(np.uint32).newbyteorder(array.dtype.byteorder))
    return not (codes > 0x10FFFF).any() and not ((codes >= 0xD800) & (codes < 0xE000)).any()


def check_indices(path: str | os.PathLike, name: str, array: np.ndarray, upper: int) -> None:
    """Raise :class:`FileFormatError` unless every entry lies in [0, upper)."""
    if array.size and (array.min() < 0 or array.max() >= upper):
        raise FileFormatError(f"{path}: array '{name}' points outside 0..{upper - 1}")


def write_npz(path: str | os.PathLike, arrays: Mapping[str, Any], compressed: bool = False, shared: bool = False) -> None:
    """Write an npz in the format of :func:`numpy.savez`, completely or not at all.

    Parameters
    ----------
    path : path-like
        The file to write.
    arrays : mapping of str to array-like
        The arrays by name. Mapped ones are written block by block, unless the file is compressed.
    compressed : bool
        Whether to compress, as :func:`numpy.savez_compressed` does.
    shared : bool
        Whether several processes may write this file at the same time, as for :func:`adaptiveface.files.replacing`.
    """
    if compressed:
        with replacing(path, shared) as temporary, open(temporary, "wb") as stream:
            np.savez_compressed(stream, **arrays)
        return
    with replacing(path, shared) as temporary, zipfile.ZipFile(temporary, "w") as archive:
        for name, value in arrays.items():
            array = np.asanyarray(value)
            with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                if array.ndim == 0 or not array.size:
                    np.lib.format.write_array(member, array, allow_pickle=False)
                    continue
                descr = np.lib.format.dtype_to_descr(array.dtype)
                header = {"descr": descr, "fortran_order": False, "shape": array.shape}
                np.lib.format.write_array_header_1_0(member, header)
                for _, block in blocks(array):
                    member.write(block.tobytes())
