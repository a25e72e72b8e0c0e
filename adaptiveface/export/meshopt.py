"""Compress ``.glb`` files (``EXT_meshopt_compression``) with gltfpack, the tool of the library that defines the format."""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
from pathlib import Path

from ..errors import AdaptiveFaceError, MissingExtraError
from ..files import replacing
from .animation import AnimatedMesh
from .gltf import write_glb

TOOL, INSTALL = "gltfpack", "npm install --global gltfpack"
#: Coordinates have 16 bits and normals 8. Keys, names and extras are kept unchanged.
OPTIONS = ("-cc", "-vp", "16", "-vn", "8", "-at", "16", "-ar", "16", "-af", "0", "-kn", "-km", "-ke")
#: Longest time that the tool may take, s.
PATIENCE = 600.0


def find_gltfpack() -> str:
    """Path of gltfpack. Raises :class:`MissingExtraError` with the command that installs it if it is missing."""
    found = shutil.which(TOOL)
    if found is None:
        raise MissingExtraError(f"--meshopt needs {TOOL}, which is not on the PATH: {INSTALL}, or use --compact instead")
    return found


def write_meshopt_glb(path: str | os.PathLike, mesh: AnimatedMesh) -> None:
    """Write an animated mesh as a compressed ``.glb``, whole or not at all.

    The file holds what :func:`write_glb` writes, in another order of vertices. Programs need a decoder of
    ``EXT_meshopt_compression`` to read it: three.js, Babylon.js and model-viewer have one, Blender has none.

    Raises
    ------
    MissingExtraError
        gltfpack is not installed.
    AdaptiveFaceError
        gltfpack fails. The message repeats what it printed.
    """
    tool = find_gltfpack()
    with tempfile.TemporaryDirectory() as folder, replacing(path) as part:
        plain, packed = Path(folder) / "plain.glb", Path(folder) / "packed.glb"
        write_glb(plain, mesh)
        command = [tool, "-i", str(plain), "-o", str(packed), *OPTIONS]
        try:
            run = subprocess.run(command, capture_output=True, text=True, errors="replace", timeout=PATIENCE)
        except (OSError, subprocess.TimeoutExpired) as error:
            raise AdaptiveFaceError(f"{path}: {TOOL}: {error}") from error
        if run.returncode or not packed.exists():
            raise AdaptiveFaceError(f"{path}: {TOOL} failed: {(run.stderr or run.stdout).strip()[-300:]}")
        shutil.copyfile(packed, part)
