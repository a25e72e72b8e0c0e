"""The frontal region of an actor: the vertices that sections 4.3 and 5 deform and learn from."""

from __future__ import annotations

import numpy as np

from ..caches.compiled import compiled
from ..geometry.mesh import vertex_normals
from ..model.actor import Actor


class FrontalRegion:
    """The n frontal vertices of an actor with N vertices, and how meshes are cut to them and moved by them.

    Attributes
    ----------
    vertices : (n,) int
        Their numbers in the whole mesh; ``outside`` (N - n,) holds those of the other vertices.
    neutral : (n, 3) float
        Their places in the neutral, head frame, mm.
    local : (N,) int
        Their numbers within the region, by their numbers in the whole mesh; meaningless for other vertices.
    """

    def __init__(self, actor: Actor) -> None:
        frontal = actor.frontal
        self.vertices = np.flatnonzero(frontal)
        self.outside = np.flatnonzero(~frontal)
        self.neutral = actor.neutral[self.vertices]
        self.local = np.cumsum(frontal) - 1
        self._triangles = self.local[actor.triangles[frontal[actor.triangles].all(axis=1)]]

    def __len__(self) -> int:
        return len(self.vertices)

    def normals(self, mesh: np.ndarray) -> np.ndarray:
        """(n, 3) unit normals of the region of a ``mesh`` (N, 3)."""
        return vertex_normals(mesh.take(self.vertices, axis=0), self._triangles)

    def difference(self, mesh: np.ndarray, origin: np.ndarray) -> np.ndarray:
        """(3n,) how far the region of a ``mesh`` (N, 3) lies from that of another, ``origin``, mm."""
        moved: np.ndarray = _differences(mesh, origin, self.vertices).ravel()
        return moved

    def displaced(self, mesh: np.ndarray, deformation: np.ndarray) -> np.ndarray:
        """A copy of ``mesh`` (N, 3) whose region is moved by ``deformation`` (n, 3), mm."""
        moved = mesh.copy()
        _move(moved, self.vertices, deformation)
        return moved

    def moved(self, mesh: np.ndarray, frontal: np.ndarray, outside: np.ndarray) -> np.ndarray:
        """A copy of ``mesh`` (N, 3), its region moved by ``frontal`` (3n,), the other vertices by ``outside``, mm."""
        moved = self.displaced(mesh, frontal.reshape(-1, 3))
        _move(moved, self.outside, outside.reshape(-1, 3))
        return moved


@compiled
def _differences(mesh: np.ndarray, origin: np.ndarray, vertices: np.ndarray) -> np.ndarray:
    """``mesh[vertices] - origin[vertices]``, (n, 3), in one pass."""
    out = np.empty((len(vertices), 3))
    for i in range(len(vertices)):
        for k in range(3):
            out[i, k] = mesh[vertices[i], k] - origin[vertices[i], k]
    return out


@compiled
def _move(mesh: np.ndarray, vertices: np.ndarray, by: np.ndarray) -> None:
    """``mesh[vertices] += by`` in place, in one pass."""
    for i in range(len(vertices)):
        for k in range(3):
            mesh[vertices[i], k] += by[i, k]
