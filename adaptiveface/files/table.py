"""A table that grows on the disk row by row, whole rows only, so that nothing waits in memory."""

from __future__ import annotations

import os
from collections.abc import Iterable
from contextlib import suppress


class GrowingTable:
    """A CSV file that is complete after every :meth:`append`; nothing of it is kept in memory.

    The file is made with ``header`` by the first append, also one of no rows. Rows are handed to the system in one call
    each time, and a part of them that went onto a full disk is taken back: a kill at any moment leaves whole rows.
    """

    def __init__(self, path: str | os.PathLike, header: tuple[str, ...]) -> None:
        self.path, self._header = path, header
        self._descriptor: int | None = None
        self._bytes = 0

    def append(self, rows: Iterable[tuple]) -> None:
        """Write rows of cells that need no quotes; raises OSError, after which the file holds what it held before."""
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
        """Give the file back; a second time does nothing."""
        descriptor, self._descriptor = self._descriptor, None
        if descriptor is not None:
            os.close(descriptor)
