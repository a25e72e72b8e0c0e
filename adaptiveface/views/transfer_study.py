"""Show deformation transfer for notebook 02: correspondence, one triangle, the matrix, and what is not transferred."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from scipy.linalg import polar
from scipy.sparse.csgraph import reverse_cuthill_mckee
from scipy.sparse.linalg import splu

from ..geometry.mesh import surface_points, triangle_normals
from ..model.actor import Actor
from ..model.blendshapes import STILL, deformation_gradients, gradient_operator
from ..model.face_model import FaceModel, embedded_face_model
from ..report.pictures import Portraits
from .charts import COLOURS
from .figures import INK, inked, picture

#: Numbers of the features on the middle of the upper and lower lid of each eye.
LIDS = {"eyeBlinkRight": ((9, 13), (10, 12)), "eyeBlinkLeft": ((15, 19), (16, 18))}


@dataclass(frozen=True)
class System:
    """``matrix`` (n, n): G^T A G over the n vertices that move; ``order`` (n,): the solver's; ``factor`` (n, n) of it.

    ``factorising`` and ``substituting``: seconds for the factor and for every expression's x, y and z.
    """

    matrix: sp.csr_matrix
    order: np.ndarray
    factor: sp.csc_matrix
    factorising: float
    substituting: float


class TransferStudy:
    """The average head's expressions on their way to an actor's head.

    Parameters
    ----------
    actor : the head that the expressions are carried to, with the model's triangles.
    model : whose expressions they are; the embedded one by default.
    """

    def __init__(self, actor: Actor, model: FaceModel | None = None) -> None:
        self.actor, self.model = actor, model or embedded_face_model()
        self.names = list(self.model.generic_names)

    def change(self, name: str) -> np.ndarray:
        """(T, 3, 3) deformation gradients S of the average head's triangles in an expression."""
        model = self.model
        return deformation_gradients(model.mean, model.mean + self._shape(name), model.triangles)

    def turned(self, name: str) -> np.ndarray:
        """(T,) angle of every triangle's rotation in an expression, degrees."""
        rotation = np.linalg.svd(self.change(name))
        trace = np.trace(rotation[0] @ rotation[2], axis1=1, axis2=2)
        return np.degrees(np.arccos(np.clip((trace - 1) / 2, -1, 1)))

    def telling_triangle(self, name: str) -> int:
        """Number of the triangle that changes most among the larger ones of the face that look to the front."""
        triangles = self.model.triangles
        normal = triangle_normals(self.model.mean, triangles)
        size = np.linalg.norm(normal, axis=1)
        frontal = self.actor.frontal[triangles].all(axis=1)
        shown = frontal & (normal[:, 2] > 0.7 * size) & (size > np.median(size[frontal]))
        change = np.linalg.norm(self.change(name) - np.eye(3), axis=(1, 2))
        return int(np.where(shown, change, -1.0).argmax())

    def system(self) -> System:
        """The matrix of the transfer to this head, its fill-reducing order and its factor; without blendshapes.py's anchor."""
        shapes = self.model.generic_expressions
        moving = np.flatnonzero(np.linalg.norm(shapes, axis=2).max(axis=0) > STILL)
        touched = self.model.triangles[np.isin(self.model.triangles, moving).any(axis=1)]
        gradient, area = gradient_operator(self.actor.neutral, touched)
        matrix = (gradient.T @ sp.diags(np.repeat(area, 3)) @ gradient)[moving][:, moving].tocsc()
        start = time.perf_counter()
        solver = splu(matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
        middle = time.perf_counter()
        solver.solve(np.ones((len(moving), 3 * len(shapes))))
        order = np.argsort(solver.perm_c)
        return System(matrix.tocsr(), order, solver.L, middle - start, time.perf_counter() - middle)

    def gap(self, name: str, transferred: bool = True) -> tuple[float, float]:
        """mm between the lids in a blink: of the average head, and of this one.

        ``transferred`` False: with the average head's displacements copied vertex by vertex.
        """
        shape = self.actor.blendshapes[self.names.index(name)] if transferred else self._shape(name)
        heads = self.model.mean + self._shape(name), self.actor.neutral + shape
        at = self.model.feature_triangles, self.model.feature_weights
        points = [surface_points(head, *at) for head in heads]
        return tuple(float(np.mean([np.linalg.norm(p[a] - p[b]) for a, b in LIDS[name]])) for p in points)

    def _shape(self, name: str) -> np.ndarray:
        return self.model.generic_expressions[self.names.index(name)]

    # ---- pictures ---------------------------------------------------------------------------------------------------
    @inked()
    def show_correspondence(self, name: str, triangle: int):
        """Both heads in an expression, coloured by how far each triangle turns; one triangle marked on both."""
        figure = Figure(figsize=(8.4, 3.3), layout="constrained")
        axes = figure.subplots(1, 4)
        angle = self._at_vertices(self.turned(name))
        angle[self.model.triangles[triangle]] = np.nan  # grey: the marked one
        personal = self.actor.neutral + self.actor.blendshapes[self.names.index(name)]
        average = self.model.mean + self._shape(name)
        titles = ("average head", f"{name}, average", "this head", f"{name}, this head")
        for axis, head, title in zip(axes, (self.model.mean, average, self.actor.neutral, personal), titles, strict=True):
            portraits = Portraits(self.actor, (300, 380), whole=False)
            axis.imshow(portraits.draw(head, angle, (0, 20)))
            spot = head[self.model.triangles[triangle]].mean(axis=0)
            pixel = _pixel(portraits, spot)
            axis.plot(*pixel, "o", ms=9, mfc="none", mec="#D55E00", mew=1.6)
            axis.set_title(title, fontsize=9)
            axis.axis("off")
        return picture(figure, f"triangle {triangle} on the average head and on this one; colour: how far triangles turn")

    def _at_vertices(self, values: np.ndarray) -> np.ndarray:
        """(V,) means over the triangles around each vertex, of values (T,)."""
        corners = self.model.triangles.ravel()
        total = np.bincount(corners, np.repeat(values, 3), len(self.model.mean))
        return total / np.maximum(np.bincount(corners, minlength=len(total)), 1)

    @inked()
    def show_triangle(self, name: str, triangle: int):
        """One triangle before and after, on both heads, each in its neutral's plane; and the matrix S that is handed over."""
        model, corners = self.model, self.model.triangles[triangle]
        s = self.change(name)[triangle]
        source, target = model.mean[corners], self.actor.neutral[corners]
        solved = target + self.actor.blendshapes[self.names.index(name)][corners]
        figure = Figure(figsize=(8.4, 3.0), layout="constrained")
        left, middle, right = figure.subplots(1, 3)
        for points, colour, label in ((source, INK, "neutral"), (source + self._shape(name)[corners], COLOURS[0], name)):
            _outline(left, points, _plane(source), colour, label)
        _outline(middle, target, _plane(target), INK, "neutral")
        _outline(middle, target @ s.T, _plane(target), COLOURS[1], "asked for", "--")
        _outline(middle, solved, _plane(target), COLOURS[0], "solved for")
        left.set_title("average head", fontsize=9)
        middle.set_title("this head", fontsize=9)
        for axis in (left, middle):
            low, high = (f([f(line.get_xydata(), axis=0) for line in axis.lines], axis=0) for f in (np.min, np.max))
            half = 0.7 * max(high - low)
            (x0, y0), (x1, y1) = (low + high) / 2 - half, (low + high) / 2 + half
            axis.set(aspect="equal", xlabel="mm", xlim=(x0, x1), ylim=(y0, y1 + 0.6 * half))
            axis.legend(fontsize=7, loc="upper left")
        turn, stretch = polar(s)
        angle = np.degrees(np.arccos(np.clip((np.trace(turn) - 1) / 2, -1, 1)))
        right.imshow(s, cmap="RdBu_r", vmin=-1.5, vmax=1.5)
        for (row, column), value in np.ndenumerate(s):
            right.text(column, row, f"{value:+.2f}", ha="center", va="center", fontsize=9, color="black")
        lengths = ", ".join(f"{value:.2f}" for value in np.linalg.eigvalsh(stretch))
        right.set_title(f"S: a turn by {angle:.0f}°,\nstretches {lengths}", fontsize=9)
        right.set(xticks=[], yticks=[])
        return picture(figure, f"triangle {triangle} in {name}: neutral and expression on both heads, and its matrix S")

    @inked()
    def show_matrix(self, system: System):
        """Where the matrix has entries: as the vertices are numbered, in the solver's order, and its factor."""
        figure = Figure(figsize=(8.4, 3.1), layout="constrained")
        band = reverse_cuthill_mckee(system.matrix, symmetric_mode=True)
        banded = system.matrix[band][:, band]
        shown = (
            (system.matrix, "as the vertices are numbered"),
            (banded, "neighbours numbered together"),
            (system.factor, "factor L, in the solver's order"),
        )
        for axis, (matrix, title) in zip(figure.subplots(1, 3), shown, strict=True):
            axis.imshow(
                _density(matrix), cmap="Blues", norm=LogNorm(1e-4, 1.0), extent=(0, matrix.shape[1], matrix.shape[0], 0)
            )
            axis.set_facecolor("white")  # the palest of these colours mean the fewest entries
            axis.set_title(f"{title}\n{matrix.nnz} entries", fontsize=9)
            axis.tick_params(labelsize=7)
        return picture(figure, "entries of the transfer's matrix, in two orders, and of its factor")


def _plane(corners: np.ndarray) -> np.ndarray:
    """(3, 2) two directions at right angles in a triangle's plane, the first along its first edge."""
    return np.linalg.qr((corners[1:] - corners[0]).T)[0] * [-1, -1]


def _outline(axis, corners: np.ndarray, plane: np.ndarray, colour: str, label: str, style: str = "-") -> None:
    """A triangle (3, 3) seen at right angles to ``plane``, its first corner at the origin: S knows no translation."""
    closed = (np.vstack([corners, corners[:1]]) - corners[0]) @ plane
    axis.plot(closed[:, 0], closed[:, 1], style, color=colour, label=label, lw=1.6)


def _density(matrix, bins: int = 160) -> np.ndarray:
    """(bins, bins) share of entries in each block of a sparse matrix, at least 1e-4 where there is one; NaN where none."""
    rows, columns = matrix.nonzero()
    count, _, _ = np.histogram2d(rows, columns, bins, [(0, matrix.shape[0]), (0, matrix.shape[1])])
    share = count * bins**2 / np.prod(matrix.shape, dtype=float)
    return np.where(count > 0, np.maximum(share, 1e-4), np.nan)


def _pixel(portraits: Portraits, point: np.ndarray) -> np.ndarray:
    """(2,) px of a point (3,) of the head in a portrait."""
    pose = portraits._pose(0.0)
    camera = portraits.camera
    return camera.project((pose[:3, :3] @ point + pose[:3, 3])[None])[0] * portraits.size[0] / camera.width
