"""Everything the sensor sees: skin, eyeballs, the inside of the mouth, neck and shoulders, as one triangle mesh."""

from __future__ import annotations

import numpy as np

from ..mesh import transform_points
from .contacts import boundary_loops
from .performer import Performer

#: Part numbers of the scene's vertices.
SKIN, EYES, MOUTH, TORSO = range(4)

# Rings of the mouth's inside: how far behind the lips (mm), and size against the rim of the lips.
_MOUTH_RINGS = ((5.0, 1.1), (12.0, 1.1), (18.0, 0.7))
# Rings from the neck to the shoulders: down (mm), widening in x, widening in z, and how much the body stays behind when the
# head turns.
_TORSO_RINGS = (
    (10.0, 1.0, 1.0, 0.2), (22.0, 1.05, 1.02, 0.5), (34.0, 1.3, 1.08, 0.8), (46.0, 2.1, 1.15, 1.0), (60.0, 2.9, 1.2, 1.0),
    (85.0, 3.4, 1.25, 1.0), (240.0, 3.6, 1.3, 1.0),
)


class Scene:
    """The performer's whole visible surface.

    Attributes: triangles (S, 3); part (n,) int8 part of each vertex; skin: number of dense skin vertices, which come first;
    eye_directions (Q, 3): unit vectors of the eyeball vertices, for painting the iris.
    """

    def __init__(self, performer: Performer, base_pose: np.ndarray) -> None:
        self.performer = performer
        neutral = performer.surface(np.zeros(len(performer.expression_names)))
        self.skin = len(neutral)
        triangles, parts = [performer.surface_triangles], [np.full(self.skin, SKIN)]
        count = self.skin
        self.eye_directions, ball = icosphere(3)
        for _ in performer.eye_radii:
            triangles.append(ball + count)
            parts.append(np.full(len(self.eye_directions), EYES))
            count += len(self.eye_directions)
        self._mouth = performer.mouth_loop
        if self._mouth is not None:
            triangles.append(_tube(self._mouth, count, len(_MOUTH_RINGS), cap=True))
            added = len(_MOUTH_RINGS) * len(self._mouth) + 1
            parts.append(np.full(added, MOUTH))
            count += added
        self._neck = _neck_loop(performer)
        if self._neck is not None:
            triangles.append(_tube(self._neck, count, len(_TORSO_RINGS), cap=False))
            parts.append(np.full(len(_TORSO_RINGS) * len(self._neck), TORSO))
            self._body = transform_points(base_pose, neutral[self._neck])
        self.triangles = np.concatenate(triangles).astype(np.int64)
        self.part = np.concatenate(parts).astype(np.int8)

    def vertices(self, skin: np.ndarray, rigid: np.ndarray, gaze: np.ndarray | None = None) -> np.ndarray:
        """(n, 3) mm in the camera frame.

        skin (D, 3): the dense skin, head frame; rigid (4, 4): head to camera; gaze (2, 3, 3): rotations of the eyeballs.
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


def _neck_loop(performer: Performer) -> np.ndarray | None:
    loops = boundary_loops(performer.triangles, len(performer.neutral))
    lowest = min(loops, key=lambda loop: performer.neutral[loop, 1].mean(), default=None)
    if lowest is None or performer.neutral[lowest, 1].mean() > performer.neutral[:, 1].mean() - 40:
        return None
    return lowest


def _tube(loop: np.ndarray, first: int, n_rings: int, cap: bool) -> np.ndarray:
    """(k, 3) triangles from a rim to ``n_rings`` further rings that start at vertex ``first``, closed by one point."""
    n = len(loop)
    rows = np.vstack([loop, first + np.arange(n_rings * n).reshape(n_rings, n)])
    a, b = rows[:-1].ravel(), np.roll(rows[:-1], -1, axis=1).ravel()
    c, d = rows[1:].ravel(), np.roll(rows[1:], -1, axis=1).ravel()
    out = [np.stack([a, b, c], axis=1), np.stack([b, d, c], axis=1)]
    if cap:
        end = rows[-1]
        out.append(np.stack([end, np.roll(end, -1), np.full(n, first + n_rings * n)], axis=1))
    return np.concatenate(out)


def icosphere(subdivisions: int) -> tuple[np.ndarray, np.ndarray]:
    """Unit sphere: vertices (n, 3) and triangles (t, 3)."""
    from trimesh.creation import icosphere as make

    ball = make(subdivisions=subdivisions, radius=1.0)
    return np.asarray(ball.vertices), np.asarray(ball.faces, np.int64)
