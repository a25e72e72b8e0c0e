"""The fine surface and the curves that a remeshed vertex is projected to, as combinations of its vertices."""

from __future__ import annotations

import numpy as np
import trimesh
from scipy.spatial import cKDTree

from adaptiveface.geometry.mesh import vertex_normals

NORMAL_WEIGHT_MM = 6.0  # a unit of normal difference counts as this distance: keeps both sides of a thin fold apart


class ReferenceSurface:
    """Closest points on a triangle mesh, ``vertices`` (V, 3) and ``triangles`` (T, 3), preferring like normals."""

    def __init__(self, vertices: np.ndarray, triangles: np.ndarray):
        self.vertices, self.triangles = vertices, triangles
        normals = vertex_normals(vertices, triangles)
        self._tree = cKDTree(np.hstack([vertices, NORMAL_WEIGHT_MM * normals]))
        order = np.argsort(triangles.ravel(), kind="stable")
        count = np.bincount(triangles.ravel(), minlength=len(vertices))
        start = np.concatenate([[0], np.cumsum(count)])
        self._incident = np.full((len(vertices), count.max()), -1)
        column = np.arange(len(order)) - start[triangles.ravel()[order]]
        self._incident[triangles.ravel()[order], column] = order // 3

    def locate(self, points: np.ndarray, normals: np.ndarray, candidates: int = 3) -> tuple[np.ndarray, np.ndarray]:
        """Triangle number (n,) and barycentric weights (n, 3) of the closest points to ``points`` (n, 3)."""
        _, near = self._tree.query(np.hstack([points, NORMAL_WEIGHT_MM * normals]), k=candidates)
        best = np.full(len(points), np.inf)
        triangle, weights = np.zeros(len(points), int), np.zeros((len(points), 3))
        for c in range(candidates):
            for column in self._incident[near[:, c]].T:
                corners = self.vertices[self.triangles[column]]
                closest = trimesh.triangles.closest_point(corners, points)
                distance = ((closest - points) ** 2).sum(axis=1)
                closer = (column >= 0) & (distance < best)
                best[closer], triangle[closer] = distance[closer], column[closer]
                weights[closer] = trimesh.triangles.points_to_barycentric(corners[closer], closest[closer])
        return triangle, weights

    def closest(self, points: np.ndarray, normals: np.ndarray) -> np.ndarray:
        """(n, 3) closest points on the surface."""
        triangle, weights = self.locate(points, normals)
        return np.einsum("nk,nkd->nd", weights, self.vertices[self.triangles[triangle]])


class Polyline:
    """An open polyline through fine vertices ``ids`` (n,) of ``vertices``."""

    def __init__(self, ids, vertices: np.ndarray):
        self.ids = np.asarray(ids)
        self.points = vertices[self.ids]

    def locate(self, point: np.ndarray) -> tuple[int, float]:
        """Segment number i and parameter t: the closest point is (1 - t) points[i] + t points[i + 1]."""
        start, direction = self.points[:-1], np.diff(self.points, axis=0)
        t = ((point - start) * direction).sum(axis=1) / np.maximum((direction**2).sum(axis=1), 1e-12)
        t = np.clip(t, 0, 1)
        i = int(np.argmin(((start + t[:, None] * direction - point) ** 2).sum(axis=1)))
        return i, float(t[i])

    def closest(self, point: np.ndarray) -> np.ndarray:
        """(3,) closest point."""
        i, t = self.locate(point)
        return (1 - t) * self.points[i] + t * self.points[i + 1]
