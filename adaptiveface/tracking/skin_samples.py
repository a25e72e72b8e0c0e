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
def look_up(
    images: tuple[np.ndarray, np.ndarray, np.ndarray],
    points: np.ndarray,
    lens: tuple[float, float, float, float],
    counts: np.ndarray,
) -> np.ndarray:
    """Values (3, Q, 3) of three images (H, W, 3) at points (Q, 3) in the camera frame, bilinear; zero where ``counts`` is.

    lens: fx, fy, cx and cy of the images. Counts (Q,) of points outside become zero, in place.
    """
    fx, fy, cx, cy = lens
    height, width = images[0].shape[:2]
    values = np.zeros((3, len(points), 3))
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
        for k in range(3):
            image = images[k]
            for c in range(3):
                above = (1 - a) * image[i, j, c] + a * image[i, j + 1, c]
                below = (1 - a) * image[i + 1, j, c] + a * image[i + 1, j + 1, c]
                values[k, q, c] = (1 - b) * above + b * below
    return values


@compiled(nogil=True)
def normal_equations(
    residuals: np.ndarray,
    weights: np.ndarray,
    along_u: np.ndarray,
    along_v: np.ndarray,
    points: np.ndarray,
    normals: np.ndarray,
    rotation: np.ndarray,
    lens: tuple[float, float, float, float],
) -> tuple[np.ndarray, np.ndarray]:
    """M (Q, 3, 3) and -sum_c w_qc r_qc g_qc (Q, 3) of every sample in the head frame, from r, w and gradients (Q, 3) per px.

    points, normals (Q, 3) in the camera frame; rotation (3, 3) head to camera; lens: fx, fy, cx and cy.
    """
    matrices, forces = np.zeros((len(points), 3, 3)), np.zeros((len(points), 3))
    row, turned = np.empty(3), np.empty(3)
    for q in range(len(points)):
        for c in range(3):
            weight = weights[q, c]
            if weight == 0.0:
                continue
            du, dv = along_u[q, c] * lens[0] / points[q, 2], along_v[q, c] * lens[1] / points[q, 2]
            row[0], row[1] = du, dv
            row[2] = -(du * points[q, 0] + dv * points[q, 1]) / points[q, 2]
            along = row[0] * normals[q, 0] + row[1] * normals[q, 1] + row[2] * normals[q, 2]
            for k in range(3):
                row[k] -= along * normals[q, k]
            for k in range(3):
                turned[k] = rotation[0, k] * row[0] + rotation[1, k] * row[1] + rotation[2, k] * row[2]
            for k in range(3):
                forces[q, k] -= weight * residuals[q, c] * turned[k]
                for m in range(3):
                    matrices[q, k, m] += weight * turned[k] * turned[m]
    return matrices, forces
