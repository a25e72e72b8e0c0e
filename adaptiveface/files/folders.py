"""Create the folder of an output early, so that a path that cannot be written fails before the work begins."""

from __future__ import annotations

import os
from pathlib import Path

from ..errors import AdaptiveFaceError


def make_parent(path: str | os.PathLike) -> None:
    """Create the folder in which ``path`` will be written, and its parents.

    Raises
    ------
    AdaptiveFaceError
        The folder cannot be created, or nothing can be written in it. The message names ``path`` and the folder.
    """
    folder = Path(os.path.realpath(path)).parent
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise AdaptiveFaceError(f"{path}: the folder {folder} cannot be made ({error.strerror or error})") from None
    if not os.access(folder, os.W_OK | os.X_OK):
        raise AdaptiveFaceError(f"{path}: no permission to write in the folder {folder}")
