"""How far parts inside a head stick out of it: signed distance from the skin, its openings closed by fans."""

from __future__ import annotations

import numpy as np
from trimesh.triangles import closest_point

from adaptiveface.geometry.mesh import boundary_loops
from adaptiveface.insides import Insides


def parts_of(insides: Insides) -> dict[str, slice]:
    """Name -> vertices of a part of :meth:`Insides.at`; of the mouth without the rim, which lies on the skin."""
    ball, mouth = len(insides.eyeball), len(insides.mouth_loop)
    lengths = {"left eye": ball, "": 2 * len(insides.lid_loops[0]), "right eye": ball, " ": 2 * len(insides.lid_loops[1])}
    lengths |= {"upper teeth": len(insides.upper), "lower teeth, tongue": len(insides.lower)}
    out, start = {}, 0
    for name, length in lengths.items():
        out[name], start = slice(start, start + length), start + length
    return {name: part for name, part in out.items() if name.strip()} | {"mouth": slice(start + mouth, start + 4 * mouth)}


def closed(skin: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The skin with a fan over every opening."""
    vertices, faces = [skin], [triangles]
    for k, loop in enumerate(boundary_loops(triangles, len(skin))):
        vertices.append(skin[loop].mean(axis=0, keepdims=True))
        middle = np.full(len(loop), len(skin) + k)
        faces.append(np.stack([np.roll(loop, -1), loop, middle], axis=1))
    return np.concatenate(vertices), np.concatenate(faces)


def winding(points: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """(n,) how often a closed surface of triangles (T, 3, 3) goes round each of the points (n, 3): 0 is outside."""
    out = np.zeros(len(points))
    for k, point in enumerate(points):
        a, b, c = np.moveaxis(corners - point, 1, 0)
        la, lb, lc = (np.sqrt(np.einsum("td,td->t", v, v)) for v in (a, b, c))
        volume = np.einsum("td,td->t", a, np.cross(b, c))
        below = la * lb * lc + np.einsum("td,td->t", a, b) * lc
        below += np.einsum("td,td->t", b, c) * la + np.einsum("td,td->t", c, a) * lb
        out[k] = np.arctan2(volume, below).sum() / (2 * np.pi)
    return out


def before_skin(points: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """(n,) bool: seen from straight ahead (+z), skin of triangles (T, 3, 3) lies behind the point and none in front of it.

    This is what "through the skin" means. Where lips roll into the mouth, the slit between them is outside the closed skin
    too, though teeth that are seen there stand behind the lips.
    """
    low, high = corners[:, :, :2].min(axis=1), corners[:, :, :2].max(axis=1)
    out = np.zeros(len(points), bool)
    for k, point in enumerate(points):
        near = np.flatnonzero(((low <= point[:2]) & (point[:2] <= high)).all(axis=1))
        a, b, c = np.moveaxis(corners[near] - point, 1, 0)
        weights = np.stack([_area(b, c), _area(c, a), _area(a, b)])
        facing = weights.sum(axis=0)  # twice the triangle's area seen from ahead, negative where it faces away
        met = (np.abs(facing) > 1e-12) & ((weights * np.sign(facing)) >= 0).all(axis=0)
        height = (weights[:, met] * np.stack([a[met, 2], b[met, 2], c[met, 2]])).sum(axis=0) / facing[met]
        out[k] = (height < 0).all() and bool((facing[met] > 0).any())
    return out


def _area(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """(n,) the cross product in x and y of (n, 3) and (n, 3)."""
    return a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]


def outside(points: np.ndarray, skin: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """(n,) mm by which points (n, 3) have come through the skin; 0 inside, in an opening, and behind skin."""
    vertices, faces = closed(skin, triangles)
    corners = vertices[faces]
    depth = np.zeros(len(points))
    before = np.flatnonzero(before_skin(points, skin[triangles]))
    for k in before[winding(points[before], corners) < 0.5]:
        near = closest_point(corners, np.repeat(points[k : k + 1], len(corners), axis=0))
        distance = np.linalg.norm(near - points[k], axis=1)
        depth[k] = distance.min() if distance[: len(triangles)].min() <= distance[len(triangles) :].min() else 0.0
    return depth
