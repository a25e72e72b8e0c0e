"""Rows of the table of exports for what runs in a browser: model-viewer, Babylon.js, three-vrm; with their pictures."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import avatar_page
import numpy as np
import pytest
import web
from avatar_files import vrm_with_presets
from viewer_pages import page

from adaptiveface import Result
from adaptiveface.export.avatar import Avatar
from adaptiveface.retargeting.retarget import retarget

Row = tuple[str, str, str]


def framed(picture: np.ndarray) -> str:
    """How much of the picture's height the face takes, and how far its middle is from the picture's."""
    rows, columns = np.nonzero((picture < 245).any(axis=2))
    size = len(picture)
    off = np.abs(np.array([rows.min() + rows.max(), columns.min() + columns.max()]) / 2 / size - 0.5).max()
    return f"face {np.ptp(rows) / size:.0%} of the height, {off:.1%} off the middle"


def viewer_rows(folder: Path, files: dict[str, Path], result: Result, pictures: Path | None = None) -> Iterator[Row]:
    """What the viewers show of .glb ``files`` by name, and three-vrm of avatars that perform ``result``."""
    try:
        modules = web.install(folder / "viewers", web.MODEL_VIEWER, *web.BABYLON, web.THREE, web.THREE_VRM)
        for name, path in files.items():
            for viewer, title in (("model-viewer", "model-viewer"), ("babylon", "Babylon.js")):
                work = folder / f"page-{viewer}-{name}"
                answer = web.ask(work, modules, page(viewer, playing=True), {"x.glb": path})
                shown = web.picture(answer["picture"], pictures and pictures / f"{viewer}-{name}.png")
                yield title, f"{name}, .glb", f"{framed(shown)}; plays {', '.join(answer['animations'])}"
            yield (
                "three-vrm",
                f"{name}, .glb",
                _played(folder / f"page-vrm-{name}", modules, path, pictures, f"three-vrm-{name}"),
            )
        for kind, version in (("VRM", "0.x"), ("VRMC_vrm", "1.0")):
            own = vrm_with_presets(kind).save(folder / f"own-{kind}.vrm")
            Avatar(own).write(folder / f"{kind}.vrm", retarget(result))
            said = _played(folder / f"page-{kind}", modules, folder / f"{kind}.vrm", pictures, f"three-vrm-{kind}", "Head")
            yield "three-vrm", f"avatar, VRM {version}", said
    except pytest.skip.Exception as absent:
        yield "viewers", "all", f"not run: {absent}"


def _played(work: Path, modules: Path, path: Path, pictures: Path | None, name: str, bone: str | None = None) -> str:
    file = f"x{path.suffix}"
    times = [0.0, 0.3, 0.6]
    answer = web.ask(work, modules, avatar_page.page(file, times, bone), {file: path})
    for number, frame in enumerate(answer["frames"]):
        web.picture(frame["picture"], pictures and pictures / f"{name}-{number}.png")
    kind = f"VRM {answer['vrm']}" if answer["vrm"] else "glTF"
    moved = max(answer["moved"]) / answer["extent"]
    return f"{kind}, {answer['duration']:.2f} s, {len(answer['names'])} shapes, vertices move by {moved:.1%} of the head"
