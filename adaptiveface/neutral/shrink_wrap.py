"""Section 3, third step: shrink-wrap by non-rigid ICP, for what the identity modes cannot hold (Li et al. 2009).

Coarse: a deformation graph whose nodes carry affine transforms; every node stays near a rotation (E_rigid) and near its
neighbours (E_smooth), both relaxed from round to round while the mesh approaches the scan. Fine: displacements of the
vertices along their normals, smooth where the scan says nothing (Li et al. 2009, detail synthesis).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from scipy.sparse.csgraph import dijkstra
from scipy.sparse.linalg import splu

from ..face_model import FaceModel
from ..mesh import cotangent_laplacian, edges, surface_points, vertex_areas, vertex_normals
from ..parameters import ShrinkWrapParameters
from .features import FeatureConstraints, feature_constraints
from .fit import ScanCorrespondences, ScanSearch
from .fuse import FusedScan

_NEIGHBOURS = 4  # nodes that carry a vertex


@dataclass(frozen=True)
class ShrinkWrap:
    """vertices (V, 3) mm in the scan's frame; coarse (V, 3): after the deformation graph alone; matched (V,) bool;
    residual: median point-to-plane distance to the scan over the matched vertices, mm; history (I,): the same per round.
    """

    vertices: np.ndarray
    coarse: np.ndarray
    matched: np.ndarray
    residual: float
    history: np.ndarray


@dataclass(frozen=True)
class DeformationGraph:
    """Nodes on a mesh. nodes (G,) vertex numbers; positions (G, 3); carriers (V, C) node numbers that carry each vertex,
    shares (V, C) their weights (rows sum to 1); edges (E, 2): nodes that carry a common vertex.
    """

    nodes: np.ndarray
    positions: np.ndarray
    carriers: np.ndarray
    shares: np.ndarray
    edges: np.ndarray


def shrink_wrap(
    scan: FusedScan, model: FaceModel, vertices: np.ndarray, parameters: ShrinkWrapParameters = ShrinkWrapParameters()
) -> ShrinkWrap:
    """Warp the fitted head ``vertices`` (V, 3), given in the scan's frame, onto the scan (paper, section 3)."""
    search = ScanSearch(scan)
    coarse, history = _coarse(scan, model, vertices, search, parameters)
    fine = coarse
    for _ in range(parameters.detail_iterations):
        found = _search(search, model, fine, parameters)
        history.append(_residual(found))
        fine = fine + _detail(fine, model, found, parameters)
    found = _search(search, model, fine, parameters)
    matched = np.zeros(len(vertices), bool)
    matched[found.vertices] = True
    return ShrinkWrap(fine, coarse, matched, _residual(found), np.array(history))


def _residual(found: ScanCorrespondences) -> float:
    return float(np.median(np.abs(found.distances))) if len(found.distances) else float("nan")


def _search(search: ScanSearch, model: FaceModel, vertices, parameters) -> ScanCorrespondences:
    normals = vertex_normals(vertices, model.triangles)
    return search.correspondences(vertices, normals, _wrapped(model), parameters.reach, parameters.normal_angle)


def _wrapped(model: FaceModel) -> np.ndarray:
    """(V,) bool: vertices that may meet the scan: the trusted frontal skin and all that lies outside the frontal region."""
    return model.depth_valid | ~model.frontal


# --- coarse: the deformation graph ---------------------------------------------------------------------------------


def deformation_graph(vertices: np.ndarray, triangles: np.ndarray, spacing: float) -> DeformationGraph:
    """Spread nodes about ``spacing`` mm apart, measured along the mesh: the lips must not carry one another."""
    pairs = edges(triangles)
    length = np.linalg.norm(vertices[pairs[:, 0]] - vertices[pairs[:, 1]], axis=1)
    net = sp.coo_matrix((length, (pairs[:, 0], pairs[:, 1])), (len(vertices),) * 2).tocsr()
    nodes = _spread(net, len(vertices), spacing)
    distance = dijkstra(net, directed=False, indices=nodes, limit=4.0 * spacing).T
    carriers = np.argsort(distance, axis=1)[:, : _NEIGHBOURS + 1]
    near = np.take_along_axis(distance, carriers, axis=1)
    reach = np.where(np.isfinite(near[:, -1:]), near[:, -1:], 4.0 * spacing)
    shares = np.where(np.isfinite(near), np.clip(1.0 - near / np.maximum(reach, 1e-9), 0.0, None), 0.0)[:, :-1] ** 2
    carriers = carriers[:, :-1]
    shares[shares.sum(axis=1) == 0, 0] = 1.0
    shares /= shares.sum(axis=1, keepdims=True)
    return DeformationGraph(nodes, vertices[nodes], carriers, shares, _graph_edges(carriers, shares))


