"""Cut meshes to an actor's frontal region, the vertices that sections 4.3 and 5 deform and learn from."""

from __future__ import annotations

import numpy as np

from ..caches.compiled import compiled
from ..geometry.mesh import vertex_normals
from ..model.actor import Actor


class FrontalRegion:
    """The n frontal vertices of an actor with N vertices. It cuts meshes to them and moves them.

    Attributes
    ----------
    vertices : (n,) int
        Their numbers in the whole mesh. ``outside`` (N - n,) holds the numbers of the other vertices.
    neutral : (n, 3) float
        Their places in the neutral, head frame, mm.
    local : (N,) int
        Numbers within the region by the numbers in the whole mesh; meaningless for other vertices.
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
        """Unit normals (n, 3) of the region of a ``mesh`` (N, 3)."""
        return vertex_normals(mesh.take(self.vertices, axis=0), self._triangles)

    @property
    def normals_at_rest(self) -> np.ndarray:
        """(n, 3) unit normals of the neutral."""
        return vertex_normals(self.neutral, self._triangles)

    def placed(self, mesh: np.ndarray, pose: np.ndarray) -> np.ndarray:
        """Places (n, 3) of the region of a ``mesh`` (N, 3) at a ``pose`` (4, 4) head to camera, camera frame, mm."""
        places: np.ndarray = _placed(mesh, self.vertices, pose)
        return places

    def difference(self, mesh: np.ndarray, origin: np.ndarray) -> np.ndarray:
        """Displacement (3n,) of the region from the mesh ``origin`` (N, 3) to ``mesh`` (N, 3), mm."""
        moved: np.ndarray = _differences(mesh, origin, self.vertices).ravel()
        return moved

    def changed(self, shapes: np.ndarray, change: np.ndarray) -> np.ndarray:
        """Shapes (A, N, 3) in single precision, their region changed by ``change`` (A, n, 3), mm."""
        out = shapes.astype(np.float32)
        for shape, by in zip(out, change, strict=True):
            _move(shape, self.vertices, by)
        return out

    def displaced(self, mesh: np.ndarray, deformation: np.ndarray) -> np.ndarray:
        """Copy ``mesh`` (N, 3) and move its region by ``deformation`` (n, 3), mm."""
        moved = mesh.copy()
        _move(moved, self.vertices, deformation)
        return moved

    def moved(self, mesh: np.ndarray, frontal: np.ndarray, outside: np.ndarray) -> np.ndarray:
        """Copy ``mesh`` (N, 3), and move its region by ``frontal`` (3n,) and the other vertices by ``outside``, mm."""
        moved = self.displaced(mesh, frontal.reshape(-1, 3))
        _move(moved, self.outside, outside.reshape(-1, 3))
        return moved


@compiled(nogil=True)
def _placed(mesh: np.ndarray, vertices: np.ndarray, pose: np.ndarray) -> np.ndarray:
    """R ``mesh[vertices]`` + t (n, 3), computed in one pass."""
    out = np.empty((len(vertices), 3))
    for i in range(len(vertices)):
        x, y, z = mesh[vertices[i], 0], mesh[vertices[i], 1], mesh[vertices[i], 2]
        for k in range(3):
            out[i, k] = pose[k, 0] * x + pose[k, 1] * y + pose[k, 2] * z + pose[k, 3]
    return out


@compiled
def _differences(mesh: np.ndarray, origin: np.ndarray, vertices: np.ndarray) -> np.ndarray:
    """``mesh[vertices] - origin[vertices]`` (n, 3), computed in one pass."""
    out = np.empty((len(vertices), 3))
    for i in range(len(vertices)):
        for k in range(3):
            out[i, k] = mesh[vertices[i], k] - origin[vertices[i], k]
    return out


@compiled
def _move(mesh: np.ndarray, vertices: np.ndarray, by: np.ndarray) -> None:
    """``mesh[vertices] += by``, computed in place and in one pass."""
    for i in range(len(vertices)):
        for k in range(3):
            mesh[vertices[i], k] += by[i, k]
