"""Check that OpenCV is installed once and whole. Its four distributions share the folder ``cv2`` and overwrite each other."""

from __future__ import annotations

import base64
import hashlib
from importlib.metadata import Distribution, distributions

from .finding import FAULT, NOTE, OK, Finding, failure

#: The distribution that adaptiveface asks for. It needs no display, and has everything that MediaPipe uses.
OURS = "opencv-contrib-python-headless"
_NAMES = ("opencv-python", "opencv-contrib-python", "opencv-python-headless", OURS)


def opencv() -> list[Finding]:
    """Find the installed distributions of OpenCV and the one whose files are on the disk, and check that it loads."""
    found = sorted((d for d in distributions() if _name(d) in _NAMES), key=_name)
    names = [_name(d) for d in found]
    wrong = {_name(d): overwritten(d) for d in found}
    whole = [name for name in names if not wrong[name]]
    text = ", ".join(f"{_name(d)} {d.version}" for d in found) or "not installed"
    error = failure("import cv2; cv2.aruco, cv2.Rodrigues")
    findings = []
    if error or not whole:
        reason = error or f"files of {names[0]} were overwritten or are missing ({wrong[names[0]][0]})"
        findings.append(Finding("OpenCV", "cv2", FAULT, f"{text}: {reason}", _mend(names)))
    elif len(found) > 1:
        others = ", ".join(name for name in names if name not in whole)
        reason = f"they overwrite each other; the files are {whole[0]}'s, those of {others or 'the other'} are gone"
        findings.append(Finding("OpenCV", "cv2", NOTE, f"{text}: {reason}", _mend(names)))
    else:
        findings.append(Finding("OpenCV", "cv2", OK, f"{text}, all files its own"))
    return findings


def _mend(names: list[str]) -> str:
    remove = f"python -m pip uninstall -y {' '.join(names)} && " if names else ""
    return f"{remove}python -m pip install --no-deps --force-reinstall {OURS}"


def overwritten(distribution: Distribution) -> list[str]:
    """List the files below ``cv2`` that are missing or differ from the distribution's record."""
    wrong = []
    for path in distribution.files or ():
        if path.parts[0] != "cv2" or path.hash is None or path.suffix in (".pyc", ".xml"):
            continue
        try:
            with open(path.locate(), "rb") as stream:
                digest = hashlib.file_digest(stream, path.hash.mode).digest()
        except OSError:
            wrong.append(str(path))
            continue
        if base64.urlsafe_b64encode(digest).rstrip(b"=").decode() != path.hash.value:
            wrong.append(str(path))
    return wrong


def _name(distribution: Distribution) -> str:
    return str(distribution.metadata["Name"] or "").lower().replace("_", "-")
