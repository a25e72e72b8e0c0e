"""Measure errors between a tracked mesh and the true one, by pure functions of arrays.

Shapes: N vertices (the tracked and the true mesh share their numbering), T triangles, n scored vertices, F frames. Lengths are
in mm.

Three questions, three measures:

* Does the surface lie on the true surface? :func:`surface_distance` does not see sliding within the surface.
* Does every vertex lie on its true counterpart? :func:`split_by_normal` of the difference tells.
* Does every vertex *move* like its counterpart? :func:`motion_error` removes the constant error of the neutral, but not the
  error of the pose. :func:`active_share` divides it by the true motion.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from ..caches.compiled import compiled
from ..geometry.mesh import rigid_alignment, transform_points

#: A (frame, vertex) pair is *active* when the true skin has moved this far from the neutral in the head frame, mm.
ACTIVE_MOTION = 2.0


class TrueSurface:
    """Measures distances of points from a true mesh.

    The distance of every triangle around the ``candidates`` nearest true vertices is computed exactly (Ericson 2005,
    section 5.1.5). The smallest one is the exact distance if the closest triangle touches one of those vertices.
    It does on meshes with edges of a few millimetres (the tests compare with all triangles).

    Parameters
    ----------
    vertices : (N, 3)
        Vertices of the mesh, mm.
    triangles : (T, 3) int
        Vertex numbers.
    candidates : int
        Number of nearest vertices to search around.
    """

    def __init__(self, vertices: np.ndarray, triangles: np.ndarray, candidates: int = 3):
        self.vertices = np.ascontiguousarray(vertices, float)
        self.triangles = np.ascontiguousarray(triangles, np.int64)
        self.candidates = candidates
        used = np.unique(triangles)
        self._used, self._tree = used, cKDTree(self.vertices[used], balanced_tree=False, compact_nodes=False)
        order = np.argsort(self.triangles.ravel(), kind="stable")
        self._incident = order // 3
        self._start = np.searchsorted(self.triangles.ravel()[order], np.arange(len(vertices) + 1))

    def distance(self, points: np.ndarray) -> np.ndarray:
        """Return the unsigned distances (n,) of points (n, 3) from the surface, mm."""
        points = np.ascontiguousarray(points, float)
        _, near = self._tree.query(points, k=min(self.candidates, len(self._used)))
        near = self._used[near.reshape(len(points), -1)]
        return _distance_to_incident_triangles(points, near, self.vertices, self.triangles, self._start, self._incident)


def surface_distance(
    vertices: np.ndarray, truth_vertices: np.ndarray, triangles: np.ndarray, mask: np.ndarray | None = None
) -> np.ndarray:
    """Measure the distances of tracked vertices from the true surface.

    The evaluation scores the frontal vertices that may take depth (``frontal & depth_valid``). Inner lips and lid rims, which
    no depth camera sees, are left out. The true surface is the whole head and not only its masked part.

    Parameters
    ----------
    vertices : (N, 3)
        The tracked vertices, mm.
    truth_vertices : (N, 3)
        The true vertices, mm.
    triangles : (T, 3) int
        Vertex numbers of the true surface.
    mask : (N,) bool, optional
        The vertices to measure. By default, all are measured.

    Returns
    -------
    (n,)
        Distances of the n measured vertices, mm.
    """
    points = vertices if mask is None else vertices[mask]
    return TrueSurface(truth_vertices, triangles).distance(points)


def split_by_normal(error: np.ndarray, normals: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Split error vectors into their parts along the normals and within the surface.

    Parameters
    ----------
    error : (..., 3)
        Error vectors, mm.
    normals : (..., 3)
        Unit normals.

    Returns
    -------
    normal : (...)
        Signed length of the part along the normal, mm.
    tangential : (...)
        Length of the rest, mm.
    """
    normal = np.einsum("...d,...d->...", error, normals)
    tangential = np.linalg.norm(error - normal[..., None] * normals, axis=-1)
    return normal, tangential


