"""Write a table to the disk row by row. Only whole rows are written, and none is kept in memory."""

from __future__ import annotations

import os
from collections.abc import Iterable
from contextlib import suppress


class GrowingTable:
    """A CSV file that is complete after every :meth:`append`. No row is kept in memory.

    The first append creates the file with ``header``, even if it appends no rows. Each append passes its rows to the system
    in one call. If only part of them fits on a full disk, that part is removed again. A kill at any moment therefore leaves
    whole rows.
    """

    def __init__(self, path: str | os.PathLike, header: tuple[str, ...]) -> None:
        self.path, self._header = path, header
        self._descriptor: int | None = None
        self._bytes = 0

    def append(self, rows: Iterable[tuple]) -> None:
        """Append rows whose cells need no quotes. After an OSError, the file has its previous content."""
        lines = [] if self._descriptor is not None else [self._header]
        lines += rows
        if self._descriptor is None:
            flags = os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_APPEND | getattr(os, "O_BINARY", 0)
            self._descriptor, self._bytes = os.open(self.path, flags, 0o666), 0
        content = "".join(",".join(map(str, line)) + "\r\n" for line in lines).encode()
        try:
            rest = memoryview(content)
            while rest:
                rest = rest[os.write(self._descriptor, rest) :]
        except BaseException:
            with suppress(OSError):
                os.ftruncate(self._descriptor, self._bytes)
            raise
        self._bytes += len(content)

    def close(self) -> None:
        """Close the file. Calling it again does nothing."""
        descriptor, self._descriptor = self._descriptor, None
        if descriptor is not None:
            os.close(descriptor)
