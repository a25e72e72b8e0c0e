"""Everything the sensor sees: skin, eyeballs, the inside of the mouth, neck and shoulders, as one triangle mesh."""

from __future__ import annotations

import numpy as np

from ..geometry.mesh import boundary_loops, transform_points
from .performer import Performer

#: Part numbers of the scene's vertices.
SKIN, EYES, MOUTH, TORSO = range(4)

# Rings of the mouth's inside: how far behind the lips (mm), and size against the rim of the lips.
_MOUTH_RINGS = ((5.0, 1.1), (12.0, 1.1), (18.0, 0.7))
# Rings from the neck to the shoulders: down (mm), widening in x, widening in z, and how much the body stays where it is
# when the head turns.
_TORSO_RINGS = (
    (10.0, 1.0, 1.0, 0.2),
    (22.0, 1.05, 1.02, 0.5),
    (34.0, 1.3, 1.08, 0.8),
    (46.0, 2.1, 1.15, 1.0),
    (60.0, 2.9, 1.2, 1.0),
    (85.0, 3.4, 1.25, 1.0),
    (240.0, 3.6, 1.3, 1.0),
)


class Scene:
    """The performer's whole visible surface.

    Attributes
    ----------
    triangles : (S, 3) array
    part : (n,) int8 array
        Part of each vertex.
    skin : int
        Number of dense skin vertices. They come first.
    eye_directions : (Q, 3) array
        Unit vectors of the eyeball vertices, for painting the iris.
    """

    def __init__(self, performer: Performer, base_pose: np.ndarray) -> None:
        self.performer = performer
        neutral = performer.surface(np.zeros(len(performer.expression_names)))
        self.skin = len(neutral)
        triangles, parts = [performer.surface_triangles], [np.full(self.skin, SKIN)]
        count = self.skin
        self.eye_directions, ball = unit_sphere(24, 36)
        for _ in performer.eye_radii:
            triangles.append(ball + count)
            parts.append(np.full(len(self.eye_directions), EYES))
            count += len(self.eye_directions)
        # The loops of the dense skin: a tube on the coarser rim would leave cracks.
        loops = boundary_loops(performer.surface_triangles, self.skin)
        self._mouth = _loop_with(loops, performer.mouth_loop)
        if self._mouth is not None:
            triangles.append(_tube(self._mouth, count, len(_MOUTH_RINGS), cap=True))
            added = len(_MOUTH_RINGS) * len(self._mouth) + 1
            parts.append(np.full(added, MOUTH))
            count += added
        self._neck = _lowest_loop(loops, neutral)
        if self._neck is not None:
            triangles.append(_tube(self._neck, count, len(_TORSO_RINGS), cap=False))
            parts.append(np.full(len(_TORSO_RINGS) * len(self._neck), TORSO))
            self._body = transform_points(base_pose, neutral[self._neck])
        self.triangles = np.concatenate(triangles).astype(np.int64)
        self.part = np.concatenate(parts).astype(np.int8)

    def vertices(self, skin: np.ndarray, rigid: np.ndarray, gaze: np.ndarray | None = None) -> np.ndarray:
        """Place the whole scene in front of the camera.

        Parameters
        ----------
        skin : (D, 3) array
            The dense skin in the head frame, mm.
        rigid : (4, 4) array
            Transform from the head to the camera.
        gaze : (2, 3, 3) array, optional
            Rotations of the eyeballs.

        Returns
        -------
        (n, 3) array
            Vertices in the camera frame, mm.
        """
        in_head = [skin]
        for k, (centre, radius) in enumerate(zip(self.performer.eye_centres, self.performer.eye_radii, strict=True)):
            turned = self.eye_directions if gaze is None else self.eye_directions @ gaze[k].T
            in_head.append(centre + radius * turned)
        if self._mouth is not None:
            rim = skin[self._mouth]
            middle = rim.mean(axis=0)
            for back, size in _MOUTH_RINGS:
                in_head.append(middle + size * (rim - middle) - [0, 0, back])
            in_head.append(middle[None] - [0, 0, _MOUTH_RINGS[-1][0] + 3])
        out = [transform_points(rigid, np.concatenate(in_head))]
        if self._neck is not None:
            out += self._torso(transform_points(rigid, skin[self._neck]))
        return np.concatenate(out)

    def _torso(self, neck: np.ndarray) -> list[np.ndarray]:
        middle = self._body.mean(axis=0)
        rings = []
        for down, wide, deep, stays in _TORSO_RINGS:
            ring = (1 - stays) * neck + stays * self._body
            centre = (1 - stays) * neck.mean(axis=0) + stays * middle
            # Lower rings lie level, whatever the slope of the neck's cut.
            size = np.array([wide, max(1 - stays, 0.1), deep])
            rings.append(centre + (ring - centre) * size + [0, down, 0])
        return rings


def _loop_with(loops: list[np.ndarray], vertices: np.ndarray | None) -> np.ndarray | None:
    """The loop that runs through the given vertices."""
    if vertices is None:
        return None
    return next(loop for loop in loops if vertices[0] in loop)


def _lowest_loop(loops: list[np.ndarray], points: np.ndarray) -> np.ndarray | None:
    """The rim of the neck, if the mesh has one."""
    lowest = min(loops, key=lambda loop: points[loop, 1].mean(), default=None)
    if lowest is None or points[lowest, 1].mean() > points[:, 1].mean() - 40:
        return None
    return lowest


def _tube(loop: np.ndarray, first: int, n_rings: int, cap: bool) -> np.ndarray:
    """(k, 3) triangles from a rim to ``n_rings`` further rings that start at vertex ``first``, closed by one point.

    The rim runs as its mesh lists it (the mesh on its left), which turns the tube's outside to the mesh's outside.
    """
    n = len(loop)
    rows = np.vstack([loop, first + np.arange(n_rings * n).reshape(n_rings, n)])
    following = np.roll(rows, -1, axis=1)
    a, b, c, d = (x.ravel() for x in (rows[:-1], following[:-1], rows[1:], following[1:]))
    out = [np.stack([b, a, c], axis=1), np.stack([b, c, d], axis=1)]
    if cap:
        out.append(np.stack([following[-1], rows[-1], np.full(n, first + n_rings * n)], axis=1))
    return np.concatenate(out)


def unit_sphere(rings: int, segments: int) -> tuple[np.ndarray, np.ndarray]:
    """Return vertices (n, 3) and outward triangles (t, 3) of a unit sphere with its poles on the z axis."""
    height = np.pi * np.arange(1, rings) / rings
    round_ = 2 * np.pi * np.arange(segments) / segments
    ring = np.stack([np.cos(round_), np.sin(round_)], axis=1)
    body = np.concatenate([np.column_stack([np.sin(h) * ring, np.full(segments, np.cos(h))]) for h in height])
    vertices = np.concatenate([body, [[0, 0, 1], [0, 0, -1]]])
    rows = np.arange((rings - 1) * segments).reshape(rings - 1, segments)
    following = np.roll(rows, -1, axis=1)
    a, b, c, d = (x.ravel() for x in (rows[:-1], following[:-1], rows[1:], following[1:]))
    north, south = np.full(segments, len(body)), np.full(segments, len(body) + 1)
    triangles = [
        np.stack([a, c, b], axis=1),
        np.stack([b, c, d], axis=1),
        np.stack([north, rows[0], following[0]], axis=1),
        np.stack([south, following[-1], rows[-1]], axis=1),
    ]
    return vertices, np.concatenate(triangles)
