"""Rendering with and without a display: settings for the pictures that VTK draws."""

from __future__ import annotations

from ..polydata import load_pyvista


def prepare_rendering():
    """Set up pyvista for notebooks and return it; raises :class:`MissingExtraError` where it is not installed.

    Multisampling is off: in software it triples a picture's time.
    """
    pyvista = load_pyvista()
    pyvista.global_theme.multi_samples = 1
    pyvista.global_theme.font.color = "black"
    return pyvista
