"""Run the blocks of gallery.md and keep their pictures: ``python docs/make_gallery.py FOLDER`` (with result.npz, actor.npz)."""

from __future__ import annotations

import os
import re
import sys
from pathlib import Path

from PIL import Image

from adaptiveface.geometry.polydata import load_pyvista

HERE = Path(__file__).resolve().parent
BLOCK = re.compile(r"```python\n(.*?)```", re.DOTALL)


def draw(folder: Path) -> list[Path]:
    """Run the page's blocks in ``folder``; returns the pictures that they left, in the page's order."""
    load_pyvista()  # without a display, by EGL
    blocks = BLOCK.findall((HERE / "gallery.md").read_text(encoding="utf-8"))
    names: dict = {}
    before = Path.cwd()
    os.chdir(folder)
    try:
        for block in blocks:
            exec(compile(block, "gallery.md", "exec"), names)
    finally:
        os.chdir(before)
    return [folder / name for block in blocks for name in re.findall(r'"(\w+\.png)"', block)]


def main() -> None:
    """Draw, and keep the pictures as small JPEGs beside the others."""
    for path in draw(Path(sys.argv[1]).resolve()):
        target = HERE / "pictures" / f"gallery_{path.stem}.jpg"
        Image.open(path).convert("RGB").save(target, quality=82, optimize=True)
        print(target.name, target.stat().st_size)


if __name__ == "__main__":
    main()