def _spread(net: sp.csr_matrix, n: int, spacing: float) -> np.ndarray:
    """Vertex numbers such that every vertex has one within ``spacing`` mm along the mesh, and none is much nearer."""
    free, nodes = np.ones(n, bool), []
    for vertex in range(n):
        if free[vertex]:
            nodes.append(vertex)
            free &= ~np.isfinite(dijkstra(net, directed=False, indices=vertex, limit=spacing))
    return np.array(nodes)


def _graph_edges(carriers: np.ndarray, shares: np.ndarray) -> np.ndarray:
    pairs = []
    for a in range(carriers.shape[1]):
        for b in range(a + 1, carriers.shape[1]):
            both = (shares[:, a] > 0) & (shares[:, b] > 0)
            pairs.append(np.sort(carriers[both][:, [a, b]], axis=1))
    return np.unique(np.concatenate(pairs), axis=0)


def _coarse(scan, model, vertices, search, parameters) -> tuple[np.ndarray, list[float]]:
    graph = deformation_graph(vertices, model.triangles, parameters.node_spacing)
    carry = _carry_matrix(graph, vertices)
    smooth, smooth_rest = _smoothness_rows(graph)
    unknown = np.tile(np.concatenate([np.eye(3), np.zeros((1, 3))]), (len(graph.nodes), 1))  # (4 G, 3), rows A^T, t
    area = vertex_areas(vertices, model.triangles)
    area /= area[model.frontal].mean()
    history, current = [], vertices
    for round_ in range(parameters.iterations):
        found = _search(search, model, current, parameters)
        history.append(_residual(found))
        rigidity = _relaxed(parameters, round_)
        constraints = _feature_constraints(scan, model, current)
        unknown = _graph_step(
            unknown, carry, smooth, smooth_rest, graph, model, found, constraints, area, rigidity, parameters
        )
        current = carry @ unknown + _rest(graph)
    return current, history


def _relaxed(parameters: ShrinkWrapParameters, round_: int) -> float:
    """Geometric descent of the rigidity from its first to its last value."""
    t = round_ / max(parameters.iterations - 1, 1)
    low = max(parameters.rigidity_end, 1e-6)
    return float(np.exp((1 - t) * np.log(max(parameters.rigidity_start, low)) + t * np.log(low)))


def _carry_matrix(graph: DeformationGraph, vertices: np.ndarray) -> sp.csr_matrix:
    """(V, 4 G) matrix C: deformed vertices = C unknown + rest, with v' = sum_i w_i (A_i (v - x_i) + x_i + t_i)."""
    offset = vertices[:, None] - graph.positions[graph.carriers]
    data = graph.shares[..., None] * np.concatenate([offset, np.ones((*offset.shape[:2], 1))], axis=2)
    columns = 4 * graph.carriers[..., None] + np.arange(4)
    rows = np.broadcast_to(np.arange(len(vertices))[:, None, None], columns.shape)
    shape = (len(vertices), 4 * len(graph.nodes))
    return sp.coo_matrix((data.ravel(), (rows.ravel(), columns.ravel())), shape).tocsr()


def _rest(graph: DeformationGraph) -> np.ndarray:
    """(V, 3) sum_i w_i x_i: the constant part of the deformed vertices."""
    return np.einsum("vc,vcd->vd", graph.shares, graph.positions[graph.carriers])


def _smoothness_rows(graph: DeformationGraph) -> tuple[sp.csr_matrix, np.ndarray]:
    """E_smooth: rows A_i (x_j - x_i) + x_i + t_i - (x_j + t_j) for both directions of every edge; matrix and constant."""
    i, j = np.concatenate([graph.edges, graph.edges[:, ::-1]]).T
    offset = graph.positions[j] - graph.positions[i]
    rows = np.arange(len(i))
    data = np.concatenate([offset.ravel(), np.ones(len(i)), -np.ones(len(i))])
    row = np.concatenate([np.repeat(rows, 3), rows, rows])
    column = np.concatenate([(4 * i[:, None] + np.arange(3)).ravel(), 4 * i + 3, 4 * j + 3])
    matrix = sp.coo_matrix((data, (row, column)), (len(i), 4 * len(graph.nodes))).tocsr()
    return matrix, -offset


