"""Reading files that may come from anywhere: regular files only, and never more bytes than the reader asked for."""

from __future__ import annotations

import os
import stat
from pathlib import Path

from ..errors import FileFormatError


def read_bytes(path: str | os.PathLike, max_bytes: int) -> bytes:
    """The content of a regular file of at most ``max_bytes`` bytes; links are followed.

    Raises
    ------
    FileFormatError
        There is no such file, it is a folder, a pipe or a device, it is larger than ``max_bytes``, or it cannot be read.
        The message names the file and the limit.
    """
    path = Path(path)
    try:
        descriptor = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
    except FileNotFoundError:
        raise FileFormatError(f"{path}: no such file") from None
    except OSError as error:
        raise FileFormatError(f"{path}: cannot be read ({error.strerror or error})") from None
    status = os.fstat(descriptor)
    if not stat.S_ISREG(status.st_mode):
        os.close(descriptor)
        raise FileFormatError(f"{path}: not a regular file")
    with open(descriptor, "rb") as stream:
        if status.st_size > max_bytes:
            raise FileFormatError(f"{path}: {status.st_size} bytes, at most {max_bytes} are read")
        content = stream.read(status.st_size + 1)  # not max_bytes: read() takes the memory for all it is asked for
    if len(content) > status.st_size:
        raise FileFormatError(f"{path}: it grew while it was read")
    return content


def read_text(path: str | os.PathLike, max_bytes: int) -> str:
    """The text of a regular file of at most ``max_bytes`` bytes: UTF-8, with or without a byte-order mark.

    Raises :class:`FileFormatError` as :func:`read_bytes` does, and when the bytes are not UTF-8.
    """
    try:
        return read_bytes(path, max_bytes).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise FileFormatError(f"{path}: not UTF-8 text ({error.reason} at byte {error.start})") from None
