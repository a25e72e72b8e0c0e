"""Where lips, lids and eyeballs are on the tracking mesh: the masks that mending, masks and features share."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from scipy.sparse.csgraph import dijkstra

from adaptiveface.geometry.mesh import adjacency

from .fields import FieldSmoother
from .lids import EyeOpening
from .mouth import REACH_MM, Lips
from .tracking_mesh import TrackingMesh

CORNER = 0.9  # slices of the mouth beyond this part of its half width are left alone: there the lips join


@dataclass(frozen=True)
class Anatomy:
    """Of one head.

    lip (V,) bool: both lips from outer contour to opening; inner_lip (V,) bool: the part behind the inner contour;
    lip_distance, left_lid_distance, lid_distance (V,) mm along the surface.
    """

    mesh: TrackingMesh
    smoother: FieldSmoother
    lips: Lips
    lip: np.ndarray
    inner_lip: np.ndarray
    left_eye: EyeOpening
    lip_distance: np.ndarray
    left_lid_distance: np.ndarray
    lid_distance: np.ndarray


def find_anatomy(vertices: np.ndarray, left_eyeball: np.ndarray, mesh: TrackingMesh) -> Anatomy:
    """``vertices`` (V, 3) mm of the (mean) head, ``left_eyeball`` (q, 3) points of the subject's left eyeball."""
    graph = _edge_lengths(vertices, mesh.triangles)
    upper_curves, lower_curves = mesh.both("lip_outer_upper"), mesh.both("lip_outer_lower")
    upper_inner, lower_inner = mesh.both("lip_inner_upper"), mesh.both("lip_inner_lower")
    outline, inner = np.union1d(upper_curves, lower_curves), np.union1d(upper_inner, lower_inner)
    lip = _flood(graph, inner, outline)
    inner_lip = _flood(graph, mesh.both("mouth_upper", "mouth_lower"), inner)
    to_upper = _distance(graph, np.union1d(upper_curves, upper_inner))
    to_lower = _distance(graph, np.union1d(lower_curves, lower_inner))
    central = lip & (np.abs(vertices[:, 0]) < CORNER * np.abs(vertices[inner, 0]).max())
    lip_distance = _distance(graph, np.flatnonzero(lip))
    lips = Lips(central & (to_upper < to_lower), central & (to_lower < to_upper), lip_distance < REACH_MM)
    margins = np.concatenate([mesh.curves["lid_upper"], mesh.curves["lid_lower"]])
    centre = left_eyeball.mean(axis=0)
    radius = float(np.linalg.norm(left_eyeball - centre, axis=1).max())
    eye = EyeOpening(mesh.curves["lid_upper"][::-1], mesh.curves["lid_lower"][::-1], centre, radius)
    left = _distance(graph, margins)
    return Anatomy(
        mesh,
        FieldSmoother(vertices, mesh.triangles),
        lips,
        lip,
        inner_lip,
        eye,
        lip_distance,
        left,
        np.minimum(left, left[mesh.mirror]),
    )


def _edge_lengths(vertices: np.ndarray, triangles: np.ndarray) -> sp.csr_matrix:
    graph = adjacency(triangles, len(vertices)).tocoo()
    graph.data = np.linalg.norm(vertices[graph.row] - vertices[graph.col], axis=1)
    return graph.tocsr()


def _distance(graph: sp.csr_matrix, sources: np.ndarray) -> np.ndarray:
    return dijkstra(graph, indices=sources, min_only=True)


def _flood(graph: sp.csr_matrix, seeds: np.ndarray, walls: np.ndarray) -> np.ndarray:
    """(V,) bool: reached from the seeds along edges without stepping on a wall vertex."""
    open_ = np.ones(graph.shape[0], bool)
    open_[walls] = False
    reached = np.zeros(graph.shape[0], bool)
    reached[seeds] = True
    joined = (graph > 0).astype(float)
    while True:
        wider = reached | ((joined @ reached > 0) & open_)
        if (wider == reached).all():
            return reached
        reached = wider
