"""Read files from untrusted sources: only regular files, and never more bytes than the caller allows."""

from __future__ import annotations

import io
import json
import os
import stat
from pathlib import Path
from typing import Any

from ..errors import FileFormatError


def open_regular(path: str | os.PathLike, max_bytes: int) -> io.BufferedReader:
    """Open a regular file of at most ``max_bytes`` bytes for reading in binary mode. Links are followed.

    Raises
    ------
    FileFormatError
        The file does not exist, is a folder, a pipe or a device, is larger than ``max_bytes``, or cannot be read. The message
        names the file and the limit.
    """
    path = Path(path)
    try:
        descriptor = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
    except (FileNotFoundError, NotADirectoryError):
        raise FileFormatError(f"{path}: no such file") from None
    except (OSError, ValueError) as error:  # ValueError: a name with a null byte
        raise FileFormatError(f"{path}: cannot be read ({getattr(error, 'strerror', None) or error})") from None
    status = os.fstat(descriptor)
    if not stat.S_ISREG(status.st_mode):
        os.close(descriptor)
        raise FileFormatError(f"{path}: not a regular file")
    if status.st_size > max_bytes:
        os.close(descriptor)
        raise FileFormatError(f"{path}: {size(status.st_size)}; at most {size(max_bytes)} are read")
    return open(descriptor, "rb")


def read_bytes(path: str | os.PathLike, max_bytes: int) -> bytes:
    """The content of a regular file of at most ``max_bytes`` bytes. Raises what :func:`open_regular` raises."""
    try:
        with open_regular(path, max_bytes) as stream:
            length = os.fstat(stream.fileno()).st_size
            content = stream.read(length + 1)  # not max_bytes: read() allocates as much as it is asked for
    except OSError as error:  # the disk fails, or a remote file is gone
        raise FileFormatError(f"{path}: cannot be read ({error.strerror or error})") from None
    if len(content) > length:
        raise FileFormatError(f"{path}: it grew while it was read")
    return content


def read_text(path: str | os.PathLike, max_bytes: int) -> str:
    """The text of a regular file of at most ``max_bytes`` bytes, decoded by :func:`decoded`.

    Raises :class:`FileFormatError` as :func:`read_bytes` does, and when the bytes are not UTF-8.
    """
    try:
        return decoded(read_bytes(path, max_bytes))
    except UnicodeDecodeError as error:
        raise FileFormatError(f"{path}: not UTF-8 text ({error.reason} at byte {error.start})") from None


def decoded(content: bytes, errors: str = "strict") -> str:
    """Decode UTF-8 with or without a byte-order mark, or UTF-16 with one (Windows' "Unicode text").

    ``errors`` is that of :meth:`bytes.decode`.
    """
    utf16 = content[:2] in (b"\xff\xfe", b"\xfe\xff")
    return content.decode("utf-16" if utf16 else "utf-8-sig", errors)


def is_own(path: Path) -> bool:
    """Whether a file belongs to its folder, and is not added by the system, as ``._jawOpen.obj`` is on macOS."""
    return not path.name.startswith(".")


def parse_json(content: bytes, name: str, max_values: int = 1_000_000, **options) -> Any:
    """Parse JSON of a limited number of values.

    The values are counted before any is created, because an empty list takes 3 bytes in JSON and 64 bytes in memory.

    Parameters
    ----------
    content : bytes
        The JSON text.
    name : str
        Name of its source, for messages.
    max_values : int
        Largest number of values.
    **options
        Passed to :func:`json.loads`.

    Raises
    ------
    FileFormatError
        The content is not valid JSON or has too many values.
    """
    values = sum(map(content.count, (b",", b"[", b"{")))
    if values > max_values:
        raise FileFormatError(f"{name}: JSON of {values} values; at most {max_values} are read")
    try:
        return json.loads(content, **options)
    except RecursionError:
        raise FileFormatError(f"{name}: JSON that is nested too deeply") from None
    except ValueError as error:
        raise FileFormatError(f"{name}: not readable as JSON ({str(error)[:120]})") from None


def read_json(path: str | os.PathLike, max_bytes: int, max_values: int = 1_000_000) -> Any:
    """Parse a regular file of JSON. Raises :class:`FileFormatError` as :func:`read_bytes` and :func:`parse_json` do."""
    return parse_json(read_bytes(path, max_bytes), os.fspath(path), max_values)


def size(count: int) -> str:
    """A readable number of bytes."""
    return f"{count} bytes" if count < 10_240 else f"{count / 1024:.0f} KiB" if count < 10 << 20 else f"{count >> 20} MiB"
