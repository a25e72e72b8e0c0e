"""Fit eyeballs, teeth, tongue and mouth to a head with the embedded model's mesh, and move them with its skin."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from ..geometry.frame import FEATURE_IDS
from ..geometry.mesh import boundary_loops, rotation_vector_matrix, surface_points
from ..model.face_model import FaceModel, embedded_face_model
from .parts import CAVITY, CORNEA, eyeball_mesh, rim_height, smooth_ring, strip, teeth_mesh, tongue_mesh

IRIS = (92, 116, 128)
#: Numbers of the rigid parts, and of the soft vertices.
PARTS = LEFT_EYE, RIGHT_EYE, UPPER, LOWER = range(4)
SOFT = -1
#: Distance of the skin in front of an eyeball, mm: half the sag of a lid's triangles.
CLEARANCE = 0.35
#: Radius of an iris, and height of its centre above the middle between the lids when the eye looks ahead, mm.
IRIS_RADIUS, IRIS_RISE = 5.85, 0.5
#: Radius within which the rim of a lip covers the teeth, mm.
LIP_WIDTH = 2.0
#: Rings of the mouth behind its rim: depth in mm, widening, share of the rim's motion, and brightness.
_MOUTH = ((0.0, 0.0, 1.0, 1.0), (4.0, 0.3, 0.97, 0.8), (14.0, 0.9, 0.85, 0.5), (44.0, 0.8, 0.6, 0.3))
#: Largest height of the mouth behind the lips, mm above and below its middle.
_MOUTH_HEIGHT = 15.0


@dataclass(frozen=True)
class Insides:
    """The parts inside one head, in millimetres and the head frame. :meth:`at` places them all.

    ``triangles`` (T, 3) are triangles of P vertices, and ``colours`` (P, 3) are uint8. ``eye_centres`` (2, 3) and
    ``eye_radii`` (2,) list the subject's left eye first.
    """

    triangles: np.ndarray
    colours: np.ndarray
    eye_centres: np.ndarray
    eye_radii: np.ndarray
    neutral_skin: np.ndarray
    lid_loops: tuple[np.ndarray, np.ndarray]
    lid_skin: tuple[np.ndarray, np.ndarray]
    mouth_loop: np.ndarray
    mouth_height: np.ndarray
    eyeball: np.ndarray
    upper: np.ndarray
    lower: np.ndarray
    jaw: Jaw

    @cached_property
    def part(self) -> np.ndarray:
        """(P,) int8 number of each vertex's rigid part among :data:`PARTS`; -1 for soft vertices, which move with the skin."""
        ball, lids = np.full(len(self.eyeball), LEFT_EYE), [np.full(2 * len(loop), SOFT) for loop in self.lid_loops]
        pieces = [ball, lids[0], ball + (RIGHT_EYE - LEFT_EYE), lids[1]]
        pieces += [np.full(len(self.upper), UPPER), np.full(len(self.lower), LOWER)]
        pieces.append(np.full(len(_MOUTH) * len(self.mouth_loop) + 1, SOFT))
        return np.concatenate(pieces).astype(np.int8)

    @cached_property
    def rest(self) -> np.ndarray:
        """(P, 3) vertices of the rigid parts under the identity placement, mm; zero for the soft parts."""
        out = np.zeros((len(self.part), 3))
        balls = [radius * self.eyeball for radius in self.eye_radii]
        for number, points in enumerate((*balls, self.upper, self.lower)):
            out[self.part == number] = points
        return out

    def at(self, skin: np.ndarray, gaze: np.ndarray | None = None) -> np.ndarray:
        """Place the parts inside a head.

        Parameters
        ----------
        skin : (N, 3) array
            Vertices of the head's skin in the head frame, mm.
        gaze : (2, 2) array, optional
            Yaw and pitch of the left and the right eye, rad, as in :func:`gaze_rotation`. By default the eyes look ahead.

        Returns
        -------
        (P, 3) array
            Vertices of the parts in the head frame, mm.
        """
        return placed(self.rest, self.part, *self.motion(skin, gaze))

    def motion(self, skin: np.ndarray, gaze: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Return placements (4, 3, 4) of the rigid :data:`PARTS` and soft vertices (n, 3), mm, given what :meth:`at` takes."""
        turns = np.zeros((2, 2)) if gaze is None else gaze
        placements, soft = np.zeros((len(PARTS), 3, 4)), []
        for side, number in enumerate((LEFT_EYE, RIGHT_EYE)):
            centre = self.eye_centres[side] - [0.0, 0.0, self.retreat(skin, side)]
            placements[number] = np.column_stack([gaze_rotation(*turns[side]), centre])
            rim = skin[self.lid_loops[side]]
            arm = rim - centre
            length = np.linalg.norm(arm, axis=1, keepdims=True)
            soft += [rim, centre + arm / length * np.minimum(0.985 * self.eye_radii[side], length)]
        lips, jaw = skin[self.mouth_loop], self.jaw.placement(skin - self.neutral_skin)
        for number, row, placement in ((UPPER, self.upper, np.eye(3, 4)), (LOWER, self.lower, jaw)):
            placements[number] = placement
            moved = row @ placement[:, :3].T + placement[:, 3]
            placements[number, 2, 3] -= teeth_retreat(moved, lips)
        soft.append(self._mouth(skin))
        return placements, np.concatenate(soft)

    def retreat(self, skin: np.ndarray, side: int) -> float:
        """Return the distance by which an eyeball moves back for its lids, mm, as eyes do in a blink."""
        arm = skin[self.lid_skin[side]] - self.eye_centres[side]
        reach = self.eye_radii[side] * (1 + CORNEA) + CLEARANCE
        inside = reach**2 - (arm[:, :2] ** 2).sum(axis=1)
        needed = np.sqrt(np.maximum(inside, 0.0)) - arm[:, 2]
        return float(np.max(needed[(inside > 0) & (arm[:, 2] > 0)], initial=0.0))

    def _mouth(self, skin: np.ndarray) -> np.ndarray:
        rim, rest = skin[self.mouth_loop], self.neutral_skin[self.mouth_loop]
        moved, middle, rings = rim - rest, rest.mean(axis=0), []
        smoothed = smooth_ring(moved)
        for depth, spread, follow, _ in _MOUTH:
            ring = rest + np.stack([np.zeros(len(rest)), spread * self.mouth_height, np.full(len(rest), -depth)], axis=1)
            ring[:, 0] = middle[0] + (rest[:, 0] - middle[0]) * (1 - 0.35 * (depth / _MOUTH[-1][0]) ** 2)
            rings.append(ring + follow * (moved if depth < 2 else smoothed))
        return np.concatenate([*rings, rings[-1].mean(axis=0, keepdims=True)])


def placed(rest: np.ndarray, part: np.ndarray, placements: np.ndarray, soft: np.ndarray) -> np.ndarray:
    """Place the parts of :class:`Insides` by the result of :meth:`Insides.motion`, and return their vertices (P, 3) mm."""
    out = np.empty_like(rest)
    for number, placement in enumerate(placements):
        rows = part == number
        out[rows] = rest[rows] @ placement[:, :3].T + placement[:, 3]
    out[part == SOFT] = soft
    return out


def moved(motion: tuple[np.ndarray, np.ndarray], rotation: np.ndarray, shift: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Turn the result of :meth:`Insides.motion` with a head that is rotated by (3, 3) and then shifted by (3,) mm."""
    placements, soft = rotation @ motion[0], motion[1] @ rotation.T + shift
    placements[:, :, 3] += shift
    return placements, soft


def teeth_retreat(row: np.ndarray, lips: np.ndarray) -> float:
    """Return the distance by which teeth (n, 3) move back for lips (m, 3) that roll in over them, mm."""
    before = row[row[:, 2] > lips[:, 2].min() - CLEARANCE]
    apart = [before[:, None, axis] - lips[None, :, axis] for axis in range(3)]
    covered = apart[0] ** 2 + apart[1] ** 2 < LIP_WIDTH**2
    return float(np.max(apart[2][covered] + CLEARANCE, initial=0.0))


@dataclass(frozen=True)
class Jaw:
    """The lower jaw as a hinge.

    ``chin`` (n,) are vertex numbers, ``hinge`` (3,) is a point in mm, and ``solve`` (3, 3n) maps the displacements of the chin
    to the motion of the jaw.
    """

    chin: np.ndarray
    hinge: np.ndarray
    solve: np.ndarray

    def placement(self, displacement: np.ndarray) -> np.ndarray:
        """Find the motion (3, 4) of the jaw (opening, sideways turn, forward shift) if the skin is displaced by (N, 3) mm."""
        opened, turned, forward = self.solve @ displacement[self.chin].ravel()
        rotation = rotation_vector_matrix(np.array([opened, turned, 0.0]))
        return np.column_stack([rotation, self.hinge - rotation @ self.hinge + [0.0, 0.0, forward]])


def gaze_rotation(yaw: float, pitch: float) -> np.ndarray:
    """Make the (3, 3) rotation of an eyeball in the head frame by yaw to the subject's left (+x) and pitch upwards, rad."""
    return rotation_vector_matrix(np.array([0.0, yaw, 0.0])) @ rotation_vector_matrix(np.array([-pitch, 0.0, 0.0]))


def make_insides(neutral: np.ndarray, triangles: np.ndarray, iris: tuple[int, int, int] = IRIS) -> Insides | None:
    """Fit the parts to a neutral head.

    Parameters
    ----------
    neutral : (N, 3) array
        Vertices of the neutral head in the head frame, mm.
    triangles : (T, 3) array
        The triangles of its mesh.
    iris : tuple of int
        Colour of the irises, RGB in 0..255.

    Returns
    -------
    Insides or None
        None if the mesh is not the embedded model's.
    """
    model = embedded_face_model()
    if not np.array_equal(triangles, model.triangles) or model.eye_mean is None:
        return None
    marks = surface_points(neutral, model.feature_triangles, model.feature_weights)
    left, right, mouth = _openings()
    lids = (left, right)
    centres, radii = _eyes(model, model.eye_mean, neutral, lids)
    near = (_near(neutral, left), _near(neutral, right))
    upper, lower, triangles_of_row, colours_of_row, tongue = _mouth_parts(marks)
    # The model's open mouth separates the upper lip from the lower one. Lips at rest touch, and a fitted head's may cross.
    height = rim_height((model.mean + model.expressions[model.expression_names.index("jawOpen")])[mouth]) * _MOUTH_HEIGHT
    ball, ball_triangles, ball_colours = eyeball_mesh(iris)
    flesh = np.array([[206, 148, 138], [150, 92, 88]], float)
    pieces, colours = [], []
    for loop in lids:
        pieces += [ball_triangles, strip(2, len(loop), closed=True)]
        colours += [ball_colours, np.repeat(flesh, len(loop), axis=0)]
    pieces += [triangles_of_row, triangles_of_row[:, ::-1], tongue[1], _closed(len(_MOUTH), len(mouth))]
    light = np.append(np.repeat([ring[3] for ring in _MOUTH], len(mouth)), 0.25)
    colours += [colours_of_row, colours_of_row, tongue[2], light[:, None] * np.array(CAVITY, float)]
    # A strip and its ball are separate pieces, each with its own vertices.
    starts = np.cumsum([0, *map(len, colours)])
    return Insides(
        np.concatenate([start + t for start, t in zip(starts, pieces, strict=False)]).astype(np.int32),
        np.concatenate(colours).round().astype(np.uint8),
        centres,
        radii,
        neutral,
        lids,
        near,
        mouth,
        height,
        ball,
        upper,
        np.concatenate([lower, tongue[0]]),
        _jaw(model, neutral),
    )


def _eyes(model: FaceModel, eyes: np.ndarray, neutral: np.ndarray, lids) -> tuple[np.ndarray, np.ndarray]:
    """Scale and move the model's mean ``eyes`` (E, 3) so that they lie behind the lids, and fit spheres to them.

    Returns their centres (2, 3) and radii (2,), mm.

    The eyeballs are translated, not rotated. A rotation fitted to the small rim of the lids follows the slope of the lids.
    It would move the centre, 15 mm behind the lids, up by several millimetres on some real heads, and the eyes would look up.
    """
    centres, radii = [], []
    for side, loop in zip((1, -1), lids, strict=True):
        centre, ball_radius = sphere_of(eyes[eyes[:, 0] * side > 0])
        source, target = model.mean[loop], neutral[loop]
        ratio = np.linalg.norm(target - target.mean(0)) / np.linalg.norm(source - source.mean(0))
        size = float(np.clip(ratio, 0.85, 1.15))
        placed = target.mean(axis=0) + size * (centre - source.mean(axis=0))
        placed[1] = _iris_height(target, placed[0])
        radius = ball_radius * (size / (1 + CORNEA))
        reach = np.linalg.norm(target - placed, axis=1).min() - CLEARANCE  # of the cornea before it meets a lid
        placed[2] -= max(radius * (1 + CORNEA) - reach, 0.0)
        centres.append(placed)
        radii.append(radius)
    return np.array(centres), np.array(radii)


def _near(neutral: np.ndarray, loop: np.ndarray) -> np.ndarray:
    """Find the vertices of the skin within 30 mm of the middle of an eye's rim."""
    return np.flatnonzero(np.linalg.norm(neutral - neutral[loop].mean(axis=0), axis=1) < 30.0)


def _iris_height(rim: np.ndarray, x: float) -> float:
    """Find the height of an iris that looks ahead at ``x`` between lids (n, 3), mm. The upper lid covers more of it."""
    near = rim[np.abs(rim[:, 0] - x) < IRIS_RADIUS]
    middle = 0.5 * (near[:, 1].max() + near[:, 1].min())
    return float(middle + IRIS_RISE)


def sphere_of(points: np.ndarray) -> tuple[np.ndarray, float]:
    """Fit a sphere to points (n, 3) by least squares, and return its centre (3,) and radius."""
    system = np.column_stack([2 * points, np.ones(len(points))])
    solution = np.linalg.lstsq(system, (points**2).sum(axis=1), rcond=None)[0]
    return solution[:3], float(np.sqrt(solution[3] + solution[:3] @ solution[:3]))


def _mouth_parts(marks: np.ndarray):
    """Place the rows of teeth and the tongue by the lips' landmarks.

    Returns the upper row (n, 3), the lower row (n, 3), their triangles and colours, and the tongue.
    """
    place = {int(number): marks[k] for k, number in enumerate(FEATURE_IDS)}
    size = float(np.linalg.norm(place[60] - place[64])) / 45.0
    line = 0.5 * (place[62] + place[66])
    front = min(place[62][2], place[66][2]) - 5.3 * size
    row, triangles, colours = teeth_mesh(26.0 * size, 40.0 * size, 9.0 * size)
    # Lips at rest cover both rows. A neutral scan leaves a slit between the lips even when the person keeps them closed.
    slit = 0.5 * max(place[62][1] - place[66][1], 0.0)
    upper = row + [line[0], line[1] + min(slit + 0.3 * size, 1.5 * size), front]
    lower = row * [0.95, -0.9, 1.0] + [line[0], line[1] - slit - 1.0 * size, front - 3.0 * size]
    tongue, tongue_triangles, tongue_colours = tongue_mesh(17.0 * size, 45.0 * size)
    tongue = tongue + [line[0], line[1] - 7.0 * size, front - 8.0 * size]
    return upper, lower, triangles, colours, (tongue, tongue_triangles, tongue_colours)


@lru_cache(maxsize=1)
def _openings() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Find the rims of the left eye, the right eye and the mouth in the embedded model's mesh, as vertices in order."""
    model = embedded_face_model()
    marks = surface_points(model.mean, model.feature_triangles, model.feature_weights)
    loops = boundary_loops(model.triangles, len(model.mean))
    ids = np.asarray(FEATURE_IDS)
    wanted = [marks[(ids >= a) & (ids <= b)].mean(axis=0) for a, b in ((42, 47), (36, 41), (60, 67))]
    left, right, mouth = (min(loops, key=lambda r: float(np.linalg.norm(model.mean[r].mean(axis=0) - w))) for w in wanted)
    return left, right, mouth


def _jaw(model: FaceModel, neutral: np.ndarray) -> Jaw:
    """Find the hinge of the model's jaw-open unit, and move it with the chin of this head."""
    unit = model.expressions[model.expression_names.index("jawOpen")]
    chord, middle = unit[:, 1:], model.mean[:, 1:] + 0.5 * unit[:, 1:]
    length = np.linalg.norm(chord, axis=1)
    moving = length > 0.5 * length.max()
    hinge = np.append(0.0, np.linalg.lstsq(chord[moving], (chord[moving] * middle[moving]).sum(axis=1), rcond=None)[0])
    chin = np.flatnonzero(length > 0.9 * length.max())
    hinge = hinge + (neutral[chin] - model.mean[chin]).mean(axis=0)
    arm = neutral[chin] - hinge
    columns = [np.cross(axis, arm).ravel() for axis in np.eye(3)[:2]] + [np.tile([0.0, 0.0, 1.0], len(chin))]
    return Jaw(chin, hinge, np.linalg.pinv(np.stack(columns, axis=1)))


def _closed(rings: int, count: int) -> np.ndarray:
    """Make triangles between rings of ``count`` vertices each. One more vertex closes the last ring."""
    k = np.arange(count)
    end = np.stack([(rings - 1) * count + k, np.full(count, rings * count), (rings - 1) * count + (k + 1) % count], axis=1)
    return np.concatenate([strip(rings, count, closed=True), end])
