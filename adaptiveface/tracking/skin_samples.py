"""Samples of the skin in a picture: where a mesh carries them, what is seen there, and the rows that follow. Compiled.

dense_skin.py tells what they are for.
"""

from __future__ import annotations

import numpy as np

from ..caches.compiled import compiled

#: Cosine between skin and viewing ray: a sample does not count below the first, and fully from the second on.
FACING = (0.35, 0.65)
#: The residuals of so many neighbouring pixels count as one: what a picture cannot explain is no white noise.
CORRELATED = 3.0


@compiled(nogil=True)
def carry(
    vertices: np.ndarray, triangles: np.ndarray, corners: np.ndarray, measured: np.ndarray, reach: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Samples on vertices (n, 3) in the camera frame: points (Q, 3), unit normals (Q, 3), and how much each counts (Q,).

    Nothing where a corner was not ``measured`` (n,), less where the skin turns away, and at most as the independent pixels
    that a sample stands for; ``reach``: the distance between samples times the focal length, mm px.
    """
    points, normals, counts = np.empty((len(triangles), 3)), np.empty((len(triangles), 3)), np.zeros(len(triangles))
    for q in range(len(triangles)):
        a, b, c = triangles[q]
        along, length, distance = 0.0, 0.0, 0.0
        for k in range(3):
            i, j = (k + 1) % 3, (k + 2) % 3
            points[q, k] = corners[q, 0] * vertices[a, k] + corners[q, 1] * vertices[b, k] + corners[q, 2] * vertices[c, k]
            first = (vertices[b, i] - vertices[a, i]) * (vertices[c, j] - vertices[a, j])
            normals[q, k] = first - (vertices[b, j] - vertices[a, j]) * (vertices[c, i] - vertices[a, i])
            along += normals[q, k] * points[q, k]
            length += normals[q, k] ** 2
            distance += points[q, k] ** 2
        length = max(np.sqrt(length), 1e-12)
        for k in range(3):
            normals[q, k] /= length
        if measured[a] and measured[b] and measured[c]:
            facing = (-along / (length * np.sqrt(distance)) - FACING[0]) / (FACING[1] - FACING[0])
            counts[q] = min(max(facing, 0.0), 1.0) * min((reach / points[q, 2]) ** 2, 1.0) / CORRELATED
    return points, normals, counts


@compiled(nogil=True)
def look_up(image: np.ndarray, points: np.ndarray, lens: tuple[float, float, float, float], counts: np.ndarray) -> np.ndarray:
    """Values (Q, 3) of an image (H, W, 3) at points (Q, 3) in the camera frame, bilinear; zero where ``counts`` is.

    lens: fx, fy, cx and cy of the image. Counts (Q,) of points outside become zero, in place.
    """
    fx, fy, cx, cy = lens
    height, width = image.shape[:2]
    values = np.zeros((len(points), 3))
    for q in range(len(points)):
        if counts[q] == 0.0:
            continue
        x = fx * points[q, 0] / points[q, 2] + cx
        y = fy * points[q, 1] / points[q, 2] + cy
        if not (0.0 <= x < width - 1 and 0.0 <= y < height - 1):
            counts[q] = 0.0
            continue
        i, j = int(y), int(x)
        b, a = y - i, x - j
        for c in range(3):
            above = (1 - a) * image[i, j, c] + a * image[i, j + 1, c]
            below = (1 - a) * image[i + 1, j, c] + a * image[i + 1, j + 1, c]
            values[q, c] = (1 - b) * above + b * below
    return values


@compiled(nogil=True)
def normal_equations(
    residuals: np.ndarray,
    weights: np.ndarray,
    slopes: np.ndarray,
    vertices: np.ndarray,
    triangles: np.ndarray,
    rotation: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """M (Q, 3, 3) and -sum_c w_qc r_qc g_qc (Q, 3) of every sample in the head frame, from r and w (Q, 3).

    slopes (Q, 3, 2): how the channels change along the two edges from a triangle's first corner; g is the vector within
    the triangle that says so. vertices (n, 3) in the camera frame; rotation (3, 3) head to camera.
    """
    count = len(triangles)
    matrices, forces = np.zeros((count, 3, 3)), np.zeros((count, 3))
    first, second, row, turned = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    for q in range(count):
        if weights[q, 0] == 0.0 and weights[q, 1] == 0.0 and weights[q, 2] == 0.0:
            continue
        a, b, c = triangles[q]
        aa, ab, bb = 0.0, 0.0, 0.0
        for k in range(3):
            first[k], second[k] = vertices[b, k] - vertices[a, k], vertices[c, k] - vertices[a, k]
            aa += first[k] * first[k]
            ab += first[k] * second[k]
            bb += second[k] * second[k]
        area = max(aa * bb - ab * ab, 1e-9)
        for c in range(3):
            weight = weights[q, c]
            if weight == 0.0:
                continue
            x = (bb * slopes[q, c, 0] - ab * slopes[q, c, 1]) / area
            y = (aa * slopes[q, c, 1] - ab * slopes[q, c, 0]) / area
            for k in range(3):
                row[k] = x * first[k] + y * second[k]
            for k in range(3):
                turned[k] = rotation[0, k] * row[0] + rotation[1, k] * row[1] + rotation[2, k] * row[2]
            for k in range(3):
                forces[q, k] -= weight * residuals[q, c] * turned[k]
                for m in range(3):
                    matrices[q, k, m] += weight * turned[k] * turned[m]
    return matrices, forces
