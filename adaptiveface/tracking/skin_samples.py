"""Samples of the skin in a picture: where a mesh carries them, what is seen there, and the rows that follow. Compiled.

dense_skin.py and feature_refinement.py tell what they are for.
"""

from __future__ import annotations

import numpy as np

from ..caches.compiled import compiled

#: Cosine between skin and viewing ray: a sample does not count below the first, and fully from the second on.
FACING = (0.35, 0.65)
#: The residuals of so many neighbouring pixels count as one: what a picture or a patch cannot explain is no white noise.
CORRELATED = 3.0
_ONE = np.uint32(1)


# Numbers of corners and pixels are made unsigned: numba tests each signed index for being negative.


@compiled(inline="always")
def _place(vertices: np.ndarray, triangle: np.ndarray, shares: np.ndarray) -> tuple[float, float, float, float, float, float]:
    """A sample's point, from its barycentric coordinates (3,), and its triangle's normal, twice the area long."""
    a, b, c = np.uint32(triangle[0]), np.uint32(triangle[1]), np.uint32(triangle[2])
    r, s, t = shares[0], shares[1], shares[2]
    ax, ay, az = vertices[a, 0], vertices[a, 1], vertices[a, 2]
    bx, by, bz = vertices[b, 0], vertices[b, 1], vertices[b, 2]
    cx, cy, cz = vertices[c, 0], vertices[c, 1], vertices[c, 2]
    x, y, z = r * ax + s * bx + t * cx, r * ay + s * by + t * cy, r * az + s * bz + t * cz
    bx, by, bz, cx, cy, cz = bx - ax, by - ay, bz - az, cx - ax, cy - ay, cz - az
    nx, ny, nz = by * cz - bz * cy, bz * cx - bx * cz, bx * cy - by * cx
    return x, y, z, nx, ny, nz


@compiled(nogil=True)
def moved(vertices: np.ndarray, displacement: np.ndarray, pose: np.ndarray) -> np.ndarray:
    """R (``vertices`` + ``displacement``) + t (n, 3) of a pose (4, 4), computed in one pass."""
    out = np.empty((len(vertices), 3))
    for i in range(len(vertices)):
        x, y, z = vertices[i, 0] + displacement[i, 0], vertices[i, 1] + displacement[i, 1], vertices[i, 2] + displacement[i, 2]
        for k in range(3):
            out[i, k] = pose[k, 0] * x + pose[k, 1] * y + pose[k, 2] * z + pose[k, 3]
    return out


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
        a, b, c = np.uint32(triangles[q, 0]), np.uint32(triangles[q, 1]), np.uint32(triangles[q, 2])
        x, y, z, nx, ny, nz = _place(vertices, triangles[q], corners[q])
        scale = 1.0 / max(np.sqrt(nx * nx + ny * ny + nz * nz), 1e-12)
        nx, ny, nz = nx * scale, ny * scale, nz * scale
        points[q, 0], points[q, 1], points[q, 2] = x, y, z
        normals[q, 0], normals[q, 1], normals[q, 2] = nx, ny, nz
        if measured[a] and measured[b] and measured[c]:
            cosine = -(nx * x + ny * y + nz * z) / np.sqrt(x * x + y * y + z * z)
            facing = (cosine - FACING[0]) / (FACING[1] - FACING[0])
            counts[q] = min(max(facing, 0.0), 1.0) * min((reach / z) ** 2, 1.0) / CORRELATED
    return points, normals, counts