def _graph_step(unknown, carry, smooth, smooth_rest, graph, model, found, constraints, area, rigidity, parameters):
    """One Gauss-Newton step on E_fit + rigidity (E_rigid + smoothness E_smooth); returns the new unknowns (4 G, 3)."""
    size = unknown.size
    eye = sp.identity(3, format="csr")
    # Unknown k of coordinate d is at 3 k + d: kron keeps the coordinates of a node together.
    plane = sp.csr_matrix(
        (found.normals.ravel(), (np.repeat(np.arange(len(found.vertices)), 3), np.arange(3 * len(found.vertices))))
    )
    rows = plane @ sp.kron(carry[found.vertices], eye, format="csr")
    scale = max(3 * 1.4826 * _residual(found), 0.5)
    weight = area[found.vertices] * np.clip(1 - (found.distances / (2 * scale)) ** 2, 0, None) ** 2
    lhs = rows.T @ sp.diags(weight) @ rows
    rhs = -rows.T @ (weight * found.distances)
    _add_graph_features(locals_ := {"lhs": lhs, "rhs": rhs}, carry, graph, model, unknown, constraints, eye, parameters)
    lhs, rhs = locals_["lhs"], locals_["rhs"]
    bind = rigidity * parameters.smoothness
    lhs = lhs + bind * sp.kron(smooth.T @ smooth, eye, format="csr")
    rhs = rhs - bind * (smooth.T @ (smooth @ unknown + smooth_rest)).ravel()
    rigid, deviation = _rigidity_rows(unknown)
    lhs = lhs + rigidity * graph_scale(graph) * (rigid.T @ rigid) + 1e-9 * sp.identity(size)
    rhs = rhs - rigidity * graph_scale(graph) * (rigid.T @ deviation)
    solver = splu(lhs.tocsc(), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
    return unknown + solver.solve(rhs).reshape(-1, 3)


def graph_scale(graph: DeformationGraph) -> float:
    """mm^2: turns the dimensionless deviation of A from a rotation into the offset it makes at the next node."""
    step = graph.positions[graph.edges[:, 0]] - graph.positions[graph.edges[:, 1]]
    return float((step**2).sum(axis=1).mean())


def _add_graph_features(system, carry, graph, model, unknown, constraints: FeatureConstraints, eye, parameters) -> None:
    if parameters.feature_weight == 0 or not constraints.seen.any():
        return
    pick = sp.csr_matrix(
        (model.feature_weights.ravel(), (np.repeat(np.arange(40), 3), model.feature_triangles.ravel())),
        (40, carry.shape[0]),
    )
    points = pick @ (carry @ unknown + _rest(graph))
    rows = sp.kron(pick @ carry, eye, format="csr")
    strength = parameters.feature_weight * constraints.seen
    block = sp.block_diag(list(strength[:, None, None] * constraints.A), format="csr")
    offset = np.einsum("fij,fj->fi", constraints.A, points) - constraints.b
    system["lhs"] = system["lhs"] + rows.T @ block @ rows
    system["rhs"] = system["rhs"] - rows.T @ (strength[:, None] * offset).ravel()


def _rigidity_rows(unknown: np.ndarray) -> tuple[sp.csr_matrix, np.ndarray]:
    """E_rigid: the six equations that make the columns a_c of each A orthonormal, linearised at the present A."""
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


def _feature_constraints(scan: FusedScan, model: FaceModel, vertices: np.ndarray) -> FeatureConstraints:
    normals = vertex_normals(vertices, model.triangles)
    return feature_constraints(
        scan, surface_points(vertices, model.feature_triangles, model.feature_weights),
        surface_points(normals, model.feature_triangles, model.feature_weights),
    )


# --- fine: displacements along the normals -------------------------------------------------------------------------


def _detail(vertices, model: FaceModel, found: ScanCorrespondences, parameters: ShrinkWrapParameters) -> np.ndarray:
    """(V, 3) displacements s_i n_i with s = argmin sum (s_i n_i.m_i + d_i)^2 + smoothness |L s|^2 + a little |s|^2."""
    normals = vertex_normals(vertices, model.triangles)
    turn = (normals[found.vertices] * found.normals).sum(axis=1)
    scale = max(3 * 1.4826 * _residual(found), 0.3)
    weight = np.clip(1 - (found.distances / (3 * scale)) ** 2, 0, None) ** 2
    n = len(vertices)
    diagonal = np.bincount(found.vertices, weight * turn**2, n)
    rhs = -np.bincount(found.vertices, weight * turn * found.distances, n)
    laplacian = cotangent_laplacian(vertices, model.triangles, non_negative=True)
    # The faint pull to zero lets displacements die out over the unseen back of the head.
    system = sp.diags(diagonal + 1e-4) + parameters.detail_smoothness * laplacian.T @ laplacian
    solver = splu(system.tocsc(), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
    return solver.solve(rhs)[:, None] * normals
