"""Check where things are cached, whether these folders can be written, and how much they hold."""

from __future__ import annotations

import os
from pathlib import Path

from ..caches import cache_folder, cache_folders, writable
from ..files.bounded import size
from .finding import FAULT, NOTE, OK, Finding, failure

_FREE = "set HOME or XDG_CACHE_HOME to a folder that can be written"


def caches() -> list[Finding]:
    """Check the cache folders, the compiled code and the detector's model."""
    folder = cache_folder()
    findings = []
    for number, place in enumerate(cache_folders()):
        if place == folder:
            state, text, fix = OK, f"{place}, in use, {size(_bytes(place))}", ""
            if number or len(cache_folders()) == 1:
                state, fix = NOTE, f"lost when temporary files are; {_FREE}"
        elif folder is None or number < cache_folders().index(folder):
            state, text, fix = NOTE, f"{place}: cannot be written", _FREE
        else:
            continue
        findings.append(Finding("caches", "cache folder", state, text, fix))
    if folder is None and not findings:
        findings.append(Finding("caches", "cache folder", NOTE, "none can be written", _FREE))
    return [*findings, _compiled(folder), _model()]


def _compiled(folder: Path | None) -> Finding:
    package = Path(__file__).resolve().parents[1]
    chosen = os.environ.get("NUMBA_CACHE_DIR")
    error = failure("from adaptiveface import mesh; import numpy as n; mesh.vertex_normals(n.eye(3), n.array([[0, 1, 2]]))")
    if error:
        return Finding("caches", "compiled code", FAULT, error, "python -m pip install --force-reinstall numba llvmlite")
    if chosen and writable(Path(chosen)):
        return Finding("caches", "compiled code", OK, f"{chosen} (NUMBA_CACHE_DIR)")
    if os.access(package / "__pycache__" if (package / "__pycache__").exists() else package, os.W_OK):
        return Finding("caches", "compiled code", OK, f"beside the modules in {package}")
    if folder is not None:
        return Finding("caches", "compiled code", OK, str(folder / "compiled"))
    return Finding("caches", "compiled code", NOTE, "made again by every process: nothing can be written", _FREE)


def _model() -> Finding:
    from ..landmarks.model_file import ENVIRONMENT, PLACE_IT, model_files

    named = os.environ.get(ENVIRONMENT)
    paths = [Path(named)] if named else model_files()
    found = next((path for path in paths if path.is_file()), None)
    if found is not None:
        return Finding("caches", "detector's model", OK, f"{found}, {size(found.stat().st_size)}")
    if named:
        return Finding("caches", "detector's model", FAULT, f"{named}: no such file", f"correct or unset {ENVIRONMENT}")
    return Finding(
        "caches",
        "detector's model",
        NOTE,
        "not there yet, fetched on first use",
        f"without a network: {PLACE_IT}",
    )


def _bytes(folder: Path) -> int:
    total = 0
    for root, _, names in os.walk(folder):
        for name in names:
            try:
                total += os.lstat(os.path.join(root, name)).st_size
            except OSError:
                continue
    return total