def neutral_alignment(neutral: np.ndarray, true_neutral: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """Find the rigid transform A from the tracker's head frame to the true one by the neutrals.

    Two meshes of one head may have different head frames. A removes that difference once for all frames.

    Parameters
    ----------
    neutral, true_neutral : (N, 3)
        The two neutrals in their head frames, mm.
    mask : (N,) bool
        The vertices to align.

    Returns
    -------
    (4, 4)
        The transform A, mm.
    """
    return rigid_alignment(neutral[mask], true_neutral[mask])


def tracked_alignment(poses: np.ndarray, true_poses: np.ndarray) -> np.ndarray:
    """Find the rigid transform A from the tracker's head frame to the true one, as a mean over frames of a resting face.

    With this alignment, a resting face that lies on its neutral has no motion error. With :func:`neutral_alignment`, which is
    used for all figures unless stated otherwise, it has one: if vertices of the forehead or the cheeks slid along the skin in
    the neutral, fitting all vertices also moves the lips (by 0.3 to 0.6 mm on five performers that were captured with detected
    features).

    Parameters
    ----------
    poses, true_poses : (F, 4, 4)
        The tracked and the true transforms from the head frame to the camera frame, mm.

    Returns
    -------
    (4, 4)
        The transform A, mm.
    """
    relative = np.linalg.inv(true_poses) @ poses
    out = np.eye(4)
    out[:3, :3] = Rotation.from_matrix(relative[:, :3, :3]).mean().as_matrix()
    out[:3, 3] = relative[:, :3, 3].mean(axis=0)
    return out


def true_motion(truth_vertices: np.ndarray, true_rigid: np.ndarray, true_neutral: np.ndarray) -> np.ndarray:
    """Return the displacement of the true mesh from its neutral.

    Parameters
    ----------
    truth_vertices : (N, 3)
        The true mesh in the camera frame, mm.
    true_rigid : (4, 4)
        Transform from the head frame to the camera frame, mm.
    true_neutral : (N, 3)
        The true neutral in the head frame, mm.

    Returns
    -------
    (N, 3)
        The displacement in the camera frame, mm.
    """
    return truth_vertices - transform_points(true_rigid, true_neutral)


def motion_error(
    vertices: np.ndarray,
    neutral: np.ndarray,
    truth_vertices: np.ndarray,
    true_neutral: np.ndarray,
    true_rigid: np.ndarray,
    alignment: np.ndarray,
) -> np.ndarray:
    """Correspondence error (N, 3) without the error of the neutral, camera frame, mm.

    e_i = (v_i - R A b0_i) - (v*_i - R b0*_i), with v (N, 3) the tracked and v* the true vertices in the camera frame,
    b0 and b0* the tracked and true neutral in their head frames, R = ``true_rigid`` (4, 4) the true head-to-camera pose
    and A = ``alignment`` (4, 4) of :func:`neutral_alignment`. The pose error remains in e. Only the
    constant difference of the neutrals is removed, moved by the true pose. A face that follows the head but never changes its
    expression has e = -(true motion).
    """
    tracked_motion = vertices - transform_points(true_rigid @ alignment, neutral)
    return tracked_motion - true_motion(truth_vertices, true_rigid, true_neutral)


def active_share(error: np.ndarray, motion: np.ndarray, threshold: float = ACTIVE_MOTION) -> float:
    """Return the share of the motion error in the true motion, over the pairs whose true motion exceeds a threshold.

    Parameters
    ----------
    error, motion : array
        Lengths of the motion error and of the true motion, mm. They have the same shape, with any number of axes (frames,
        vertices).
    threshold : float
        Smallest true motion that counts, mm.

    Returns
    -------
    float
        The sum of ``error`` divided by the sum of ``motion``. 0 is perfect, and a face that never moves scores 1. The result is
        NaN if nothing moves.
    """
    active = motion > threshold
    return float(error[active].sum() / motion[active].sum()) if active.any() else float("nan")


def pose_error(rigid: np.ndarray, true_rigid: np.ndarray, alignment: np.ndarray, centre: np.ndarray) -> tuple[float, float]:
    """Measure the error of a head pose.

    Parameters
    ----------
    rigid, true_rigid : (4, 4)
        The tracked and the true transform from the head frame to the camera frame, mm.
    alignment : (4, 4)
        Transform from the tracker's head frame to the true one (:func:`neutral_alignment`), mm.
    centre : (3,)
        The point of the true head frame at which the shift is measured, mm.

    Returns
    -------
    shift : float
        Distance between the two places of ``centre``, mm.
    angle : float
        Angle between the two poses, degrees.
    """
    difference = np.linalg.inv(true_rigid @ alignment) @ rigid
    at = np.linalg.inv(alignment)[:3, :3] @ (centre - alignment[:3, 3])
    shift = np.linalg.norm(transform_points(difference, at) - at)
    sine = np.linalg.norm(difference[:3, :3] - difference[:3, :3].T) / np.sqrt(8.0)
    return float(shift), float(np.degrees(np.arctan2(sine, (np.trace(difference[:3, :3]) - 1) / 2)))


@compiled
def _distance_to_incident_triangles(points, near, vertices, triangles, start, incident):
    """Smallest distance of each point (n, 3) to the triangles around its near vertices (n, k)."""
    distances = np.empty(len(points))
    seen = np.full(len(triangles), -1)  # the last point that visited each triangle; neighbouring vertices share triangles
    for i in range(len(points)):
        best = np.inf
        for vertex in near[i]:
            for entry in range(start[vertex], start[vertex + 1]):
                t = incident[entry]
                if seen[t] != i:
                    seen[t] = i
                    a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
                    best = min(best, _squared_distance_to_triangle(points[i], vertices[a], vertices[b], vertices[c]))
        distances[i] = np.sqrt(best)
    return distances


@compiled
def _squared_distance_to_triangle(p, a, b, c):
    """Squared distance of point p from triangle abc: the Voronoi regions of its corners, edges and inside in turn."""
    ab, ac = _sub(b, a), _sub(c, a)
    ap, bp, cp = _sub(p, a), _sub(p, b), _sub(p, c)
    d1, d2, d3, d4, d5, d6 = _dot(ab, ap), _dot(ac, ap), _dot(ab, bp), _dot(ac, bp), _dot(ab, cp), _dot(ac, cp)
    if d1 <= 0.0 and d2 <= 0.0:
        return _dot(ap, ap)
    if d3 >= 0.0 and d4 <= d3:
        return _dot(bp, bp)
    if d6 >= 0.0 and d5 <= d6:
        return _dot(cp, cp)
    va, vb, vc = d3 * d6 - d5 * d4, d5 * d2 - d1 * d6, d1 * d4 - d3 * d2
    if vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
        return _squared_rest(ap, ab, d1 / (d1 - d3), ac, 0.0)
    if vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
        return _squared_rest(ap, ab, 0.0, ac, d2 / (d2 - d6))
    if va <= 0.0 and d4 >= d3 and d5 >= d6:
        share = (d4 - d3) / ((d4 - d3) + (d5 - d6))
        return _squared_rest(ap, ab, 1.0 - share, ac, share)
    area = va + vb + vc
    return _squared_rest(ap, ab, vb / area, ac, vc / area)


@compiled
def _squared_rest(ap, ab, v, ac, w):
    """Squared distance |ap - v ab - w ac|^2 of p from the point with barycentric coordinates (1 - v - w, v, w)."""
    rest = (ap[0] - v * ab[0] - w * ac[0], ap[1] - v * ab[1] - w * ac[1], ap[2] - v * ab[2] - w * ac[2])
    return _dot(rest, rest)


@compiled
def _sub(u, v):
    return u[0] - v[0], u[1] - v[1], u[2] - v[2]


@compiled
def _dot(u, v):
    return u[0] * v[0] + u[1] * v[1] + u[2] * v[2]
