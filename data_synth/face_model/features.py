"""Where the 40 facial features sit on the mesh, as triangles and barycentric weights.

Lip and lid features lie on the kept contours at the arc-length fraction that they have on MediaPipe's canonical face.
Brows and inner canthi have no contour in the base mesh: they are offsets from the eyeball's centre, between where
MediaPipe's FaceLandmarker finds them on renders of this model and where its canonical face has them (2 mm lower).
"""

from __future__ import annotations

import numpy as np
import trimesh

from adaptiveface.geometry.frame import MEDIAPIPE_INDICES

from .anatomy import Anatomy

# Left half: MediaPipe index -> (curve, arc-length fraction from the corner or the outer canthus).
ON_CURVES = {
    291: ("lip_outer_upper", 0.0),
    270: ("lip_outer_upper", 0.3206),
    267: ("lip_outer_upper", 0.7858),
    0: ("lip_outer_upper", 1.0),
    321: ("lip_outer_lower", 0.3137),
    314: ("lip_outer_lower", 0.7686),
    17: ("lip_outer_lower", 1.0),
    308: ("lip_inner_upper", 0.0),
    311: ("lip_inner_upper", 0.5804),
    13: ("lip_inner_upper", 1.0),
    402: ("lip_inner_lower", 0.5711),
    14: ("lip_inner_lower", 1.0),
    263: ("lid_upper", 0.0),
    387: ("lid_upper", 0.3362),
    385: ("lid_upper", 0.6647),
    373: ("lid_lower", 0.3333),
    380: ("lid_lower", 0.6724),
}
# MediaPipe index -> offset from the centre of the left eyeball, mm.
NEAR_EYE = {
    336: (-16.0, 20.6, 28.2),
    296: (-1.8, 22.2, 25.1),
    334: (10.5, 22.5, 18.6),
    293: (20.1, 19.8, 9.0),
    362: (-14.5, -4.3, 14.1),
}
# MediaPipe index on the left -> on the right.
RIGHT = {
    291: 61,
    270: 40,
    267: 37,
    321: 91,
    314: 84,
    308: 78,
    311: 81,
    402: 178,
    263: 33,
    387: 160,
    385: 158,
    373: 144,
    380: 153,
    336: 107,
    296: 66,
    334: 105,
    293: 63,
    362: 133,
}


def place_features(mean: np.ndarray, anatomy: Anatomy) -> tuple[np.ndarray, np.ndarray]:
    """Triangles (40, 3) of vertex numbers and weights (40, 3), in the order of ``adaptiveface.geometry.frame.FEATURE_IDS``."""
    mesh = anatomy.mesh
    triangle_of_edge = {}
    for triangle in mesh.triangles.tolist():
        for k in range(3):
            triangle_of_edge.setdefault(frozenset((triangle[k], triangle[k - 1])), triangle)
    placed = {i: _on_curve(mean, mesh.curves[curve], f, triangle_of_edge) for i, (curve, f) in ON_CURVES.items()}
    for i, offset in NEAR_EYE.items():
        placed[i] = _on_surface(mean, mesh.triangles, anatomy.left_eye.centre + offset)
    for left, right in RIGHT.items():
        triangle, weights = placed[left]
        placed[right] = (mesh.mirror[triangle], weights)
    ordered = [placed[int(i)] for i in MEDIAPIPE_INDICES]
    return np.array([t for t, _ in ordered]), np.array([w for _, w in ordered], np.float32)


def _on_curve(mean, curve: np.ndarray, fraction: float, triangle_of_edge: dict) -> tuple[np.ndarray, np.ndarray]:
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(mean[curve], axis=0), axis=1))])
    position = np.interp(fraction * length[-1], length, np.arange(len(curve)))
    i = min(int(position), len(curve) - 2)
    a, b, t = int(curve[i]), int(curve[i + 1]), position - i
    triangle = np.array(triangle_of_edge[frozenset((a, b))])
    return triangle, (1 - t) * (triangle == a) + t * (triangle == b)


def _on_surface(mean, triangles, point: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    corners = mean[triangles]
    closest = trimesh.triangles.closest_point(corners, np.broadcast_to(point, (len(triangles), 3)))
    best = int(((closest - point) ** 2).sum(axis=1).argmin())
    weights = trimesh.triangles.points_to_barycentric(corners[best : best + 1], closest[best : best + 1])[0]
    return triangles[best], np.clip(weights, 0, 1) / np.clip(weights, 0, 1).sum()
