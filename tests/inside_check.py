"""How far parts inside a head stick out of it: signed distance from the skin, its openings closed by fans."""

from __future__ import annotations

import numpy as np
from trimesh.triangles import closest_point

from adaptiveface.insides import Insides
from adaptiveface.mesh import boundary_loops


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


def outside(points: np.ndarray, skin: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """(n,) mm by which points (n, 3) have come through the skin; 0 inside, and in an opening."""
    vertices, faces = closed(skin, triangles)
    corners = vertices[faces]
    depth = np.zeros(len(points))
    for k in np.flatnonzero(winding(points, corners) < 0.5):
        near = closest_point(corners, np.repeat(points[k : k + 1], len(corners), axis=0))
        distance = np.linalg.norm(near - points[k], axis=1)
        depth[k] = distance.min() if distance[: len(triangles)].min() <= distance[len(triangles) :].min() else 0.0
    return depth
