"""A performer: an actor drawn from the face model plus what lies in no basis that the tracker knows.

Seeds 0 to 99 are for development and tuning; report results on seeds of 1000 and above only.

The skin is a Loop-subdivided surface. The vertices of the tracking mesh lie on it (they are its first V vertices), so
that vertex i of the truth is vertex i of a tracked mesh, exactly on what the sensor sees.
"""

from __future__ import annotations

import numpy as np

from ..geometry.mesh import boundary_loops, surface_points, vertex_normals
from ..model.face_model import FaceModel, embedded_face_model
from .contacts import Contact, EyeballContact, make_contact, make_eyeball_contact, rings, sides
from .folds import make_folds
from .personal import identity_detail, make_interactions, make_jaw_hinge, path_bends, personal_units
from .subdivision import loop_subdivision

#: Thickness of a lid over the eyeball, mm.
LID_THICKNESS = 0.9


class Performer:
    """A person who performs for the synthetic sensor. The same seed and model give the same person.

    With ``detail=0, variation=0, folds=False``, only the smoother surface, the arc of the jaw and the contacts are outside
    the model's span.

    Parameters
    ----------
    seed : int
        Seed of the person.
    model : FaceModel, optional
        The face model from which the person is drawn.
    detail : float
        Root mean square of the identity detail outside the modes, mm.
    variation : float
        Scale of the personal differences in the expression units.
    folds : bool
        Whether the face has folds.

    Attributes
    ----------
    model : FaceModel
    seed : int
    identity : (M,) array
    expression_names : (E,) tuple of str
    neutral : (V, 3) array
        The neutral face in the head frame, mm.
    triangles : (T, 3) array
    surface_triangles : (U, 3) array
        Triangles of the dense surface.
    eye_centres : (2, 3) array
        Centres of the eyeballs, mm. The subject's left eye comes first.
    eye_radii : (2,) array
        Radii of the eyeballs, mm, in the same order.
    """

    def __init__(
        self,
        seed: int,
        model: FaceModel | None = None,
        *,
        detail: float = 1.1,
        variation: float = 1.0,
        folds: bool = True,
    ) -> None:
        self.model = embedded_face_model() if model is None else model
        self.seed = seed
        rng = np.random.default_rng([seed, 0xFACE])
        n = len(self.model.mean)
        self.expression_names = self.model.expression_names
        self.triangles = self.model.triangles
        self.identity = np.clip(rng.normal(0, 0.9, len(self.model.identity_modes)), -2.2, 2.2)
        self._draw_skin(rng, detail, variation)
        self._subdivision, self.surface_triangles = loop_subdivision(self.triangles, n)
        self._make_contacts()
        self._close_lids()
        self._folds = []
        dense = self.surface(np.zeros(len(self.expression_names)))
        self.neutral = dense[:n]
        landmarks = surface_points(self.neutral, self.model.feature_triangles, self.model.feature_weights)
        normals = vertex_normals(dense, self.surface_triangles)
        if folds:
            self._folds = make_folds(rng, dense, normals, landmarks, self.expression_names)

    def _draw_skin(self, rng: np.random.Generator, detail: float, variation: float) -> None:
        model, names = self.model, self.expression_names
        plain = model.neutral(self.identity)
        # Detail is a field over space: skin and eyeballs move together.
        eyes = model.eyes(self.identity)
        points = plain if eyes is None else np.concatenate([plain, eyes])
        points = points + (identity_detail(rng, points, detail) if detail > 0 else 0.0)
        self._control = points[: len(plain)]
        self._place_eyes(None if eyes is None else model.eye_mean, points[len(plain) :])
        self._units = personal_units(rng, plain, model.expressions, names, variation)
        self._bends = path_bends(rng, plain, self._units, 0.06 * variation)
        self._interactions = make_interactions(rng, plain, self._units, names, 1.4 * variation)
        jaw = names.index("jawOpen") if "jawOpen" in names else None
        self._jaw_unit, self._jaw = jaw, None if jaw is None else make_jaw_hinge(self._control, self._units[jaw])

    def _place_eyes(self, mean: np.ndarray | None, eyes: np.ndarray) -> None:
        """Fit a sphere to each eye of ``eyes`` (E, 3), whose sides are known from ``mean`` (E, 3); None: no eyes."""
        centres, radii = [], []
        if mean is not None:
            for side in (1, -1):
                ball = eyes[mean[:, 0] * side > 0]
                system = np.column_stack([2 * ball, np.ones(len(ball))])
                solution = np.linalg.lstsq(system, (ball**2).sum(axis=1), rcond=None)[0]
                centres.append(solution[:3])
                radii.append(np.sqrt(solution[3] + solution[:3] @ solution[:3]))
        self.eye_centres, self.eye_radii = np.array(centres).reshape(-1, 3), np.array(radii)

    def _make_contacts(self) -> None:
        """Lids against each other and the eyeballs; three rings of lip skin against each other."""
        rest, n = self._control, len(self._control)
        marks = surface_points(rest, self.model.feature_triangles, self.model.feature_weights)
        self._balls: list[EyeballContact] = [
            make_eyeball_contact(rest, centre, radius, LID_THICKNESS)
            for centre, radius in zip(self.eye_centres, self.eye_radii, strict=True)
        ]
        loops = boundary_loops(self.triangles, n)
        self._lids: dict[str, Contact] = {}
        self.lid_loops: list[np.ndarray] = []
        self._lips: list[Contact] = []
        for name, eye in (("Left", marks[14:20]), ("Right", marks[8:14])):
            loop = _nearest_loop(loops, rest, eye.mean(axis=0), 15.0)
            if loop is not None:
                self.lid_loops.append(loop)
                near = np.flatnonzero(np.linalg.norm(rest - eye.mean(axis=0), axis=1) < 35.0)
                self._lids[name] = make_contact(rest, sides(rest, self.triangles, loop), loop, near, 3.5, 0.85)
        self.mouth_loop = _nearest_loop(loops, rest, marks[32:].mean(axis=0), 20.0)
        if self.mouth_loop is not None:
            near = np.flatnonzero(np.linalg.norm(rest - marks[20:].mean(axis=0), axis=1) < 45.0)
            side = sides(rest, self.triangles, self.mouth_loop)
            for ring in rings(self.mouth_loop, self.triangles, n, 4):
                self._lips.append(make_contact(rest, side, ring, near, 4.0, 0.5))

    def _close_lids(self) -> None:
        """Make a full blink close the eye. The personal unit adds the motion that the generic unit lacks on this head."""
        for side, contact in self._lids.items():
            name = f"eyeBlink{side}"
            if name not in self.expression_names:
                continue
            e = self.expression_names.index(name)
            for _ in range(3):
                closed = self._control + self._units[e]
                contact.push(closed, -np.maximum(contact.gap(closed) + 0.2, 0.0))
                self._units[e] = closed - self._control

    def _deform(self, activations: np.ndarray) -> np.ndarray:
        """Return the (V, 3) control points of the skin before subdivision, mm."""
        active = np.flatnonzero(activations)
        a = activations[active]
        points = self._control + np.tensordot(a, self._units[active], axes=1)
        points += np.tensordot(4 * a * (1 - a), self._bends[active], axes=1)
        points += self._interactions.displacement(activations)
        if self._jaw is not None and activations[self._jaw_unit] != 0:
            points[:, 1:] += self._jaw.displacement(float(activations[self._jaw_unit]))
        for ball in self._balls:
            ball.resolve(points)
        for contact in (*self._lids.values(), *self._lips):
            contact.resolve(points)
        return points

    def surface(self, activations: np.ndarray) -> np.ndarray:
        """Return the (D, 3) dense skin in the head frame for activations (E,), mm.

        Its first V vertices are those of :meth:`shape`.
        """
        activations = np.asarray(activations, float)
        dense = self._subdivision @ self._deform(activations)
        for fold in self._folds:
            strength = fold.strength(activations)
            if strength > 0:
                dense[fold.vertices] += strength * fold.vectors
        return dense

    def shape(self, activations: np.ndarray) -> np.ndarray:
        """Return the (V, 3) true vertices of the tracking mesh in the head frame for activations (E,), mm."""
        return self.surface(activations)[: len(self.neutral)]


def _nearest_loop(loops: list[np.ndarray], points: np.ndarray, target: np.ndarray, limit: float) -> np.ndarray | None:
    """The boundary loop whose middle lies nearest to the target, within ``limit`` mm; None where there is none."""
    distances = [np.linalg.norm(points[loop].mean(axis=0) - target) for loop in loops]
    if not distances or min(distances) > limit:
        return None
    return loops[int(np.argmin(distances))]
