"""The folder of an output: made when its name is known, so that a path that cannot be written fails before the work."""

from __future__ import annotations

import os
from pathlib import Path

from ..errors import AdaptiveFaceError


def make_parent(path: str | os.PathLike) -> None:
    """Make the folder in which ``path`` will be written, and those above it.

    Raises
    ------
    AdaptiveFaceError
        The folder cannot be made, or nothing can be written in it. The message names ``path`` and the folder.
    """
    folder = Path(os.path.realpath(path)).parent
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise AdaptiveFaceError(f"{path}: the folder {folder} cannot be made ({error.strerror or error})") from None
    if not os.access(folder, os.W_OK | os.X_OK):
        raise AdaptiveFaceError(f"{path}: no permission to write in the folder {folder}")
