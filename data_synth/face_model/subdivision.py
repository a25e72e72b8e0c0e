"""Catmull-Clark subdivision (1978) as a sparse linear operator; boundaries by the cubic B-spline rule."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp


def quad_edges(quads: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Unique edges (E, 2), the edge of every quad side (Q, 4), and how many quads share each edge (E,)."""
    sides = np.sort(np.stack([quads, np.roll(quads, -1, axis=1)], axis=2).reshape(-1, 2), axis=1)
    edges, number, count = np.unique(sides, axis=0, return_inverse=True, return_counts=True)
    return edges, number.reshape(quads.shape), count


def catmull_clark(n_vertices: int, quads: np.ndarray) -> tuple[sp.csr_matrix, np.ndarray]:
    """One step: operator (n_new, n_vertices) and the new quads (4 Q, 4).

    New vertices are the old ones first, then one per edge (in the order of :func:`quad_edges`), then one per quad.
    """
    edges, side_edge, count = quad_edges(quads)
    n_edges, n_quads = len(edges), len(quads)
    face_point = _incidence(np.arange(n_quads).repeat(4), quads, n_quads, n_vertices) * 0.25
    middle = _incidence(np.arange(n_edges).repeat(2), edges, n_edges, n_vertices) * 0.5
    edge_quads = _incidence(side_edge, np.arange(n_quads).repeat(4), n_edges, n_quads)
    rim = (count == 1).astype(float)
    edge_point = sp.diags(1 - rim) @ (0.5 * middle + sp.diags(0.5 / count) @ edge_quads @ face_point)
    edge_point = edge_point + sp.diags(rim) @ middle
    vertex_point = _vertex_rule(n_vertices, quads, edges, face_point, middle, rim)
    operator = sp.vstack([vertex_point, edge_point, face_point]).tocsr()
    centre = n_vertices + n_edges + np.arange(n_quads)
    edge = n_vertices + side_edge
    corners = [np.stack([quads[:, k], edge[:, k], centre, edge[:, k - 1]], axis=1) for k in range(4)]
    return operator, np.stack(corners, axis=1).reshape(-1, 4)


def _incidence(rows, cols, n_rows: int, n_cols: int) -> sp.csr_matrix:
    rows, cols = np.ravel(rows), np.ravel(cols)
    return sp.csr_matrix((np.ones(len(rows)), (rows, cols)), (n_rows, n_cols))


def _vertex_rule(n_vertices, quads, edges, face_point, middle, rim) -> sp.csr_matrix:
    """Old vertices: (F + 2 R + (n - 3) P) / n inside, (M1 + 2 P + M2) / 4 on the boundary, unchanged where unused."""
    vertex_quads = _incidence(quads, np.arange(len(quads)).repeat(4), n_vertices, len(quads))
    vertex_edges = _incidence(edges, np.arange(len(edges)).repeat(2), n_vertices, len(edges))
    rim_edges = vertex_edges @ sp.diags(rim)
    valence = np.asarray(vertex_quads.sum(axis=1)).ravel()
    edge_count = np.maximum(np.asarray(vertex_edges.sum(axis=1)).ravel(), 1)
    rim_count = np.asarray(rim_edges.sum(axis=1)).ravel()
    unused, boundary = valence == 0, rim_count > 0
    n = np.maximum(valence, 1)
    inside = sp.diags(1 / n**2) @ vertex_quads @ face_point
    inside = inside + sp.diags(2 / (n * edge_count)) @ vertex_edges @ middle + sp.diags((n - 3) / n)
    border = sp.diags(0.5 / np.maximum(rim_count, 1)) @ rim_edges @ middle + 0.5 * sp.eye(n_vertices)
    interior = ~unused & ~boundary
    return sp.diags(interior * 1.0) @ inside + sp.diags(boundary * 1.0) @ border + sp.diags(unused * 1.0)
