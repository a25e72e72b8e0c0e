"""Smoothing and extending displacement fields on the tracking mesh with the bi-Laplacian energy.

The energy of a field d is E(d) = sum over coordinates of d^T L A^-1 L d (L cotangent Laplacian, A vertex areas): the
thin-plate energy of Botsch & Kobbelt 2004, whose minimisers are smooth in value and in slope.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import spsolve

from adaptiveface.geometry.mesh import cotangent_laplacian, vertex_areas


class FieldSmoother:
    """Thin-plate energy of one mesh: ``vertices`` (V, 3) mm, ``triangles`` (T, 3)."""

    def __init__(self, vertices: np.ndarray, triangles: np.ndarray):
        laplacian = cotangent_laplacian(vertices, triangles, non_negative=True)
        self.areas = vertex_areas(vertices, triangles)
        self.energy = (laplacian @ sp.diags(1 / self.areas) @ laplacian).tocsr()

    def smooth(self, field: np.ndarray, length: float, weight: np.ndarray | float = 1.0) -> np.ndarray:
        """Minimise sum_i a_i w_i |d_i - field_i|^2 + length^4 E(d): removes detail below about ``length`` mm.

        ``weight`` (V,) or a number: how firmly each vertex holds to its value (large on the contours to keep).
        """
        data = sp.diags(self.areas * np.broadcast_to(weight, len(field)))
        return spsolve((data + length**4 * self.energy).tocsc(), data @ field)

    def extend(self, values: np.ndarray, at: np.ndarray, region: np.ndarray) -> np.ndarray:
        """The smoothest field with ``values`` (k, d) at vertices ``at`` (k,), zero outside ``region`` (V,) bool."""
        field = np.zeros((len(region), values.shape[1]))
        field[at] = values
        free = region.copy()
        free[at] = False
        field[free] = spsolve(self.energy[free][:, free].tocsc(), -(self.energy[free] @ field)).reshape(-1, values.shape[1])
        return field