@compiled(nogil=True)
def carry_to_pixels(
    mesh: np.ndarray,
    pose: np.ndarray,
    lens: tuple[float, float, float, float],
    triangles: np.ndarray,
    corners: np.ndarray,
    nearness: np.ndarray,
    area: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Samples on a mesh (N, 3) in the head frame: their pixels (Q, 2), and by how much each of them counts (Q,).

    Less where the skin turns away; and at most as the independent pixels that it stands for. lens: fx, fy, cx and cy.
    """
    pixels, counts = np.empty((len(triangles), 2)), np.empty(len(triangles))
    camera = np.empty(3)  # where it is, in the head frame
    for k in range(3):
        camera[k] = -(pose[0, k] * pose[0, 3] + pose[1, k] * pose[1, 3] + pose[2, k] * pose[2, 3])
    for q in range(len(triangles)):
        x, y, z, nx, ny, nz = _place(mesh, triangles[q], corners[q])
        u, v, w = camera[0] - x, camera[1] - y, camera[2] - z
        size = (nx * nx + ny * ny + nz * nz) * (u * u + v * v + w * w)
        facing = ((nx * u + ny * v + nz * w) / max(np.sqrt(size), 1e-9) - FACING[0]) / (FACING[1] - FACING[0])
        depth = pose[2, 0] * x + pose[2, 1] * y + pose[2, 2] * z + pose[2, 3]
        pixels[q, 0] = lens[0] * (pose[0, 0] * x + pose[0, 1] * y + pose[0, 2] * z + pose[0, 3]) / depth + lens[2]
        pixels[q, 1] = lens[1] * (pose[1, 0] * x + pose[1, 1] * y + pose[1, 2] * z + pose[1, 3]) / depth + lens[3]
        independent = min(area[q] * (lens[0] / depth) ** 2, 1.0) / CORRELATED
        counts[q] = nearness[q] * min(max(facing, 0.0), 1.0) * independent
    return pixels, counts


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
        i, j = np.uint32(y), np.uint32(x)
        b, a = np.float32(y - i), np.float32(x - j)
        for c in range(3):
            above = image[i, j, c] + a * (image[i, j + _ONE, c] - image[i, j, c])
            below = image[i + _ONE, j, c] + a * (image[i + _ONE, j + _ONE, c] - image[i + _ONE, j, c])
            values[q, c] = above + b * (below - above)
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

    Summed over the channels in the coordinates along the edges, and turned into the head frame once.
    """
    count = len(triangles)
    matrices, forces = np.zeros((count, 3, 3)), np.zeros((count, 3))
    first, second = np.empty(3), np.empty(3)
    for q in range(count):
        if weights[q, 0] == 0.0 and weights[q, 1] == 0.0 and weights[q, 2] == 0.0:
            continue
        a, b, c = np.uint32(triangles[q, 0]), np.uint32(triangles[q, 1]), np.uint32(triangles[q, 2])
        ux, uy, uz = vertices[b, 0] - vertices[a, 0], vertices[b, 1] - vertices[a, 1], vertices[b, 2] - vertices[a, 2]
        vx, vy, vz = vertices[c, 0] - vertices[a, 0], vertices[c, 1] - vertices[a, 1], vertices[c, 2] - vertices[a, 2]
        aa, ab, bb = ux * ux + uy * uy + uz * uz, ux * vx + uy * vy + uz * vz, vx * vx + vy * vy + vz * vz
        scale = 1.0 / max(aa * bb - ab * ab, 1e-9)
        aa, ab, bb = aa * scale, ab * scale, bb * scale
        xx, xy, yy, fx, fy = 0.0, 0.0, 0.0, 0.0, 0.0
        for channel in range(3):
            weight, along, across = weights[q, channel], slopes[q, channel, 0], slopes[q, channel, 1]
            x, y = bb * along - ab * across, aa * across - ab * along
            pull = -weight * residuals[q, channel]
            fx, fy = fx + pull * x, fy + pull * y
            xx, xy, yy = xx + weight * x * x, xy + weight * x * y, yy + weight * y * y
        for k in range(3):
            first[k] = rotation[0, k] * ux + rotation[1, k] * uy + rotation[2, k] * uz
            second[k] = rotation[0, k] * vx + rotation[1, k] * vy + rotation[2, k] * vz
        for k in range(3):
            forces[q, k] = fx * first[k] + fy * second[k]
            left, right = xx * first[k] + xy * second[k], xy * first[k] + yy * second[k]
            for m in range(3):
                matrices[q, k, m] = left * first[m] + right * second[m]
    return matrices, forces
