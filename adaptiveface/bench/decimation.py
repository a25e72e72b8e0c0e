"""Coarsen a mesh to some of its own vertices, so that no value of a vertex needs interpolation."""

from __future__ import annotations

import heapq
from collections.abc import Iterator

import numpy as np

from ..geometry.mesh import edges

#: Limits of a collapse: smallest cosine of the angle by which it turns a triangle, and largest number of neighbours after it.
MIN_TURN, MAX_NEIGHBOURS = 0.2, 9


def decimated(vertices: np.ndarray, triangles: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Collapse half-edges until ``count`` vertices are left.

    The method is that of Kobbelt et al. 1998, "A general framework for mesh decimation". The edge that is shortest relative
    to the edges that were around it goes first, so that the mesh becomes coarser by the same factor everywhere. Holes keep
    their place, because their vertices only move along their rims.

    Parameters
    ----------
    vertices : (V, 3) float array
        Vertices of the mesh, mm.
    triangles : (T, 3) int array
        Its triangles.
    count : int
        Number of vertices to keep.

    Returns
    -------
    kept : (count,) int array
        Numbers of the vertices that are left, ascending. There are a few more if no further collapse is allowed.
    triangles : (U, 3) int32 array
        The triangles over them.
    """
    mesh = _Mesh(vertices, triangles)
    order = [(mesh.cost(a, b), a, b) for a, b in mesh.pairs()]
    heapq.heapify(order)
    left = len(np.unique(triangles))
    while order and left > count:
        cost, gone, onto = heapq.heappop(order)
        if onto not in mesh.around.get(gone, ()) or cost != mesh.cost(gone, onto) or not mesh.allows(gone, onto):
            continue
        for neighbour in mesh.collapse(gone, onto):
            heapq.heappush(order, (mesh.cost(neighbour, onto), neighbour, onto))
            heapq.heappush(order, (mesh.cost(onto, neighbour), onto, neighbour))
        left -= 1
    rest = np.array(sorted({tuple(t) for corner in mesh.triangles.values() for t in corner}))
    kept, numbers = np.unique(rest, return_inverse=True)
    return kept, numbers.reshape(-1, 3).astype(np.int32)


class _Mesh:
    """Vertices with their neighbours and triangles as Python sets, of which a collapse changes a few.

    ``around`` maps a vertex to its neighbours. ``triangles`` maps a vertex to its triangles, each of which begins with its
    smallest vertex.
    """

    def __init__(self, vertices: np.ndarray, triangles: np.ndarray) -> None:
        self._points = vertices.tolist()
        self.around: dict[int, set[int]] = {}
        self.triangles: dict[int, set[tuple[int, int, int]]] = {}
        for a, b, c in triangles.tolist():
            self._add((a, b, c))
        pairs = edges(triangles)
        length = np.linalg.norm(vertices[pairs[:, 0]] - vertices[pairs[:, 1]], axis=1)
        both, size = pairs.T.ravel(), len(vertices)
        uses = np.maximum(np.bincount(both, minlength=size), 1)
        self._scale = (np.bincount(both, np.tile(length, 2), minlength=size) / uses).tolist()

    def pairs(self) -> Iterator[tuple[int, int]]:
        """Yield every edge in both directions."""
        return ((a, b) for a, around in self.around.items() for b in around)

    def cost(self, gone: int, onto: int) -> float:
        """Return the length of the edge divided by the original mean length around the vertex that would go."""
        a, b = self._points[gone], self._points[onto]
        return ((a[0] - b[0]) ** 2 + (a[1] - b[1]) ** 2 + (a[2] - b[2]) ** 2) ** 0.5 / self._scale[gone]

    def on_rim(self, vertex: int) -> bool:
        """Whether the vertex lies on the rim of a hole: it has more neighbours than triangles."""
        return len(self.around[vertex]) > len(self.triangles[vertex])

    def allows(self, gone: int, onto: int) -> bool:
        """Whether the mesh stays a surface with the same holes, and no triangle folds over."""
        common = self.around[gone] & self.around[onto]
        shared = len(self.triangles[gone] & self.triangles[onto])
        if len(common) != shared or (self.on_rim(gone) and shared != 1):
            return False
        if len(self.around[gone] | self.around[onto]) - 2 > MAX_NEIGHBOURS:
            return False
        return all(self._stays(t, gone, onto) for t in self.triangles[gone] if onto not in t)

    def _stays(self, triangle: tuple[int, int, int], gone: int, onto: int) -> bool:
        before = self._normal(triangle)
        after = self._normal(tuple(onto if v == gone else v for v in triangle))
        dot = sum(x * y for x, y in zip(before, after, strict=True))
        sizes = sum(x * x for x in before) * sum(x * x for x in after)
        return dot > MIN_TURN * sizes**0.5

    def _normal(self, triangle: tuple[int, ...]) -> tuple[float, float, float]:
        a, b, c = (self._points[v] for v in triangle)
        u, w = [q - p for p, q in zip(a, b, strict=True)], [q - p for p, q in zip(a, c, strict=True)]
        return u[1] * w[2] - u[2] * w[1], u[2] * w[0] - u[0] * w[2], u[0] * w[1] - u[1] * w[0]

    def collapse(self, gone: int, onto: int) -> set[int]:
        """Move a vertex onto its neighbour, and return the neighbours that this one has afterwards."""
        for t in list(self.triangles[gone]):
            for vertex in t:
                self.triangles[vertex].discard(t)
            if onto not in t:
                self._add(tuple(onto if v == gone else v for v in t))
        for vertex in self.around.pop(gone):
            self.around[vertex].discard(gone)
        del self.triangles[gone]
        return self.around[onto]

    def _add(self, triangle: tuple[int, ...]) -> None:
        first = triangle.index(min(triangle))
        turned = (triangle[first], triangle[(first + 1) % 3], triangle[(first + 2) % 3])
        for k, vertex in enumerate(turned):
            self.triangles.setdefault(vertex, set()).add(turned)
            self.around.setdefault(vertex, set()).update((turned[(k + 1) % 3], turned[(k + 2) % 3]))
