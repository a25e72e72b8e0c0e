"""What is inside a head: eyeballs with irises, teeth, tongue and the dark of the mouth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from face_model.makehuman import MakeHuman

from adaptiveface.geometry.mesh import rotation_vector_matrix
from adaptiveface.insides.parts import eyeball_mesh, rim_height, smooth_ring

#: Degrees of an eyeball's turn at full activation.
GAZE = {"eyeLookIn": 26.0, "eyeLookOut": 26.0, "eyeLookUp": 20.0, "eyeLookDown": 22.0}


@dataclass
class Part:
    """A piece of the character: vertices (n, 3) mm, triangles (t, 3), colours (n, 3), displacements by expression."""

    vertices: np.ndarray
    triangles: np.ndarray
    colours: np.ndarray
    expressions: dict[str, np.ndarray]


def eyeball(centre: np.ndarray, radius: float, side: str, iris: tuple) -> Part:
    """A sphere whose pole looks along +z; ``side`` is Left or Right."""
    unit, triangles, colours = eyeball_mesh(iris)
    shape = radius * unit
    expressions = {}
    for look, degrees in GAZE.items():
        away = 1.0 if side == "Left" else -1.0  # the subject's left is +x
        axis = {"eyeLookUp": (-1, 0, 0), "eyeLookDown": (1, 0, 0), "eyeLookOut": (0, away, 0), "eyeLookIn": (0, -away, 0)}
        turn = rotation_vector_matrix(np.radians(degrees) * np.array(axis[look], float))
        expressions[look + side] = shape @ turn.T - shape
    return Part(centre + shape, triangles, colours, expressions)


def mouth_cavity(skin: Part, loop: np.ndarray, scale: float, colour) -> Part:
    """The dark behind the lips: the mouth's rim (vertices ``loop`` of the skin, in order) drawn inwards and closed.

    It starts on the rim and moves with it, so that no light shines through between lips and cavity.
    """
    rim = skin.vertices[loop]
    height = rim_height(rim) * 13.0 * scale
    depths, spreads, follow = (0.0, 5.0, 16.0, 42.0), (0.0, 0.25, 0.75, 0.75), (1.0, 0.95, 0.85, 0.6)
    middle = rim.mean(axis=0)
    rings = []
    for depth, spread in zip(depths, spreads, strict=True):
        ring = rim + np.stack([np.zeros(len(rim)), spread * height, np.full(len(rim), -depth * scale)], axis=1)
        ring[:, 0] = middle[0] + (rim[:, 0] - middle[0]) * (1 - 0.35 * (depth / depths[-1]) ** 2)
        rings.append(ring)
    count, n = len(rings), len(rim)
    vertices = np.concatenate([*rings, [rings[-1].mean(axis=0)]])
    triangles = []
    for k in range(n):
        j = (k + 1) % n
        for r in range(count - 1):
            a, b, c, d = r * n + k, r * n + j, (r + 1) * n + j, (r + 1) * n + k
            triangles += [[a, d, c], [a, c, b]]
        triangles.append([(count - 1) * n + k, count * n, (count - 1) * n + j])
    shade = np.repeat([1.0, 0.8, 0.55, 0.35], n)
    colours = np.append(shade, 0.3)[:, None] * np.array(colour, float)
    expressions = {}
    for name, displacement in skin.expressions.items():
        at = displacement[loop]
        if np.abs(at).max() > 0.05:
            inner = [f * ((1 - s) * at + s * smooth_ring(at)) for f, s in zip(follow, (0, 0.7, 1, 1), strict=True)]
            expressions[name] = np.concatenate([*inner, [inner[-1].mean(axis=0)]])
    return Part(vertices, np.array(triangles), colours, expressions)


def base_part(base: MakeHuman, quads: np.ndarray, head: np.ndarray, scale: float, colour) -> Part:
    """Quads (Q, 4) of the base mesh as they are on ``head`` (N, 3); expressions scaled by ``scale``."""
    ids, local = np.unique(quads, return_inverse=True)
    local = local.reshape(quads.shape)
    triangles = np.concatenate([local[:, [0, 1, 2]], local[:, [0, 2, 3]]])
    triangles = triangles[
        (triangles[:, 0] != triangles[:, 1]) & (triangles[:, 1] != triangles[:, 2]) & (triangles[:, 0] != triangles[:, 2])
    ]
    expressions = {}
    for name in base.face_unit_names():
        displacement = scale * base.face_unit(name)[ids].astype(float)
        if np.abs(displacement).max() > 0.05:
            expressions[name] = displacement
    colours = np.full((len(ids), 3), colour, float)
    return Part(head[ids], triangles, colours, expressions)


def grow_tusks(part: Part, length: float) -> None:
    """Draw the lower canines up and forward into tusks, in place."""
    points = part.vertices
    middle, half = points[:, 0].mean(), np.ptp(points[:, 0]) / 2
    top = points[:, 1] > np.quantile(points[:, 1], 0.45)
    for side in (1, -1):
        at = np.abs((points[:, 0] - middle) * side / half - 0.66) < 0.14
        tip = at & top & (points[:, 2] > np.quantile(points[:, 2], 0.3))
        points[tip] += [side * 0.12 * length, length, 0.75 * length]
