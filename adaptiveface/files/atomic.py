"""Write files and folders completely or not at all: every writer writes beside its output and renames at the end."""

from __future__ import annotations

import errno
import os
import stat
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from ..errors import AdaptiveFaceError
from ..runtime.interrupt import CtrlC

_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG) if hasattr(errno, "EDQUOT") else (errno.ENOSPC, errno.EFBIG)


@contextmanager
def replacing(path: str | os.PathLike, shared: bool = False, keep_suffix: bool = True) -> Iterator[Path]:
    """Yield the path of a temporary file beside ``path``, and rename it onto ``path`` when the block ends well.

    Parameters
    ----------
    path : path-like
        The file to write. A link is followed and stays a link.
    shared : bool
        Whether several processes may write this file at the same time, as they do with a cache. Each then uses its own
        temporary file.
    keep_suffix : bool
        Whether the temporary file has the suffix of ``path`` (``film.part.mp4``), because encoders choose the format by it.
        Otherwise its name is like ``00012.png.part``, so that it cannot be mistaken for one of a folder's images.

    Raises
    ------
    AdaptiveFaceError
        The disk is full, the folder cannot be written, or the file is write-protected. The message names ``path``.

    Notes
    -----
    When the block fails in any way, including by Ctrl-C, the temporary file is removed and the file at ``path`` is unchanged.
    A process that is killed leaves the temporary file behind, and its name tells what it is.
    """
    path = Path(path)
    target = Path(os.path.realpath(path))
    mark = f"part{os.getpid()}" if shared else "part"
    temporary = target.with_name(f"{target.stem}.{mark}{target.suffix}" if keep_suffix else f"{target.name}.{mark}")
    try:
        mode = _mode_of(target)
        yield temporary
        if mode is not None:
            os.chmod(temporary, mode)
        os.replace(temporary, target)
    except BaseException as error:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)
        if isinstance(error, OSError):
            raise AdaptiveFaceError(f"{path}: {reason(error)}; {_kept(target)}") from error
        raise


@contextmanager
def replacing_folder(path: str | os.PathLike, ours: Callable[[str], bool]) -> Iterator[Path]:
    """Do as :func:`replacing` does for a folder of files: yield a new folder beside ``path`` that replaces it at the end.

    Parameters
    ----------
    path : path-like
        The folder to write. Its parents are created.
    ours : callable
        ``ours(name)`` tells whether a file belongs in such a folder. A folder with any other file is refused, so no other
        file is ever removed.

    Raises
    ------
    AdaptiveFaceError
        The folder cannot be written or holds other files. The message names ``path``.

    Notes
    -----
    No system call replaces a folder that is not empty. The old folder is therefore called ``NAME.previous`` between two
    renames. If a process is killed between them, the next call finds the folder under that name alone and restores it.
    """
    path = Path(path)
    target, began = Path(os.path.realpath(path)), False
    temporary, previous = (target.with_name(f"{target.name}.{mark}") for mark in ("part", "previous"))
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        if previous.is_dir() and not target.exists():
            os.replace(previous, target)
        for folder in (temporary, previous, target):
            check_holds_only(folder, ours)
        began = True  # from here on, these folders hold only our files
        for folder in (temporary, previous):
            _remove(folder)
        temporary.mkdir()
        yield temporary
        _swap(temporary, target, previous)
    except BaseException as error:
        with suppress(OSError):
            if began:
                _remove(temporary)
        cause = error.__cause__ if isinstance(error, AdaptiveFaceError) else error
        if isinstance(cause, OSError):  # from a file in the folder, or from the folder itself
            raise AdaptiveFaceError(f"{path}: {reason(cause)}; {_kept(target)}") from cause
        raise


def check_holds_only(folder: Path, ours: Callable[[str], bool]) -> None:
    """Raise :class:`AdaptiveFaceError` if ``folder`` exists and is not a folder, or holds anything that is not ours."""
    if not os.path.lexists(folder):
        return
    if not folder.is_dir():
        raise AdaptiveFaceError(f"{folder}: is a file, the name of a folder is expected")
    other = next((entry.name for entry in folder.iterdir() if not entry.is_file() or not ours(entry.name)), None)
    if other is not None:
        raise AdaptiveFaceError(f"{folder}: holds other files ({other}); name a new folder")


def reason(error: OSError) -> str:
    """A readable reason why something could not be written."""
    if error.errno in _FULL:
        return "no space left on the disk"
    return f"cannot be written ({error.strerror or error})"


def _mode_of(target: Path) -> int | None:
    """Permissions of the existing file, or None if there is none. Raises OSError if it must not be replaced."""
    try:
        status = target.stat()
    except FileNotFoundError:
        return None
    if not stat.S_ISREG(status.st_mode):
        raise OSError(errno.EINVAL, "not a regular file")
    if not os.access(target, os.W_OK):
        raise OSError(errno.EACCES, "the file is write-protected")
    return stat.S_IMODE(status.st_mode)


def _swap(temporary: Path, target: Path, previous: Path) -> None:
    if not target.exists():
        os.replace(temporary, target)
        return
    with CtrlC() as ctrl_c:  # these steps take milliseconds, and no folder may be left between two of them
        try:
            os.replace(target, previous)
            os.replace(temporary, target)
        except BaseException:  # the disk, or a second Ctrl-C
            if not target.exists():
                os.replace(previous, target)
            raise
        _remove(previous)
    ctrl_c.check()


def _remove(folder: Path) -> None:
    if folder.is_dir():
        for entry in folder.iterdir():
            entry.unlink()
        folder.rmdir()


def _kept(path: Path) -> str:
    return "what was there is unchanged" if path.exists() else "nothing was written"
