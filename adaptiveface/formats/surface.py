"""Convert colours and normals to the form in which files of meshes store them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..geometry.mesh import vertex_normals


def linear_colours(colours: np.ndarray | Sequence[int]) -> np.ndarray:
    """Convert sRGB (..., 3), 0 to 255, to linear light (..., 3), 0 to 1."""
    colours = np.asarray(colours, float)
    return np.where(colours <= 10, colours / 3294.6, ((colours / 255 + 0.055) / 1.055) ** 2.4)


def srgb_colours(linear: np.ndarray) -> np.ndarray:
    """Convert linear light (..., 3), 0 to 1, to sRGB (..., 3) uint8."""
    linear = np.clip(linear.astype(float), 0, 1)
    curved = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    return np.rint(255 * curved).astype(np.uint8)


def unit_normals(vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """(V, 3) float32 normals of unit length; (0, 0, 1) for a vertex without triangles."""
    normals = vertex_normals(vertices, triangles).astype(np.float32)
    normals[np.linalg.norm(normals, axis=1) < 0.5] = (0.0, 0.0, 1.0)
    return normals


def normal_changes(vertices: np.ndarray, target: np.ndarray, triangles: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """(V, 3) float32 by which a morph target (V, 3) turns the normals of vertices (V, 3); tiny changes are zero."""
    turned = unit_normals(vertices + target, triangles) - normals
    turned[np.abs(turned).max(axis=1) < 1e-4] = 0.0
    return turned
