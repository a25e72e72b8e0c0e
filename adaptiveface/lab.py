"""Start JupyterLab on a writable copy of the notebooks, on this machine only.

The copy belongs to the learner: a notebook that was changed is never overwritten, one that was not follows the package.
Everything JupyterLab needs is set for this one process (environment and command line); nothing is written outside the
folder.
"""

from __future__ import annotations

import hashlib
import importlib.util
import json
import os
import shutil
import socket
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

from .errors import AdaptiveFaceError, FileFormatError, MissingExtraError
from .files import is_own, read_bytes, read_json, replacing

LOOPBACK = "127.0.0.1"
#: Own files inside the learner's folder: settings for JupyterLab, fingerprints of the notebooks as they were copied.
STATE = ".adaptiveface"
NEEDED = ("jupyterlab", "ipykernel", "ipywidgets", "anywidget", "pyvista")
#: A notebook with the pictures of its outputs.
MAX_NOTEBOOK_BYTES = 256 << 20
PIP_LINE = 'pip install "adaptiveface[notebooks]"'

#: JupyterLab settings: widget callbacks on the kernel's main thread (an OpenGL context belongs to the thread that made
#: it, from another one it draws black), and no news fetched from the network.
SETTINGS = {
    "@jupyterlab/apputils-extension:kernels-settings": {"commsOverSubshells": "disabled"},
    "@jupyterlab/apputils-extension:notification": {"fetchNews": "false", "checkForUpdates": False},
}
#: What JupyterLab's page is told: no build. A package with an extension in source form (dash, which Open3D brings) otherwise
#: puts a dialog "Build Recommended" in front of the notebook, whose answer needs Node.js and the network.
PAGE = {"buildCheck": False, "buildAvailable": False}


def packaged_notebooks() -> Path:
    """Folder of the notebooks: inside the installed package, or beside it in a checkout."""
    for folder in (Path(__file__).parent / "_notebooks", Path(__file__).resolve().parents[1] / "notebooks"):
        if any(folder.glob("*.ipynb")):
            return folder
    here = Path(__file__).parent
    raise AdaptiveFaceError(f"the notebooks are missing from the installation ({here}); install it again")


@dataclass(frozen=True)
class Copied:
    """What :func:`copy_notebooks` did, as relative names: new, updated, and changed by the learner (kept)."""

    new: tuple[str, ...]
    updated: tuple[str, ...]
    kept: tuple[str, ...]


def copy_notebooks(folder: Path, source: Path | None = None) -> Copied:
    """Copy the notebooks to ``folder``; a file that differs from what was copied before stays as it is.

    Raises OSError where the folder cannot be written.
    """
    source = source or packaged_notebooks()
    record = folder / STATE / "copied.json"
    known = _read_record(record)
    new, updated, kept = [], [], []
    for path in sorted(p for p in source.rglob("*.ipynb") if ".ipynb_checkpoints" not in p.parts and is_own(p)):
        name = path.relative_to(source).as_posix()
        target, wanted = folder / name, _fingerprint(path)
        if target.exists():
            present = _fingerprint(target)
            if present == wanted:
                known[name] = wanted
                continue
            if known.get(name) != present:
                kept.append(name)
                continue
            updated.append(name)
        else:
            new.append(name)
        target.parent.mkdir(parents=True, exist_ok=True)
        with replacing(target) as temporary:
            shutil.copyfile(path, temporary)  # not the mode: an installed file may be read-only
        known[name] = wanted
    record.parent.mkdir(parents=True, exist_ok=True)
    with replacing(record) as temporary:
        temporary.write_text(json.dumps(known, indent=1, sort_keys=True) + "\n", encoding="utf-8")
    return Copied(tuple(new), tuple(updated), tuple(kept))


def _fingerprint(path: Path) -> str:
    return hashlib.sha256(read_bytes(path, MAX_NOTEBOOK_BYTES)).hexdigest()


def _read_record(path: Path) -> dict[str, str]:
    """Fingerprints of an earlier run; a damaged file only means that nothing is taken for unchanged."""
    try:
        known = read_json(path, 1 << 20)
    except FileFormatError:
        return {}
    return known if isinstance(known, dict) else {}


