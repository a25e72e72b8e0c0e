"""Sphinx settings: ``python -m sphinx -W docs docs/_build``, after ``python docs/execute_notebooks.py`` with outputs.

``-t quick``, for tests, leaves out the pages with the source of every module, and all but a few pages of the reference.
"""

import importlib.util
import os
import sys
from pathlib import Path

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE / "_ext"), str(HERE.parent)]

import buttons  # noqa: E402
import generated  # noqa: E402

from adaptiveface import __version__  # noqa: E402

project = "adaptiveface"
author = "the adaptiveface developers"
copyright = author
release = version = __version__

quick = tags.has("quick")  # noqa: F821 - Sphinx puts it here
extensions = ["myst_nb", "sphinx.ext.autodoc", "generated", "mathml"]
if not quick:
    extensions.append("sphinx.ext.viewcode")
exclude_patterns = ["_build", "_executed", "_ext", "tables"]
html_theme = "furo"
html_title = "adaptiveface"
html_static_path = ["_static", "../adaptiveface/assets/saved_heads.js"]  # and what draws heads in saved notebooks
html_css_files = ["site.css"]
html_js_files = [("saved_heads.js", {"defer": "defer"})]
html_show_sphinx = False
html_math_renderer = "mathml"
myst_enable_extensions = ["dollarmath", "amsmath"]
myst_heading_anchors = 3

nb_execution_mode = "off"  # execute_notebooks.py runs them once
# Notebooks without stored outputs name no output type; widgets have none outside Jupyter. A short name in a signature may be
# that of several objects.
suppress_warnings = ["mystnb.unknown_mime_type", "ref.python"]

autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_preserve_defaults = True
# Optional packages that are not installed: their modules are documented all the same.
autodoc_mock_imports = [
    name
    for name in (
        "mediapipe",
        "h5py",
        "open3d",
        "igl",
        "sklearn",
        "ipywidgets",
        "anywidget",
        "pyvista",
        "IPython",
        "dask",
        "distributed",
    )
    if importlib.util.find_spec(name) is None
]

generated.write_pages(
    HERE,
    ("adaptiveface", "adaptiveface.geometry.polydata", "adaptiveface.registration.step") if quick else None,
    buttons.repository(os.environ, (HERE.parent / "pyproject.toml").read_text(encoding="utf-8")),
)
