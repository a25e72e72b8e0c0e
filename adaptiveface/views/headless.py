"""Rendering with and without a display: settings that must be made before VTK is imported."""

from __future__ import annotations

import os
import sys

from ..errors import MissingExtraError


def prepare_rendering():
    """Set up pyvista for notebooks and return it; raises :class:`MissingExtraError` where it is not installed.

    On Linux without a display VTK is told to use EGL. Multisampling is off: in software it triples a picture's time.
    """
    if sys.platform.startswith("linux") and not os.environ.get("DISPLAY"):
        if not os.environ.get("VTK_DEFAULT_OPENGL_WINDOW"):  # set but empty, VTK crashes
            os.environ["VTK_DEFAULT_OPENGL_WINDOW"] = "vtkEGLRenderWindow"
    try:
        import pyvista
    except ImportError:
        raise MissingExtraError('the views need pyvista: python -m pip install "adaptiveface[notebooks]"') from None
    pyvista.global_theme.multi_samples = 1
    pyvista.global_theme.font.color = "black"
    return pyvista
