"""Check versions, optional parts, the sensors' libraries, graphics, and what the notebooks need."""

from __future__ import annotations

import ctypes
import functools
import os
import platform
import shutil
import sys
from importlib.metadata import packages_distributions

from .. import __version__
from .finding import FAULT, NOTE, OK, Finding, failure, importable, installed

#: Distributions that every command needs, and their modules.
NEEDED = {
    "numpy": "numpy",
    "scipy": "scipy",
    "numba": "numba",
    "llvmlite": "llvmlite",
    "threadpoolctl": "threadpoolctl",
    "tqdm": "tqdm",
    "trimesh": "trimesh",
    "matplotlib": "matplotlib",
    "platformdirs": "platformdirs",
    "pillow": "PIL",
    "jinja2": "jinja2",
}
#: The modules of each extra, and their purpose.
EXTRAS = {
    "landmarks": (("mediapipe", "av", "pooch"), "2D features in colour pictures, videos"),
    "video": (("imageio_ffmpeg",), "H.264 films"),
    "usd": (("pxr",), "USD files"),
    "osc": (("pythonosc",), "streams to VTuber programs"),
    "notebooks": (("jupyterlab", "ipywidgets", "anywidget", "pyvista", "vtk"), "the notebooks"),
    "avatars": (("DracoPy", "meshopt"), "compressed characters"),
    "importers": (("h5py",), "other face models"),
    "pandas": (("pandas",), "results as tables"),
    "batch": (("pyarrow",), "tables as Parquet"),
    "cluster": (("distributed",), "sweeps on Dask"),
    "bench": (("open3d", "sklearn", "igl", "psutil"), "the peers of the timing tables"),
    "model": (("embreex", "pyvista"), "building the face model anew"),
    "blender": (("bpy",), "tests inside Blender"),
    "docs": (("sphinx", "myst_nb", "furo", "latex2mathml"), "building the documentation"),
}
#: The modules of each sensor's extra, and the sensor.
SENSORS = {
    "realsense": (("pyrealsense2",), "RealSense D400"),
    "record3d": (("record3d", "lzfse"), "iPhone TrueDepth"),
    "azure": (("pyk4a",), "Azure Kinect"),
    "orbbec": (("pyorbbecsdk",), "Orbbec"),
    "oak": (("depthai",), "OAK-D"),
    "kinect2": (("kinect_next",), "Kinect v2 (Windows)"),
}
#: Heavy modules that do not load if the system lacks a library, although they are installed.
_LOADED = {"mediapipe": "import mediapipe.tasks.python.vision", "pyvista": "import pyvista"}
#: Extras that ask for a NumPy that other parts do not work with.
_APART = dict.fromkeys(("azure", "orbbec"), ", in an environment of its own")
_APT = "on Debian or Ubuntu: apt install"


def versions() -> list[Finding]:
    """Check Python, adaptiveface, and what every command needs."""
    right = (3, 11) <= sys.version_info[:2] <= (3, 13)
    found = [
        Finding(
            "versions",
            "python",
            OK if right else FAULT,
            f"{platform.python_version()} on {platform.platform()}",
            "" if right else "install Python 3.11, 3.12 or 3.13",
        ),
        Finding("versions", "adaptiveface", OK, __version__),
    ]
    for name, module in NEEDED.items():
        error = failure(f"import {module}")
        fix = f"python -m pip install --force-reinstall {name}" if error else ""
        found.append(Finding("versions", name, FAULT if error else OK, error or installed(name) or "", fix))
    return found


def optional() -> list[Finding]:
    """Check every extra, and give the line that installs it."""
    return [_extra("optional parts", extra, *entry) for extra, entry in EXTRAS.items()]


def sensors() -> list[Finding]:
    """Check the libraries of the sensors' makers."""
    found = [_extra("sensors", extra, *entry) for extra, entry in SENSORS.items()]
    for name, libraries, package in (
        ("Carmine, Xtion", ("libOpenNI2.so.0", "libOpenNI2.so", "libOpenNI2.dylib", "OpenNI2.dll"), "libopenni2-0"),
        ("Kinect v1", ("libfreenect.so.0.5", "libfreenect.so.0", "libfreenect.dylib", "freenect.dll"), "libfreenect0.5"),
    ):
        there = next(filter(_loads, libraries), None)
        fix = "" if there else f"{_APT} {package}"
        found.append(Finding("sensors", name, OK if there else NOTE, there or "library not found", fix))
    return found


def _extra(group: str, extra: str, modules: tuple[str, ...], purpose: str) -> Finding:
    line = f'python -m pip install "adaptiveface[{extra}]"' + _APART.get(extra, "")
    missing = [module for module in modules if not importable(module)]
    if missing:
        some = len(missing) < len(modules)
        text = f"{purpose}: {', '.join(missing) if some else ''} not installed".replace(":  ", ": ")
        return Finding(group, extra, NOTE, text, line)
    for module in modules:
        error = failure(_LOADED[module]) if module in _LOADED else None
        if error:
            fix = f"{_APT} libegl1 libgles2 libgl1 libglib2.0-0; or {line.replace('install', 'install --force-reinstall')}"
            return Finding(group, extra, FAULT, f"{purpose}: {module} does not load ({error})", fix)
    return Finding(group, extra, OK, f"{purpose} ({', '.join(map(_with_version, modules))})")


def _with_version(module: str) -> str:
    distribution = next(iter(_distributions().get(module, ())), module)
    return f"{distribution} {installed(distribution) or ''}".strip()


_distributions = functools.cache(packages_distributions)


def graphics() -> list[Finding]:
    """Check the system's libraries for drawing without a display, which MediaPipe and the notebooks' views load."""
    if not sys.platform.startswith("linux"):
        return [Finding("graphics", "OpenGL", OK, "part of the system")]
    found = []
    for name, library, package in (
        ("EGL", "libEGL.so.1", "libegl1"),
        ("OpenGL ES", "libGLESv2.so.2", "libgles2"),
        ("OpenGL", "libGL.so.1", "libgl1 libgl1-mesa-dri"),
    ):
        there = _loads(library)
        text = library if there else f"{library} is missing: MediaPipe and the notebooks' views need it"
        found.append(Finding("graphics", name, OK if there else NOTE, text, "" if there else f"{_APT} {package}"))
    display = os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    found.append(Finding("graphics", "display", OK, display or "none: pictures are drawn off screen"))
    return found


def browser() -> list[Finding]:
    """Check what the notebooks need besides Python: a browser on this machine, or a tunnel to it."""
    names = ("chromium", "google-chrome", "firefox", "microsoft-edge", "safari")
    there = next(filter(None, map(shutil.which, names)), None) or ("" if sys.platform.startswith("linux") else "the system's")
    fix = "" if there else "adaptiveface lab --no-browser, and ssh -L 8888:localhost:8888 from a machine with one"
    return [Finding("notebooks", "browser", OK if there else NOTE, there or "none on this machine", fix)]


def _loads(library: str) -> bool:
    try:
        ctypes.CDLL(library)
    except OSError:
        return False
    return True
