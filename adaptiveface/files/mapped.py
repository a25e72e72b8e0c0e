"""Keep arrays on the disk: map them from a file, read them block by block, and release each block's memory after use."""

from __future__ import annotations

import mmap
import os
import struct
import zipfile
import zlib
from collections.abc import Callable, Iterator

import numpy as np

from ..errors import FileFormatError

#: Approximate size of the blocks in which a mapped array is read, bytes.
BLOCK_BYTES = 16 << 20
_LOCAL_HEADER = struct.Struct("<4s22xHH")


def map_member(
    path: str | os.PathLike, info: zipfile.ZipInfo, look: Callable[[np.ndarray], None] = lambda block: None
) -> np.ndarray | None:
    """Map an uncompressed ``.npy`` member of a zip file into memory, read-only.

    Parameters
    ----------
    path : path-like
        The zip file.
    info : zipfile.ZipInfo
        The member.
    look : callable
        Called once with every block of the array, while the checksum is computed.

    Returns
    -------
    array or None
        None if the member cannot be mapped: it is compressed, encrypted, in Fortran order, empty, or of Python objects.

    Raises
    ------
    FileFormatError
        The header, the size or the checksum is wrong.
    """
    if info.compress_type != zipfile.ZIP_STORED or info.flag_bits & 1:
        return None
    with open(path, "rb") as stream:
        stream.seek(info.header_offset)
        start = stream.read(_LOCAL_HEADER.size)
        if len(start) < _LOCAL_HEADER.size or start[:4] != b"PK\x03\x04":
            raise FileFormatError(f"{path}: '{info.filename}' is not where the file says")
        stream.seek(sum(_LOCAL_HEADER.unpack(start)[1:]), os.SEEK_CUR)
        member = stream.tell()
        version = np.lib.format.read_magic(stream)
        read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        shape, fortran, dtype = read(stream)
        data = stream.tell()
        if fortran or dtype.hasobject or 0 in shape or not shape:
            return None
        size = int(np.prod(shape, dtype=object)) * dtype.itemsize
        if data - member + size != info.file_size or data + size > os.fstat(stream.fileno()).st_size:
            raise FileFormatError(f"{path}: '{info.filename}' promises {size} bytes and holds another number")
        stream.seek(member)
        header = stream.read(data - member)
    array = np.memmap(path, dtype, "r", data, shape)
    checksum = zlib.crc32(header)
    for _, block in blocks(array):
        look(block)
        checksum = zlib.crc32(block.data, checksum)
    if checksum != info.CRC:
        raise FileFormatError(f"{path}: the checksum of '{info.filename}' is wrong: the file is damaged")
    return array


def blocks(array: np.ndarray, rows: int | None = None) -> Iterator[tuple[slice, np.ndarray]]:
    """Iterate over an array in blocks along its first axis.

    The memory of a mapped array's block is released before the next block is read.

    Parameters
    ----------
    array : array
        Any array, mapped or not.
    rows : int, optional
        Entries per block, by default about :data:`BLOCK_BYTES`. The last block may be shorter.

    Yields
    ------
    part : slice
        The place of the block on the first axis.
    block : array
        A copy of it.
    """
    each = max(int(np.prod(array.shape[1:], dtype=object)) * array.dtype.itemsize, 1)
    rows = rows or max(BLOCK_BYTES // each, 1)
    for first in range(0, len(array), rows):
        part = slice(first, min(first + rows, len(array)))
        yield part, np.ascontiguousarray(array[part]) if _mapping(array) is None else np.array(array[part])
        release(array)


def release(array: np.ndarray) -> None:
    """Release the memory of a mapped array's pages. They are read again when needed."""
    mapping = _mapping(array)
    if mapping is not None and hasattr(mapping, "madvise"):
        mapping.madvise(mmap.MADV_DONTNEED)


def _mapping(array: np.ndarray) -> mmap.mmap | None:
    """The mapping that holds the array's memory; None for memory of its own, or pages that would lose changes."""
    base: object = array
    while isinstance(base, np.ndarray):
        if isinstance(base, np.memmap) and base.mode == "c":
            return None
        base = base.base
    return base if isinstance(base, mmap.mmap) else None
