"""Decide where files are cached: in the user's cache, else in a private temporary folder, else nowhere."""

from __future__ import annotations

import os
import stat
import tempfile
from pathlib import Path

from platformdirs import user_cache_path

NAME = "adaptiveface"


def cache_folders() -> list[Path]:
    """Folders that may hold cached files, the preferred one first. None of them is created.

    The user's cache is left out if the home is unknown, because it would be a folder named ``~`` in the current one. The
    temporary folder has the user's number in its name, because others can write beside it.
    """
    try:
        user = user_cache_path(NAME)
    except (RuntimeError, KeyError):  # newer versions of platformdirs look for the home themselves
        user = Path("~")
    known = [user] if user.is_absolute() and "~" not in user.parts else []
    number = os.getuid() if hasattr(os, "getuid") else "user"
    try:
        return [*known, Path(tempfile.gettempdir()) / f"{NAME}-{number}"]
    except FileNotFoundError:  # no folder for temporary files can be written
        return known


def cache_folder() -> Path | None:
    """The first of :func:`cache_folders` that can be written, or None. It is created if it is missing."""
    return next((folder for folder in cache_folders() if writable(folder)), None)


def writable(folder: Path) -> bool:
    """Whether files can be created in ``folder``. If it is missing, it is created for this user alone."""
    try:
        folder.mkdir(parents=True, exist_ok=True, mode=0o700)
        if not _ours(folder):
            return False
        with tempfile.TemporaryFile(dir=folder):
            return True
    except OSError:
        return False


def _ours(folder: Path) -> bool:
    """Whether nobody else can have written into the folder, because cached code is run.

    Others may write into the folder of temporary files.
    """
    if not hasattr(os, "getuid") or folder.parent != Path(tempfile.gettempdir()):
        return True
    status = os.lstat(folder)
    others = stat.S_IMODE(status.st_mode) & (stat.S_IWGRP | stat.S_IWOTH)
    return stat.S_ISDIR(status.st_mode) and status.st_uid == os.getuid() and not others
