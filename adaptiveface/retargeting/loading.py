"""Load characters: those that are built in, and those in files of every supported format."""

from __future__ import annotations

import os
from importlib.resources import files
from pathlib import Path

from ..errors import ParameterError
from . import BUILT_IN
from .character import Character, load_character_npz


def load_character(source: str | os.PathLike, unit: float | None = None) -> Character:
    """Load a built-in character by its name, or another one from its file or folder.

    Parameters
    ----------
    source : str or path-like
        A name of ``BUILT_IN``, a .npz, .glb, .gltf or .vrm file, or a folder of OBJ files.
    unit : float, optional
        Millimetres per unit of length of the file or folder. By default, the format decides. OBJ files are scaled to the size
        of a head.

    Returns
    -------
    Character
        The character, in mm.

    Raises
    ------
    FileFormatError
        The message names the file and the reason.
    ParameterError
        The name is unknown.
    """
    text = os.fspath(source)
    path = Path(text)
    if text in BUILT_IN:
        return load_character_npz(str(files("adaptiveface") / "assets" / f"characters_{text}.npz"), text)
    if path.is_dir():
        from .obj_folder import load_obj_folder

        return load_obj_folder(path, unit)
    if is_gltf(text):
        from .gltf_character import load_gltf_character

        return load_gltf_character(path, unit)
    if path.suffix.lower() == ".npz":
        return load_character_npz(path)
    raise ParameterError(
        f"character '{text[:200]}': it is neither built in ({', '.join(BUILT_IN)}), nor a .glb, .gltf, .vrm or .npz file, nor "
        "a folder of OBJ files"
    )


def is_gltf(source: str | os.PathLike) -> bool:
    """Whether a character is a .glb, .gltf or .vrm file, judged by its name."""
    path = Path(source)
    return os.fspath(source) not in BUILT_IN and path.suffix.lower() in (".glb", ".gltf", ".vrm") and not path.is_dir()
