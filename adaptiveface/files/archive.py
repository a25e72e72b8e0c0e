"""Read zip archives from untrusted sources: declared sizes are checked before any memory is allocated."""

from __future__ import annotations

import io
import os
import zipfile
from contextlib import suppress
from pathlib import Path

from ..errors import FileFormatError
from .bounded import open_regular, size

#: Members may unpack to ``FREE_BYTES`` in any case, and beyond that to ``MOST_PER_BYTE`` for every byte that they take in the
#: archive. Measured data shrinks to a tenth, and a zip bomb of zeros to a thousandth.
FREE_BYTES, MOST_PER_BYTE = 64 << 20, 100


class _Stream(io.BufferedReader):
    """A stream that refuses to read more than ``limit`` bytes at once. zipfile reads the list of members in one piece."""

    limit: int | None = None

    def read(self, count: int | None = -1) -> bytes:
        """Read as any stream does."""
        if self.limit is not None and count is not None and count > self.limit:
            raise FileFormatError(f"{size(count)} for the list of its members; at most {size(self.limit)} are read")
        return super().read(count)


class Archive(zipfile.ZipFile):
    """A readable :class:`zipfile.ZipFile` that raises :class:`FileFormatError` naming the file.

    Parameters
    ----------
    path : path-like
        The archive.
    max_bytes : int
        Largest size of the whole file.
    max_directory_bytes : int
        Largest size of the list of members.
    """

    def __init__(self, path: str | os.PathLike, max_bytes: int, max_directory_bytes: int = 1 << 20) -> None:
        self.path = Path(path)
        self._unexplained: dict[str, int] = {}
        self._stream = _Stream(open_regular(path, max_bytes).detach())
        self._stream.limit = max(max_directory_bytes, 1 << 17)
        try:
            super().__init__(self._stream)
        except FileFormatError as error:
            raise FileFormatError(f"{self.path}: {error}") from None
        except Exception as error:  # damaged archives raise anything, from BadZipFile to struct.error
            raise FileFormatError(f"{self.path}: not a readable zip archive ({str(error)[:120]})") from None
        finally:
            if self.fp is None:
                self._stream.close()
        self._stream.limit = None

    def close(self) -> None:
        """Close the archive and its file. zipfile leaves a stream open."""
        with suppress(AttributeError):  # it was never opened
            super().close()
            self._stream.close()

    def member(self, name: str) -> zipfile.ZipInfo:
        """The entry ``name``. Raises :class:`FileFormatError` if it is missing or unpacks to far more than its size."""
        try:
            entry = self.getinfo(name)
        except KeyError:
            raise FileFormatError(f"{self.path}: '{name}' is missing") from None
        stored = min(entry.compress_size, os.fstat(self._stream.fileno()).st_size)
        unexplained = entry.file_size - MOST_PER_BYTE * stored
        if unexplained > 0:
            self._unexplained[name] = unexplained
        if unexplained > 0 and sum(self._unexplained.values()) > FREE_BYTES:
            grown = f"{size(entry.file_size)} from {size(entry.compress_size)}"
            raise FileFormatError(f"{self.path}: '{name}' unpacks to {grown}, far more than its size explains")
        return entry
