"""Writing a file whole or not at all: every writer of the package writes beside its output and renames at the end."""

from __future__ import annotations

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from ..errors import AdaptiveFaceError


@contextmanager
def replacing(path: str | os.PathLike) -> Iterator[Path]:
    """Yield the path of a temporary file beside ``path``, and rename it onto ``path`` when the block ends well.

    Parameters
    ----------
    path : path-like
        The file to write. Its suffix is kept by the temporary file (``film.part.mp4``), because encoders choose the
        format by it.

    Raises
    ------
    AdaptiveFaceError
        The disk is full or the folder cannot be written. The message names ``path``.

    Notes
    -----
    When the block fails in any way, Ctrl-C included, the temporary file is removed and the file at ``path`` is as it was.
    A process that is killed leaves the temporary file under its telling name.
    """
    path = Path(path)
    temporary = path.with_name(f"{path.stem}.part{path.suffix}")
    try:
        yield temporary
        os.replace(temporary, path)
    except BaseException as error:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)
        if isinstance(error, OSError):
            raise AdaptiveFaceError(f"{path}: {_reason(error)}; {_kept(path)}") from error
        raise


def _reason(error: OSError) -> str:
    if error.errno == errno.ENOSPC:
        return "no space left on the disk"
    return f"cannot be written ({error.strerror or error})"


def _kept(path: Path) -> str:
    return "the file that was there is unchanged" if path.exists() else "nothing was written"
