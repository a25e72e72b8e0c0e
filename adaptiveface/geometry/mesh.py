"""Compute on triangle meshes what every stage needs: normals, adjacency, the cotangent Laplacian, surface points.

Vertices are (N, 3) float mm, triangles (T, 3) int, counter-clockwise seen from outside.
"""

from __future__ import annotations

import cv2
import numpy as np
import scipy.sparse as sp

from ..caches.compiled import compiled


def triangle_normals(vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """(T, 3) normals whose length is twice the triangle's area (mm^2)."""
    a, b, c = (vertices[triangles[:, k]] for k in range(3))
    return np.cross(b - a, c - a)


def vertex_normals(vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """(N, 3) unit normals, the area-weighted mean over the incident triangles; zero for unused vertices.

    This is the normalised sum over k of :func:`triangle_normals` at ``triangles[:, k]``, compiled because meshes change every
    frame.
    """
    normals = np.zeros((len(vertices), 3))
    _accumulate_normals(np.ascontiguousarray(vertices, np.float64), np.ascontiguousarray(triangles, np.int64), normals)
    return normals


@compiled(nogil=True)
def _accumulate_normals(vertices, triangles, normals):
    for t in range(len(triangles)):
        # Unsigned: a vertex number is not counted from the end, which would be asked at every access.
        a, b, c = np.uint32(triangles[t, 0]), np.uint32(triangles[t, 1]), np.uint32(triangles[t, 2])
        ux, uy, uz = vertices[b, 0] - vertices[a, 0], vertices[b, 1] - vertices[a, 1], vertices[b, 2] - vertices[a, 2]
        vx, vy, vz = vertices[c, 0] - vertices[a, 0], vertices[c, 1] - vertices[a, 1], vertices[c, 2] - vertices[a, 2]
        nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        for i in (a, b, c):
            normals[i, 0] += nx
            normals[i, 1] += ny
            normals[i, 2] += nz
    for i in range(len(normals)):
        x, y, z = normals[i, 0], normals[i, 1], normals[i, 2]
        length = np.sqrt(x**2 + y**2 + z**2)
        if length > 0.0:
            normals[i, 0], normals[i, 1], normals[i, 2] = x / length, y / length, z / length


def vertex_areas(vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """(N,) barycentric area of each vertex, mm^2 (one third of its triangles)."""
    area = 0.5 * np.linalg.norm(triangle_normals(vertices, triangles), axis=1)
    return np.bincount(triangles.ravel(), np.repeat(area / 3, 3), minlength=len(vertices))


def edges(triangles: np.ndarray) -> np.ndarray:
    """(E, 2) unique undirected edges, smaller vertex first, sorted."""
    pairs = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    return np.unique(np.sort(pairs, axis=1), axis=0)


def boundary_edges(triangles: np.ndarray) -> np.ndarray:
    """(B, 2) edges that belong to one triangle only (the rims of eyes, mouth and neck)."""
    pairs = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    unique, count = np.unique(np.sort(pairs, axis=1), axis=0, return_counts=True)
    return unique[count == 1]


def boundary_loops(triangles: np.ndarray, n_vertices: int) -> list[np.ndarray]:
    """The vertices of every boundary loop (eyes, mouth, neck), in the order in which its triangles run along it."""
    directed = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]]).astype(np.int64)
    keys = directed[:, 0] * n_vertices + directed[:, 1]
    single = ~np.isin(keys, directed[:, 1] * n_vertices + directed[:, 0])
    after = dict(directed[single].tolist())
    loops = []
    while after:
        start, current = after.popitem()
        loop = [start]
        while current != start and current in after:
            loop.append(current)
            current = after.pop(current)
        loops.append(np.array(loop))
    return sorted(loops, key=lambda loop: int(loop.min()))


def adjacency(triangles: np.ndarray, n_vertices: int) -> sp.csr_matrix:
    """(N, N) symmetric 0/1 matrix of the vertices joined by an edge."""
    pairs = edges(triangles)
    ones = np.ones(len(pairs))
    half = sp.coo_matrix((ones, (pairs[:, 0], pairs[:, 1])), (n_vertices, n_vertices))
    return (half + half.T).tocsr()


def grow(mask: np.ndarray, triangles: np.ndarray, rings: int) -> np.ndarray:
    """(N,) bool: ``mask`` widened by a number of edge rings."""
    joined = adjacency(triangles, len(mask))
    for _ in range(rings):
        mask = mask | (joined @ mask.astype(float) > 0)
    return mask


def cotangent_laplacian(vertices: np.ndarray, triangles: np.ndarray, non_negative: bool = False) -> sp.csr_matrix:
    """(N, N) cotangent Laplacian L with (L f)_i = sum_j w_ij (f_i - f_j), w_ij = (cot a + cot b) / 2.

    Unnormalised, so it does not depend on the unit of length (Botsch & Sorkine 2008, eq. 12 without the area term;
    paper, eq. 6). ``non_negative`` clips the weights of obtuse triangle pairs at zero.
    """
    n = len(vertices)
    rows, cols, weights = [], [], []
    for k in range(3):
        i, j, o = triangles[:, (k + 1) % 3], triangles[:, (k + 2) % 3], triangles[:, k]
        u, v = vertices[i] - vertices[o], vertices[j] - vertices[o]
        cotangent = (u * v).sum(1) / np.maximum(np.linalg.norm(np.cross(u, v), axis=1), 1e-12)
        rows += [i, j]
        cols += [j, i]
        weights += [0.5 * cotangent, 0.5 * cotangent]
    w = sp.coo_matrix((np.concatenate(weights), (np.concatenate(rows), np.concatenate(cols))), (n, n)).tocsr()
    if non_negative:
        w.data = np.maximum(w.data, 0.0)
    return (sp.diags(np.asarray(w.sum(axis=1)).ravel()) - w).tocsr()


def surface_points(vertices: np.ndarray, triangles: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """(F, 3) points given by their triangles (F, 3) of vertex numbers and barycentric weights (F, 3)."""
    return np.einsum("fk,fkd->fd", weights, vertices[triangles])


def rigid_alignment(source: np.ndarray, target: np.ndarray, weights: np.ndarray | None = None) -> np.ndarray:
    """(4, 4) rotation and translation that brings ``source`` (n, 3) closest to ``target`` (n, 3) (Kabsch 1976)."""
    w = np.ones(len(source)) if weights is None else np.asarray(weights, float)
    w = w / w.sum()
    mean_s, mean_t = w @ source, w @ target
    u, _, vt = np.linalg.svd((target - mean_t).T @ ((source - mean_s) * w[:, None]))
    rotation = u @ np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))]) @ vt
    transform = np.eye(4)
    transform[:3, :3] = rotation
    transform[:3, 3] = mean_t - rotation @ mean_s
    return transform


def transform_points(transform: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Apply a (4, 4) rigid transform to points (..., 3)."""
    return points @ transform[:3, :3].T + transform[:3, 3]


def rotation_vector_matrix(omega: np.ndarray) -> np.ndarray:
    """(3, 3) rotation of a rotation vector (radians), by Rodrigues' formula."""
    return cv2.Rodrigues(np.asarray(omega, float))[0]
