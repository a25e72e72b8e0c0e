"""Shrink-wrap by non-rigid ICP, for what the identity modes cannot express (section 3, third step; Li et al. 2009).

The coarse step uses a deformation graph whose nodes have affine transforms. Every node stays near a rotation (E_rigid) and near
its neighbours (E_smooth). Both are relaxed from round to round while the mesh approaches the scan. The fine step displaces the
vertices along their normals, smoothly where the scan has no points (Li et al. 2009, detail synthesis).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import SuperLU, splu
from scipy.spatial import cKDTree

from ..geometry.mesh import adjacency, cotangent_laplacian, vertex_areas, vertex_normals
from ..model.face_model import FaceModel
from ..parameters import ShrinkWrapParameters
from .deformation_graph import (
    DeformationGraph,
    carry_matrix,
    deformation_graph,
    rest_positions,
    rigidity_rows,
    smoothness_rows,
    step_square,
)
from .features import Evidence, FeatureConstraints, neutral_evidence
from .fit import ScanCorrespondences, ScanSearch
from .fuse import FusedScan

DEFAULTS = ShrinkWrapParameters()
#: A landmark of the contour counts where it is farther off than this many of its deviations. More than in the fit: there it
#: pulls at the whole head, here at the node beside it, and leaves a dent.
TOLERATED = 2.5


@dataclass(frozen=True)
class ShrinkWrap:
    """The result of :func:`shrink_wrap`.

    Attributes
    ----------
    vertices : (V, 3)
        The wrapped mesh in the scan's frame, mm.
    coarse : (V, 3)
        The mesh after the deformation graph alone, mm.
    matched : (V,) bool
        Vertices that are matched with the scan.
    residual : float
        Median point-to-plane distance of the matched vertices from the scan, mm.
    history : (I,)
        The residual after each round, mm.
    """

    vertices: np.ndarray
    coarse: np.ndarray
    matched: np.ndarray
    residual: float
    history: np.ndarray


def shrink_wrap(
    scan: FusedScan,
    model: FaceModel,
    vertices: np.ndarray,
    parameters: ShrinkWrapParameters = DEFAULTS,
    hair: np.ndarray | None = None,
) -> ShrinkWrap:
    """Warp the fitted head onto the scan (section 3).

    Parameters
    ----------
    scan : FusedScan
        The merged neutral scan.
    model : FaceModel
        Has the mesh, its rims and its contacts.
    vertices : (V, 3)
        The fitted head, in the scan's frame, mm.
    parameters : ShrinkWrapParameters
        Weights and limits.
    hair : (V,) bool, optional
        Vertices under hair. They are not matched with the scan, and keep the fitted shape.

    Returns
    -------
    ShrinkWrap
        The warped mesh, in the scan's frame, mm.
    """
    search = ScanSearch(scan)
    parameters = smoothed(parameters, scan.noise)
    allowed = _wrapped(model) if hair is None else _wrapped(model) & ~hair
    coarse, history = _coarse(scan, model, vertices, search, allowed, parameters)
    fine = coarse
    for _ in range(parameters.detail_iterations):
        found = _search(search, model, fine, allowed, parameters)
        history.append(_residual(found))
        fine = fine + _detail(fine, model, found, parameters)
    found = _search(search, model, fine, allowed, parameters)
    matched = np.zeros(len(vertices), bool)
    matched[found.vertices] = True
    return ShrinkWrap(fine, coarse, matched, _residual(found), np.array(history))


def smoothed(parameters: ShrinkWrapParameters, noise: float) -> ShrinkWrapParameters:
    """Adapt the parameters to a scan whose points have ``noise`` mm. They do not change below ``parameters.noise``.

    In a maximum a posteriori estimate, the weight of the scan is one over its variance, and the smoothness of skin is
    constant. Relative to the scan, the smoothness of the fine step therefore grows with the square of the noise. However, a
    node of the graph follows the mean of many points, whose errors cancel. Measurements show that its rigidity may only grow
    with the root of the noise.
    """
    if noise <= parameters.noise or parameters.noise == 0:
        return parameters
    times = noise / parameters.noise
    rigidity = max(parameters.rigidity_end, min(times**0.5 * parameters.rigidity_end, parameters.rigidity_start))
    return replace(parameters, rigidity_end=rigidity, detail_smoothness=min(times**2 * parameters.detail_smoothness, 1e4))


def _residual(found: ScanCorrespondences) -> float:
    return float(np.median(np.abs(found.distances))) if len(found.distances) else float("nan")


def _search(
    search: ScanSearch, model: FaceModel, vertices: np.ndarray, allowed: np.ndarray, parameters: ShrinkWrapParameters
) -> ScanCorrespondences:
    normals = vertex_normals(vertices, model.triangles)
    return search.correspondences(
        vertices, normals, allowed, parameters.max_correspondence_distance, parameters.max_normal_angle
    )


def _wrapped(model: FaceModel) -> np.ndarray:
    """Which vertices may be matched with the scan: the trusted frontal skin, and all outside the frontal region, (V,) bool."""
    allowed: np.ndarray = model.depth_valid | ~model.frontal
    return allowed


# --- coarse: the deformation graph ---------------------------------------------------------------------------------


def _coarse(
    scan: FusedScan,
    model: FaceModel,
    vertices: np.ndarray,
    search: ScanSearch,
    allowed: np.ndarray,
    parameters: ShrinkWrapParameters,
) -> tuple[np.ndarray, list[float]]:
    graph = deformation_graph(vertices, model.triangles, parameters.node_spacing)
    carry, rest = carry_matrix(graph, vertices)
    fixed = _fixed_terms(graph, carry, vertices, model, parameters)
    unknown = np.tile(np.concatenate([np.eye(3), np.zeros((1, 3))]), (len(graph.nodes), 1))  # (4 G, 3): A^T, t
    history, current = [], vertices
    for round_ in range(parameters.iterations):
        found = _search(search, model, current, allowed, parameters)
        history.append(_residual(found))
        rigidity = _relaxed(parameters, round_)
        energy = _Energy(unknown.size)
        _add_scan(energy, carry, found, vertex_areas(vertices, model.triangles)[found.vertices])
        evidence = neutral_evidence(scan, model, current, np.eye(3), parameters.contour, TOLERATED)
        _add_features(energy, carry, current, evidence, parameters)
        for rows, constant, weight, relaxes in fixed:
            energy.add(
                sp.kron(rows, sp.identity(3), format="csr"),
                (rows @ unknown + constant).ravel(),
                weight * (rigidity if relaxes else 1.0),
            )
        energy.add(*rigidity_rows(unknown), rigidity * step_square(graph))
        unknown = unknown + energy.solve().reshape(-1, 3)
        current = carry @ unknown + rest
    return current, history


class _Energy:
    """Normal equations of a sum of squares. Terms w |J step + r|^2 are added one by one, and then solved for the step."""

    def __init__(self, size: int) -> None:
        self._lhs, self._rhs = 1e-9 * sp.identity(size, format="csr"), np.zeros(size)

    def add(self, jacobian: sp.csr_matrix, residual: np.ndarray, weight: float | np.ndarray | sp.spmatrix) -> None:
        """Add a term. ``weight`` is one number, one number per row, or a matrix."""
        if not sp.issparse(weight):
            weight = sp.diags(np.broadcast_to(weight, residual.shape))
        weighted = jacobian.T @ weight
        self._lhs = self._lhs + weighted @ jacobian
        self._rhs = self._rhs - weighted @ residual

    def solve(self) -> np.ndarray:
        """Return the unknowns that minimise the terms added so far."""
        step: np.ndarray = _factor(self._lhs).solve(self._rhs)
        return step


def _fixed_terms(
    graph: DeformationGraph, carry: sp.csr_matrix, vertices: np.ndarray, model: FaceModel, parameters: ShrinkWrapParameters
) -> list[tuple[sp.csr_matrix, np.ndarray, float, bool]]:
    """The terms whose rows never change: rows over the unknowns, constant, weight, and whether they relax with the rigidity."""
    smooth, constant = smoothness_rows(graph)
    touch = _pair_matrix(touching_pairs(model), len(vertices))
    # rest - vertices: the offset of the carried vertices from their own places, so that the pairs keep their distance.
    lips = touch @ carry, touch @ (rest_positions(graph) - vertices)
    return [(smooth, constant, parameters.smoothness, True), (*lips, parameters.contact_weight, False)]


def _relaxed(parameters: ShrinkWrapParameters, round_: int) -> float:
    """Reduce the rigidity geometrically from its first to its last value."""
    t = round_ / max(parameters.iterations - 1, 1)
    low = max(parameters.rigidity_end, 1e-6)
    return float(np.exp((1 - t) * np.log(max(parameters.rigidity_start, low)) + t * np.log(low)))


def _add_scan(energy: _Energy, carry: sp.csr_matrix, found: ScanCorrespondences, area: np.ndarray) -> None:
    """E_fit, point-to-plane: n.(v' - p), with Tukey's weights and the vertices' areas, so that density does not matter."""
    count = len(found.vertices)
    index = np.repeat(np.arange(count), 3), np.arange(3 * count)
    plane = sp.csr_matrix((found.normals.ravel(), index), (count, 3 * count))
    scale = max(3 * 1.4826 * _residual(found), 0.5)
    weight = area / area.mean() * np.clip(1 - (found.distances / (2 * scale)) ** 2, 0, None) ** 2
    # Unknown k of coordinate d is at 3 k + d, so kron keeps the coordinates of a node together.
    energy.add(plane @ sp.kron(carry[found.vertices], sp.identity(3), format="csr"), found.distances, weight)


def _add_features(
    energy: _Energy,
    carry: sp.csr_matrix,
    current: np.ndarray,
    evidence: Evidence,
    parameters: ShrinkWrapParameters,
) -> None:
    """E_fit, the 2D features: mean squared distances to the viewing rays."""
    triangles, weights, constraints = evidence
    index = np.repeat(np.arange(len(triangles)), 3), triangles.ravel()
    pick = sp.csr_matrix((weights.ravel(), index), (len(triangles), carry.shape[0]))
    strength = (parameters.feature_weight * constraints.strength)[:, None, None]
    weight = sp.block_diag(list(strength * constraints.A), format="csr")
    energy.add(sp.kron(pick @ carry, sp.identity(3), format="csr"), _to_rays(pick @ current, constraints), weight)


def _to_rays(points: np.ndarray, constraints: FeatureConstraints) -> np.ndarray:
    """Offsets r (120,) of the points (40, 3) from where the rays meet best: A r = A x - b."""
    inverse = np.linalg.pinv(constraints.A, rcond=1e-6, hermitian=True)
    offsets: np.ndarray = (points - np.einsum("fij,fj->fi", inverse, constraints.b)).ravel()
    return offsets


# --- fine: displacements along the normals -------------------------------------------------------------------------


def _detail(vertices: np.ndarray, model: FaceModel, found: ScanCorrespondences, parameters: ShrinkWrapParameters) -> np.ndarray:
    """Displacements s_i m_i (V, 3) with s = argmin sum (s_i m_i.n_i + d_i)^2 + smoothness |L s|^2 + a little |s|^2, mm.

    The directions m_i are smoothed normals. At the rims of lips and lids, where the skin rolls in, true normals would fan out
    and tear the rim. Lips that touch in the model move together.
    """
    directions = _smoothed(vertex_normals(vertices, model.triangles), model.triangles)
    turn = (directions[found.vertices] * found.normals).sum(axis=1)
    scale = max(3 * 1.4826 * _residual(found), 0.3)
    weight = np.clip(1 - (found.distances / (3 * scale)) ** 2, 0, None) ** 2
    n = len(vertices)
    diagonal = np.bincount(found.vertices, weight * turn**2, n)
    rhs = -np.bincount(found.vertices, weight * turn * found.distances, n)
    laplacian = cotangent_laplacian(vertices, model.triangles, non_negative=True)
    # The faint pull to zero lets displacements decay over the unseen back of the head.
    system = sp.diags(diagonal + 1e-4) + parameters.detail_smoothness * laplacian.T @ laplacian
    pairs = _pair_matrix(touching_pairs(model), n)
    system = system + parameters.contact_weight * pairs.T @ pairs
    displacement: np.ndarray = _factor(system).solve(rhs)[:, None] * directions
    return displacement


def _smoothed(normals: np.ndarray, triangles: np.ndarray, rings: int = 4) -> np.ndarray:
    """Unit normals (V, 3) averaged with their neighbours' ``rings`` times."""
    joined = adjacency(triangles, len(normals)) + sp.identity(len(normals), format="csr")
    for _ in range(rings):
        normals = joined @ normals
        normals = normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    return normals


# --- lips ----------------------------------------------------------------------------------------------------------


def touching_pairs(model: FaceModel, distance: float = 2.0) -> np.ndarray:
    """Pairs (C, 2) of rim vertices that face each other within ``distance`` mm in the mean head: the closed lips.

    Only rims of the frontal region count, which are vertices that no depth camera sees, and only if the path along the mesh is
    much longer than the gap.
    """
    rim = np.flatnonzero(model.frontal & ~model.depth_valid)
    if len(rim) == 0:
        return np.zeros((0, 2), int)
    pairs = rim[cKDTree(model.mean[rim]).query_pairs(distance, output_type="ndarray")]
    near = adjacency(model.triangles, len(model.mean))
    near = near + near @ near + near @ near @ near
    joined = np.asarray(near[pairs[:, 0], pairs[:, 1]]).ravel() > 0
    apart: np.ndarray = pairs[~joined]
    return apart


def _pair_matrix(pairs: np.ndarray, n: int) -> sp.csr_matrix:
    """Rows (C, n) of v_a - v_b."""
    rows = np.arange(len(pairs))
    data = np.concatenate([np.ones(len(pairs)), -np.ones(len(pairs))])
    return sp.coo_matrix((data, (np.tile(rows, 2), pairs.T.ravel())), (len(pairs), n)).tocsr()


def _factor(matrix: sp.spmatrix) -> SuperLU:
    """Factorise a symmetric positive definite matrix."""
    options = {"SymmetricMode": True}
    return splu(matrix.tocsc(), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=options)
