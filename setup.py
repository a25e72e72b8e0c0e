"""Puts the notebooks into the wheel (as ``adaptiveface/_notebooks``); everything else is in pyproject.toml."""

import shutil
from pathlib import Path

from setuptools import setup
from setuptools.command.build_py import build_py


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


setup(cmdclass={"build_py": BuildWithNotebooks})
