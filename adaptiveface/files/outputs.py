"""Check output paths before the work begins, so that no command fails on its output after an hour of work."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np

from ..errors import AdaptiveFaceError
from .archive import Archive
from .atomic import check_holds_only
from .bounded import open_regular
from .folders import make_parent

_HEAD_BYTES = 512
#: What a command reads: a file, a sensor's name, or nothing.
Input = str | os.PathLike[str] | None


def _npz(*members: str) -> Callable[[Path], bool]:
    def holds(path: Path) -> bool:
        with Archive(path, 1 << 62) as archive:
            return {f"{member}.npy" for member in members} <= set(archive.namelist())

    return holds


def _begins(*starts: bytes, at: int = 0) -> Callable[[Path], bool]:
    def begins(path: Path) -> bool:
        with open_regular(path, 1 << 62) as stream:
            head = stream.read(_HEAD_BYTES).removeprefix(b"\xef\xbb\xbf")[at:].lower()
        return head.startswith(starts)

    return begins


def _is_mdd(path: Path) -> bool:
    """Whether a file is an MDD. The format has no signature, but its length follows from its first eight bytes."""
    with open_regular(path, 1 << 62) as stream:
        frames, points = np.frombuffer(stream.read(8), ">i4").tolist()
    return path.stat().st_size == 8 + 4 * frames + 12 * frames * points


#: For each kind of file, the suffixes of its name, its name in messages, and a test for whether a file is of the kind.
KINDS: dict[str, tuple[tuple[str, ...], str, Callable[[Path], bool]]] = {
    "actor": ((".npz",), "an actor", _npz("neutral", "blendshapes", "feature_triangles")),
    "result": ((".npz",), "a result", _npz("vertices", "coefficients", "stage_ms")),
    "glb": ((".glb",), "a glTF file", _begins(b"gltf")),
    "avatar": ((".glb", ".gltf", ".vrm"), "a glTF file", _begins(b"gltf", b"{")),
    "usd": ((".usdc", ".usd", ".usda", ".usdz"), "a USD file", _begins(b"pxr-usdc", b"#usda", b"pk\3\4")),
    "usdz": ((".usdz",), "a USDZ package", _begins(b"pk\3\4")),
    "arkit-csv": ((".csv",), "a table of ARKit curves", _begins(b"timecode,")),
    "mdd": ((".mdd",), "a point cache", _is_mdd),
    "pc2": ((".pc2",), "a point cache", _begins(b"pointcache2")),
    "rest-mesh": ((".obj",), "an OBJ file of this package", _begins(b"# adaptiveface")),
    "scores": ((".csv",), "a table of scores", _begins(b"result,truth")),
    "mp4": ((".mp4",), "an MP4 video", _begins(b"ftyp", at=4)),
    "gif": ((".gif",), "a GIF", _begins(b"gif8")),
    "html": ((".html",), "a report", _begins(b"<!doctype html")),
}


def check_output(path: Path, kind: str, inputs: Iterable[Input] = ()) -> Path:
    """Refuse an output file that cannot or must not be written, and create its folder.

    Parameters
    ----------
    path : Path
        The output file.
    kind : str
        One of :data:`KINDS`. An existing file of another kind is not replaced.
    inputs : iterable of path-like or None
        Inputs of the same command. The output must not be one of these under any name or link.

    Returns
    -------
    Path
        The same path.

    Raises
    ------
    AdaptiveFaceError
        The message names the path and the reason.
    """
    suffixes, name, is_one = KINDS[kind]
    if path.suffix.lower() not in suffixes:
        raise AdaptiveFaceError(f"{path}: the output's name must end in {' or '.join(suffixes)}")
    if os.path.isdir(path):
        raise AdaptiveFaceError(f"{path}: is a folder, the name of a file is expected")
    check_no_input(path, inputs)
    if os.path.exists(path):
        _check_replaceable(path, name, is_one)
    make_parent(path)
    return path


def check_output_folder(path: Path, ours: Callable[[str], bool], inputs: Iterable[Input] = ()) -> Path:
    """Refuse an output folder that is a file, is an input, or holds files for which ``ours(name)`` is false."""
    check_no_input(path, inputs)
    check_holds_only(path, ours)
    _check_can_make(path)
    return path


def check_new_folder(path: Path, inputs: Iterable[Input] = ()) -> Path:
    """Refuse an output folder that already holds any file."""
    check_no_input(path, inputs)
    if os.path.exists(path) and not os.path.isdir(path):
        raise AdaptiveFaceError(f"{path}: is a file, the name of a new folder is expected")
    held = next((Path(at) / files[0] for at, _, files in os.walk(path) if files), None)
    if held is not None:
        raise AdaptiveFaceError(f"{path}: holds files already ({held.relative_to(path)}); name a new folder")
    _check_can_make(path)
    return path


def check_folder(path: Path) -> Path:
    """Refuse a folder that is a file or cannot be created. Files in an existing folder are kept."""
    if os.path.exists(path) and not os.path.isdir(path):
        raise AdaptiveFaceError(f"{path}: is a file, the name of a folder is expected")
    _check_can_make(path)
    return path


def check_no_input(path: Path, inputs: Iterable[Input]) -> None:
    """Raise :class:`AdaptiveFaceError` if ``path`` is the same file as one of the ``inputs``, under any name."""
    for given in inputs:
        texts = () if given is None else (os.fspath(given), os.fspath(given).partition(":")[2])  # "azure:FILE"
        if any(text and _same(path, text) for text in texts):
            raise AdaptiveFaceError(f"{path}: is also read by this command ({given}); name another output")


def check_distinct(*paths: Path | None) -> None:
    """Raise :class:`AdaptiveFaceError` if two outputs are the same file."""
    seen: list[Path] = []
    for path in filter(None, paths):
        if any(os.path.normcase(os.path.realpath(path)) == os.path.normcase(os.path.realpath(s)) for s in seen):
            raise AdaptiveFaceError(f"{path}: is the name of two outputs")
        seen.append(path)


def _same(path: Path, other: str) -> bool:
    try:
        return os.path.samefile(path, other)
    except (OSError, ValueError):  # one of them does not exist
        return False


def _check_replaceable(path: Path, name: str, is_one: Callable[[Path], bool]) -> None:
    """Raise unless the existing file may be replaced by one that is ``name``."""
    try:
        with open_regular(path, 1 << 62) as stream:
            empty = not stream.read(1)
        right = empty or is_one(path)
    except AdaptiveFaceError:
        right = False
    if not right:
        raise AdaptiveFaceError(f"{path}: what is there is not {name}; name another output, or remove it first")
    if not os.access(path, os.W_OK):
        raise AdaptiveFaceError(f"{path}: is write-protected; name another output")


def _check_can_make(path: Path) -> None:
    """Raise unless the folder exists or can be created, and can be written."""
    there = Path(os.path.realpath(path))
    while not os.path.lexists(there) and there != there.parent:
        there = there.parent
    if not there.is_dir():
        raise AdaptiveFaceError(f"{path}: {there} is not a folder")
    if not os.access(there, os.W_OK | os.X_OK):
        raise AdaptiveFaceError(f"{path}: no permission to write in {there}")
