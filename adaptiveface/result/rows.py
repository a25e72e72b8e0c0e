"""Store one row per tracked frame, in memory or in a growing file that survives the end of the process.

The folder is beside the future result: ``result.unfinished`` for ``result.npz``. It contains ``head.npz`` with what all
frames share, and ``rows.bin`` with the frames, each of which is written as a whole.
:meth:`adaptiveface.result.Result.load` reads the folder, so that a run that was killed is not lost.
"""

from __future__ import annotations

import errno
import itertools
import logging
import os
from contextlib import suppress
from pathlib import Path
from typing import Literal

import numpy as np

from ..errors import AdaptiveFaceError, FileFormatError
from ..files.npz import write_npz

_log = logging.getLogger(__name__)
HEAD, ROWS = "head.npz", "rows.bin"
#: Largest number of characters of the reason why a frame is not tracked.
REASON = 200


def unfinished_folder(result: str | os.PathLike) -> Path:
    """The folder in which a run stores its rows until ``result`` (an ``.npz``) is written."""
    return Path(result).with_suffix(".unfinished")


def discard(folder: Path) -> None:
    """Remove a folder of rows when its result is safe. Nothing happens if there is none."""
    for name in (HEAD, ROWS):
        (folder / name).unlink(missing_ok=True)
    with suppress(OSError):  # it does not exist, or contains other files
        folder.rmdir()


def _keep_earlier(folder: Path) -> None:
    if not (folder / ROWS).is_file() or not (folder / ROWS).stat().st_size:
        discard(folder)
        return
    numbered = (folder.with_name(f"{folder.name}-{number}") for number in itertools.count(1))
    kept = next(path for path in numbered if not path.exists())
    folder.rename(kept)
    _log.warning("%s: frames of an earlier run that did not end, kept as %s", folder, kept.name)


class MemoryRows:
    """Rows in memory, whose space grows by half when it is full."""

    def __init__(self, dtype: np.dtype, expected: int) -> None:
        self._rows = np.zeros(max(expected, 1), dtype)
        self._done = 0

    def __len__(self) -> int:
        return self._done

    def append(self, row: np.ndarray) -> None:
        """Store a row () of the dtype."""
        if self._done == len(self._rows):
            self._rows.resize(self._done + self._done // 2 + 30, refcheck=False)
        self._rows[self._done] = row
        self._done += 1

    def all(self) -> np.ndarray:
        """The rows (F,) so far. Changes to the array are kept."""
        return self._rows[: self._done]

    def close(self) -> None:
        """Close after the last row."""


class FileRows:
    """Rows in ``folder``, which is made. ``head`` are the arrays that all frames share.

    Rows of an earlier run that did not end are kept, and their folder is renamed with a number.
    """

    def __init__(self, dtype: np.dtype, folder: Path, head: dict[str, np.ndarray]) -> None:
        self._dtype, self._path, self._done = dtype, folder / ROWS, 0
        _keep_earlier(folder)
        folder.mkdir(exist_ok=True)
        write_npz(folder / HEAD, head)
        self._stream = open(self._path, "xb", buffering=0)

    def __len__(self) -> int:
        return self._done

    def append(self, row: np.ndarray) -> None:
        """Write a row () of the dtype. Raises :class:`AdaptiveFaceError` if the disk is full."""
        try:
            data = memoryview(row.tobytes())
            while len(data):  # a write takes as much as fits
                data = data[self._stream.write(data) :]
        except OSError as error:
            reason = "no space left on the disk" if error.errno == errno.ENOSPC else error.strerror
            raise AdaptiveFaceError(f"{self._path}: {reason}; the {self._done} frames before are kept there") from error
        self._done += 1

    def all(self) -> np.ndarray:
        """The rows (F,) so far, mapped from the file. Changes to the array are kept."""
        return _mapped(self._path, self._dtype, self._done)

    def close(self) -> None:
        """Close after the last row."""
        self._stream.close()


def read_rows(folder: Path, dtype: np.dtype) -> np.ndarray:
    """Read the rows (F,) of a run in ``folder``, without an incomplete one. Raises :class:`FileFormatError`."""
    path = folder / ROWS
    try:
        count = path.stat().st_size // dtype.itemsize
    except OSError as error:
        raise FileFormatError(f"{path}: cannot be read ({error.strerror})") from None
    if not count:
        raise FileFormatError(f"{folder}: no frame was finished")
    return _mapped(path, dtype, count, "c")


def _mapped(path: Path, dtype: np.dtype, count: int, mode: Literal["r+", "c"] = "r+") -> np.ndarray:
    return np.memmap(path, dtype, mode, 0, (count,)) if count else np.zeros(0, dtype)
