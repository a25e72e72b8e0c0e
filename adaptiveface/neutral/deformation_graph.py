"""Deform a mesh by an embedded deformation graph, for the shrink-wrap (Sumner et al. 2007; Li et al. 2009).

Nodes on the mesh have affine transforms A, t, and a vertex follows its nodes: v' = sum_i w_i (A_i (v - x_i) + x_i + t_i).
The unknowns are stacked as (4 G, 3): for every node the rows of A^T, followed by t. In a flat vector, unknown k of coordinate
d is at 3 k + d.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from scipy.sparse.csgraph import dijkstra

from ..geometry.mesh import edges

_NEIGHBOURS = 4  # number of nodes that move a vertex


@dataclass(frozen=True)
class DeformationGraph:
    """Nodes on a mesh.

    Attributes
    ----------
    nodes : (G,) int
        Their vertex numbers.
    positions : (G, 3)
        Their places, mm.
    carriers, shares : (V, C) int, (V, C)
        The nodes that carry each vertex, and their weights; rows sum to 1.
    edges : (E, 2) int
        Pairs of nodes that carry a common vertex.
    """

    nodes: np.ndarray
    positions: np.ndarray
    carriers: np.ndarray
    shares: np.ndarray
    edges: np.ndarray


def deformation_graph(vertices: np.ndarray, triangles: np.ndarray, spacing: float) -> DeformationGraph:
    """Spread nodes about ``spacing`` mm apart along the mesh, so that neither lip moves the other."""
    pairs = edges(triangles)
    length = np.linalg.norm(vertices[pairs[:, 0]] - vertices[pairs[:, 1]], axis=1)
    net = sp.coo_matrix((length, (pairs[:, 0], pairs[:, 1])), (len(vertices),) * 2).tocsr()
    nodes = _spread(net, len(vertices), spacing)
    carriers, near = _nearest_nodes(net, nodes, 4.0 * spacing)
    reach = np.where(np.isfinite(near[:, -1:]), near[:, -1:], 4.0 * spacing)
    shares = np.where(np.isfinite(near), np.clip(1.0 - near / np.maximum(reach, 1e-9), 0.0, None), 0.0)[:, :-1] ** 2
    carriers = carriers[:, :-1]
    shares[shares.sum(axis=1) == 0, 0] = 1.0
    shares /= shares.sum(axis=1, keepdims=True)
    return DeformationGraph(nodes, vertices[nodes], carriers, shares, _graph_edges(carriers, shares))


def _spread(net: sp.csr_matrix, n: int, spacing: float) -> np.ndarray:
    """Choose vertices so that every vertex has one within ``spacing`` mm along the mesh, and none is much nearer."""
    free, nodes = np.ones(n, bool), []
    for vertex in range(n):
        if free[vertex]:
            nodes.append(vertex)
            free &= ~np.isfinite(dijkstra(net, directed=False, indices=vertex, limit=spacing))
    return np.array(nodes)


def _nearest_nodes(net: sp.csr_matrix, nodes: np.ndarray, limit: float) -> tuple[np.ndarray, np.ndarray]:
    """Numbers and distances (V, C + 1) of the nodes nearest along the mesh, a few nodes at a time to spare memory."""
    count = min(_NEIGHBOURS + 1, len(nodes))
    numbers, near = np.zeros((net.shape[0], 0), int), np.zeros((net.shape[0], 0))
    for start in range(0, len(nodes), 64):
        some = np.arange(start, min(start + 64, len(nodes)))
        near = np.concatenate([near, dijkstra(net, directed=False, indices=nodes[some], limit=limit).T], axis=1)
        numbers = np.concatenate([numbers, np.broadcast_to(some, (len(near), len(some)))], axis=1)
        order = np.argsort(near, axis=1, kind="stable")[:, :count]
        near, numbers = np.take_along_axis(near, order, axis=1), np.take_along_axis(numbers, order, axis=1)
    return numbers, near


def _graph_edges(carriers: np.ndarray, shares: np.ndarray) -> np.ndarray:
    pairs = []
    for a in range(carriers.shape[1]):
        for b in range(a + 1, carriers.shape[1]):
            both = (shares[:, a] > 0) & (shares[:, b] > 0)
            pairs.append(np.sort(carriers[both][:, [a, b]], axis=1))
    return np.unique(np.concatenate(pairs), axis=0)


def carry_matrix(graph: DeformationGraph, vertices: np.ndarray) -> tuple[sp.csr_matrix, np.ndarray]:
    """Matrix C (V, 4 G) and constant c (V, 3) of the deformed vertices C unknown + c."""
    offset = vertices[:, None] - graph.positions[graph.carriers]
    data = graph.shares[..., None] * np.concatenate([offset, np.ones((*offset.shape[:2], 1))], axis=2)
    columns = 4 * graph.carriers[..., None] + np.arange(4)
    rows = np.broadcast_to(np.arange(len(vertices))[:, None, None], columns.shape)
    shape = (len(vertices), 4 * len(graph.nodes))
    return sp.coo_matrix((data.ravel(), (rows.ravel(), columns.ravel())), shape).tocsr(), rest_positions(graph)


def rest_positions(graph: DeformationGraph) -> np.ndarray:
    """Constant part (V, 3) of the deformed vertices: sum_i w_i x_i, mm."""
    positions: np.ndarray = np.einsum("vc,vcd->vd", graph.shares, graph.positions[graph.carriers])
    return positions


def smoothness_rows(graph: DeformationGraph) -> tuple[sp.csr_matrix, np.ndarray]:
    """E_smooth: matrix and constant of the rows A_i (x_j - x_i) + x_i + t_i - (x_j + t_j), both ways along every edge."""
    i, j = np.concatenate([graph.edges, graph.edges[:, ::-1]]).T
    offset = graph.positions[j] - graph.positions[i]
    rows = np.arange(len(i))
    data = np.concatenate([offset.ravel(), np.ones(len(i)), -np.ones(len(i))])
    row = np.concatenate([np.repeat(rows, 3), rows, rows])
    column = np.concatenate([(4 * i[:, None] + np.arange(3)).ravel(), 4 * i + 3, 4 * j + 3])
    matrix = sp.coo_matrix((data, (row, column)), (len(i), 4 * len(graph.nodes))).tocsr()
    return matrix, -offset


def rigidity_rows(unknown: np.ndarray) -> tuple[sp.csr_matrix, np.ndarray]:
    """E_rigid: the six equations that make the columns a_c of each A orthonormal, linearised at the current A."""
    G = len(unknown) // 4
    columns = unknown.reshape(G, 4, 3)[:, :3]  # columns[g, c] is a_c of node g
    rows, cols, data, value = [], [], [], []
    for number, (a, b) in enumerate([(0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)]):
        value.append((columns[:, a] * columns[:, b]).sum(axis=1) - (a == b))
        for first, second in ((a, b), (b, a)):
            rows.append(np.repeat(6 * np.arange(G) + number, 3))
            cols.append((12 * np.arange(G)[:, None] + 3 * first + np.arange(3)).ravel())
            data.append(columns[:, second].ravel())
    matrix = sp.coo_matrix((np.concatenate(data), (np.concatenate(rows), np.concatenate(cols))), (6 * G, 12 * G))
    return matrix.tocsr(), np.stack(value, axis=1).ravel()


def step_square(graph: DeformationGraph) -> float:
    """Factor that turns the deviation of A from a rotation into the squared offset at the next node, mm^2."""
    step = graph.positions[graph.edges[:, 0]] - graph.positions[graph.edges[:, 1]]
    return float((step**2).sum(axis=1).mean())
