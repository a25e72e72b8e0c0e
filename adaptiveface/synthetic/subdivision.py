"""Subdivide a mesh with Loop's scheme, so that the rendered surface is finer and smoother than the tracking mesh."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

from ..geometry.mesh import edges


def loop_subdivision(triangles: np.ndarray, n_vertices: int) -> tuple[sp.csr_matrix, np.ndarray]:
    """Make one step of Loop subdivision as a sparse matrix.

    The scheme is Loop's (1987). Boundary rules and vertex weights are those of Zorin et al. (2000).

    Parameters
    ----------
    triangles : (T, 3) array
        Triangles of the mesh, which has E edges.
    n_vertices : int
        Number V of its vertices.

    Returns
    -------
    matrix : (V + E, V) sparse
        The first V rows give the smoothed old vertices, and the other E rows the edge points.
    triangles : (4 T, 3) array
        The triangles over these vertices.
    """
    pairs = edges(triangles)
    n_edges = len(pairs)
    sides = (triangles[:, [k, (k + 1) % 3]] for k in range(3))
    corner_edges = np.stack([_edge_numbers(pairs, side, n_vertices) for side in sides], axis=1)
    uses = np.bincount(corner_edges.ravel(), minlength=n_edges)
    boundary = uses == 1
    edge_rows = _edge_points(pairs, triangles, corner_edges, boundary, n_vertices)
    vertex_rows = _vertex_points(pairs, boundary, n_vertices)
    a, b, c = triangles.T
    ab, bc, ca = (n_vertices + corner_edges).T
    fine = np.concatenate([np.stack(t, axis=1) for t in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))])
    return sp.vstack([vertex_rows, edge_rows]).tocsr(), fine.astype(np.int32)


def _edge_numbers(pairs: np.ndarray, wanted: np.ndarray, n: int) -> np.ndarray:
    keys = pairs[:, 0].astype(np.int64) * n + pairs[:, 1]
    wanted = np.sort(wanted.astype(np.int64), axis=1)
    return np.searchsorted(keys, wanted[:, 0] * n + wanted[:, 1])


def _edge_points(pairs, triangles, corner_edges, boundary, n) -> sp.csr_matrix:
    """Weigh both ends of an edge by 3/8 and both opposite vertices by 1/8. On a boundary, take the midpoint."""
    n_edges = len(pairs)
    end_weight = np.where(boundary, 0.5, 0.375)
    rows = [np.repeat(np.arange(n_edges), 2)]
    columns, values = [pairs.ravel()], [np.repeat(end_weight, 2)]
    for k in range(3):
        edge, opposite = corner_edges[:, k], triangles[:, (k + 2) % 3]
        inner = ~boundary[edge]
        rows.append(edge[inner])
        columns.append(opposite[inner])
        values.append(np.full(inner.sum(), 0.125))
    return sp.csr_matrix((np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))), (n_edges, n))


def _vertex_points(pairs, boundary, n) -> sp.csr_matrix:
    """Use Loop's valence weights for inner vertices, and 1/8, 3/4, 1/8 along the boundary."""
    on_boundary = np.zeros(n, bool)
    on_boundary[pairs[boundary].ravel()] = True
    both = np.concatenate([pairs, pairs[:, ::-1]])
    along = np.concatenate([boundary, boundary])
    valence = np.bincount(both[:, 0], minlength=n)
    beta = (0.625 - (0.375 + 0.25 * np.cos(2 * np.pi / np.maximum(valence, 1))) ** 2) / np.maximum(valence, 1)
    inner = ~on_boundary[both[:, 0]]
    keep = inner | along
    weight = np.where(inner, beta[both[:, 0]], 0.125)[keep]
    around = sp.csr_matrix((weight, (both[keep, 0], both[keep, 1])), (n, n))
    return around + sp.diags(1.0 - np.asarray(around.sum(axis=1)).ravel())
