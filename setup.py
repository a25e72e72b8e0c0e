"""Puts the notebooks into the wheel (as ``adaptiveface/_notebooks``), and lets two builds of one commit be equal.

Everything else is in pyproject.toml.
"""

import gzip
import os
import shutil
import tarfile
from pathlib import Path

from setuptools import setup
from setuptools.command.build_py import build_py
from setuptools.command.sdist import sdist


class BuildWithNotebooks(build_py):
    """Copies ``notebooks/`` into the built package; an editable install reads them from the checkout instead."""

    def run(self) -> None:
        super().run()
        if not self.editable_mode:
            source = Path(__file__).parent / "notebooks"
            target = Path(self.build_lib) / "adaptiveface" / "_notebooks"
            shutil.rmtree(target, ignore_errors=True)
            for path in source.rglob("*.ipynb"):
                if ".ipynb_checkpoints" not in path.parts:
                    copy = target / path.relative_to(source)
                    copy.parent.mkdir(parents=True, exist_ok=True)
                    shutil.copyfile(path, copy)


class ReproducibleSdist(sdist):
    """With SOURCE_DATE_EPOCH set, every entry of the archive has that time and no owner, and the entries are sorted."""

    def make_archive(self, base_name, format, root_dir=None, base_dir=None, **options):
        """As setuptools does, except for a .tar.gz with a given time."""
        epoch = os.environ.get("SOURCE_DATE_EPOCH")
        if epoch is None or format != "gztar":
            return super().make_archive(base_name, format, root_dir=root_dir, base_dir=base_dir, **options)
        path, folder = Path(f"{base_name}.tar.gz"), Path(root_dir or ".") / base_dir
        path.parent.mkdir(parents=True, exist_ok=True)

        def plain(entry: tarfile.TarInfo) -> tarfile.TarInfo:
            entry.mtime, entry.uid, entry.gid, entry.uname, entry.gname = int(epoch), 0, 0, "", ""
            entry.mode = 0o755 if entry.isdir() or entry.mode & 0o100 else 0o644
            return entry

        with open(path, "wb") as raw, gzip.GzipFile("", "wb", mtime=int(epoch), fileobj=raw) as stream:
            with tarfile.open(fileobj=stream, mode="w", format=tarfile.PAX_FORMAT) as archive:
                for file in sorted([folder, *folder.rglob("*")]):
                    archive.add(file, Path(base_dir) / file.relative_to(folder), recursive=False, filter=plain)
        return str(path)


setup(cmdclass={"build_py": BuildWithNotebooks, "sdist": ReproducibleSdist})