def lab_environment(folder: Path, environment: dict[str, str] | None = None) -> dict[str, str]:
    """The environment for JupyterLab and its kernels; writes its settings below ``folder``.

    Without a display VTK must be told to use EGL; an empty value of that variable crashes it. The empty folder for
    WebAssembly keeps trame from a download at its start. With jupyter-server-proxy pyvista's own views share the port.
    """
    values = dict(os.environ if environment is None else environment)
    state = (folder / STATE).resolve()
    settings = state / "config" / "labconfig"
    settings.mkdir(parents=True, exist_ok=True)
    for name, content in (("default_setting_overrides", SETTINGS), ("page_config", PAGE)):
        with replacing(settings / f"{name}.json") as temporary:
            temporary.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    (state / "no-wasm").mkdir(exist_ok=True)
    others = [values["JUPYTER_CONFIG_PATH"]] if values.get("JUPYTER_CONFIG_PATH") else []
    values["JUPYTER_CONFIG_PATH"] = os.pathsep.join([str(state / "config"), *others])
    values.setdefault("VTK_WASM_DIR_OVERRIDE", str(state / "no-wasm"))
    headless = sys.platform.startswith("linux") and not (values.get("DISPLAY") or values.get("WAYLAND_DISPLAY"))
    if headless and not values.get("VTK_DEFAULT_OPENGL_WINDOW"):
        values["VTK_DEFAULT_OPENGL_WINDOW"] = "vtkEGLRenderWindow"
    if importlib.util.find_spec("jupyter_server_proxy"):
        values.setdefault("PYVISTA_TRAME_SERVER_PROXY_PREFIX", "/proxy/")
    return values


def lab_command(folder: Path, port: int | None = None, browser: bool = True, notebook: str | None = None) -> list[str]:
    """The command line of JupyterLab on ``folder``: this machine only, with Jupyter's own token.

    ``notebook``: the one to show at first, by default the first by name.
    """
    command = [
        sys.executable,
        "-m",
        "jupyterlab",
        f"--ServerApp.root_dir={folder.resolve()}",
        f"--ServerApp.ip={LOOPBACK}",
        "--ServerApp.allow_remote_access=False",
    ]
    first = notebook or min((path.name for path in folder.glob("*.ipynb") if is_own(path)), default=None)
    if first:
        command.append(f"--LabApp.default_url=/lab/tree/{first}")
    if port is not None:
        command += [f"--ServerApp.port={port}", "--ServerApp.port_retries=0"]
    if not browser:
        command.append("--no-browser")
    if hasattr(os, "geteuid") and os.geteuid() == 0:
        command.append("--allow-root")  # containers; without it Jupyter refuses to start
    return command


def check_installed() -> None:
    """Raise :class:`MissingExtraError` with the pip line where a package that the notebooks need is not installed."""
    missing = [name for name in NEEDED if importlib.util.find_spec(name) is None]
    if missing:
        raise MissingExtraError(f"{', '.join(missing)} not installed; the notebooks need: {PIP_LINE}")


def open_lab(folder: Path, port: int | None = None, browser: bool = True, notebook: str | None = None) -> int:
    """Copy the notebooks to ``folder`` and run JupyterLab there until it is shut down; returns its exit status.

    ``notebook``: the one to show at first.

    Raises :class:`MissingExtraError` without JupyterLab and :class:`AdaptiveFaceError` where ``port`` is taken.
    """
    check_installed()
    _check_port(port)
    if folder.exists() and not folder.is_dir():
        raise AdaptiveFaceError(f"{folder}: is a file, a folder for the notebooks is expected")
    copied = copy_notebooks(folder)
    print(f"notebooks: {folder.resolve()}")
    if copied.updated:
        print(f"updated: {', '.join(copied.updated)}")
    if copied.kept:
        print(f"kept as you changed them: {', '.join(copied.kept)} (rename or delete one to get a fresh copy)")
    sys.stdout.flush()
    return _become(lab_command(folder, port, browser, notebook), lab_environment(folder))


def _become(command: list[str], environment: dict[str, str]) -> int:
    """Replace this process by the command, so that every signal reaches it; where that is impossible, wait for it."""
    if os.name == "posix":
        os.execve(command[0], command, environment)
    server = subprocess.Popen(command, env=environment)
    while True:
        try:
            return server.wait()
        except KeyboardInterrupt:  # Ctrl-C reaches JupyterLab too, which asks and then shuts its kernels down
            continue


def _check_port(port: int | None) -> None:
    if port is None:
        return
    with socket.socket() as probe:
        if os.name == "posix":
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((LOOPBACK, port))
        except OSError:
            raise AdaptiveFaceError(f"port {port} is taken or not allowed; choose another one with --port") from None
