"""Unpack LZFSE safely: the unpacked size is read from the block headers before any memory is allocated.

Reference: the format's published reference implementation (github.com/lzfse/lzfse), block headers in lzfse_internal.h.
"""

from __future__ import annotations

import struct

from ..errors import DriverMissingError, FrameError

_END, _STORED, _COMPRESSED, _LZVN = b"bvx$", b"bvx-", b"bvx2", b"bvxn"


def lzfse_module():
    """Return the library. Raises :class:`DriverMissingError`."""
    try:
        import lzfse
    except ImportError:
        raise DriverMissingError('reading .r3d files needs lzfse: pip install "adaptiveface[record3d]"') from None
    return lzfse


def decompress(packed: bytes, size: int, name: str) -> bytes:
    """Unpack LZFSE data of a known size.

    Parameters
    ----------
    packed : bytes
        The data.
    size : int
        The unpacked size, bytes.
    name : str
        Name of the data, for messages.

    Returns
    -------
    bytes
        The content.

    Raises
    ------
    FrameError
        The data is damaged, or has another unpacked size.
    """
    library = lzfse_module()
    declared = unpacked_size(packed, name)
    if declared != size:
        raise FrameError(f"{name}: holds {declared} bytes, the image size asks for {size}")
    try:
        content = library.decompress(packed)
    except Exception as error:  # the binding raises its own error type, MemoryError or ValueError
        raise FrameError(f"{name}: damaged LZFSE data ({error})") from None
    if len(content) != size:
        raise FrameError(f"{name}: unpacks to {len(content)} bytes, {size} are expected")
    return content


def unpacked_size(packed: bytes, name: str) -> int:
    """Return the unpacked size in bytes, according to the headers. Raises :class:`FrameError` if they are inconsistent."""
    position, total = 0, 0
    try:
        while packed[position : position + 4] != _END:
            magic, raw = struct.unpack_from("<4sI", packed, position)
            length = _block_length(packed, position, magic, raw)
            if length <= 0:
                raise FrameError(f"{name}: not LZFSE data (block {magic!r} at byte {position})")
            position, total = position + length, total + raw
    except struct.error:
        raise FrameError(f"{name}: the LZFSE data is cut off at byte {len(packed)}") from None
    return total


def _block_length(packed: bytes, position: int, magic: bytes, raw: int) -> int:
    """Return the length of a block with its header, bytes. It is 0 for an unknown block."""
    if magic == _STORED:
        return 8 + raw
    if magic == _LZVN:
        return 12 + struct.unpack_from("<I", packed, position + 8)[0]
    if magic == _COMPRESSED:
        literals, matches, header = struct.unpack_from("<3Q", packed, position + 8)
        return (header & 0xFFFFFFFF) + (literals >> 20 & 0xFFFFF) + (matches >> 40 & 0xFFFFF)
    return 0
