"""A coarser mesh on some of a mesh's own vertices, so that whatever the vertices carry needs no interpolation."""

from __future__ import annotations

import heapq
from collections.abc import Iterator

import numpy as np

from ..geometry.mesh import edges

#: A collapse may not turn a triangle by more than this cosine, nor give a vertex more neighbours than this.
MIN_TURN, MAX_NEIGHBOURS = 0.2, 9


def decimated(vertices: np.ndarray, triangles: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Half-edge collapses (Kobbelt et al. 1998, "A general framework for mesh decimation") until ``count`` vertices are left.

    The shortest edge goes first, measured by the length of the edges that were around it, so that the mesh becomes coarser
    by the same factor everywhere. Holes keep their place: their vertices move along their rims only.

    Parameters
    ----------
    vertices : (V, 3) float, mm
    triangles : (T, 3) int

    Returns
    -------
    kept : (count,) int, ascending
        The vertices that are left; a few more where no further collapse is allowed.
    triangles : (U, 3) int32
        Over them.
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
    """Vertices with their neighbours and triangles, as Python sets: collapses change a few at a time.

    around: vertex -> neighbours; triangles: vertex -> its triangles, each beginning with its smallest vertex.
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
        """Every edge, both ways."""
        return ((a, b) for a, around in self.around.items() for b in around)

    def cost(self, gone: int, onto: int) -> float:
        """The edge's length, as a multiple of what was the mean about the vertex that would go."""
        a, b = self._points[gone], self._points[onto]
        return ((a[0] - b[0]) ** 2 + (a[1] - b[1]) ** 2 + (a[2] - b[2]) ** 2) ** 0.5 / self._scale[gone]

    def on_rim(self, vertex: int) -> bool:
        """Whether it has more neighbours than triangles."""
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
        """Move a vertex onto its neighbour; returns the neighbour's neighbours afterwards."""
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
