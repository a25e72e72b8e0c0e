"""Show deformation transfer for notebook 02: correspondence, one triangle, the matrix, and what is not transferred."""

from __future__ import annotations

import numpy as np
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from scipy.linalg import polar
from scipy.sparse.csgraph import reverse_cuthill_mckee

from ..report.pictures import Portraits
from ..studies.expression_transfer import ExpressionTransfer, System
from .charts import COLOURS
from .figures import INK, inked, picture


class TransferStudy(ExpressionTransfer):
    """Pictures of the average head's expressions on their way to an actor's head."""

    @inked()
    def show_correspondence(self, name: str, triangle: int):
        """Draw both heads in an expression, coloured by how far each triangle turns, with one triangle marked."""
        figure = Figure(figsize=(8.4, 3.3), layout="constrained")
        axes = figure.subplots(1, 4)
        angle = self._at_vertices(self.turned(name))
        angle[self.model.triangles[triangle]] = np.nan  # the marked triangle is grey
        personal = self.actor.neutral + self.actor.blendshapes[self.names.index(name)]
        average = self.model.mean + self.shape(name)
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
        """Means (V,) of values (T,) over the triangles around each vertex."""
        corners = self.model.triangles.ravel()
        total = np.bincount(corners, np.repeat(values, 3), len(self.model.mean))
        return total / np.maximum(np.bincount(corners, minlength=len(total)), 1)

    @inked()
    def show_triangle(self, name: str, triangle: int):
        """Draw one triangle before and after on both heads, in its neutral's plane, and the transferred matrix S."""
        model, corners = self.model, self.model.triangles[triangle]
        s = self.change(name)[triangle]
        source, target = model.mean[corners], self.actor.neutral[corners]
        solved = target + self.actor.blendshapes[self.names.index(name)][corners]
        figure = Figure(figsize=(8.4, 3.0), layout="constrained")
        left, middle, right = figure.subplots(1, 3)
        for points, colour, label in ((source, INK, "neutral"), (source + self.shape(name)[corners], COLOURS[0], name)):
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
        """Draw where the matrix has entries, with the vertices in two orders, and where its factor has entries."""
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
            axis.set_facecolor("white")  # the palest colours mean the fewest entries
            axis.set_title(f"{title}\n{matrix.nnz} entries", fontsize=9)
            axis.tick_params(labelsize=7)
        return picture(figure, "entries of the transfer's matrix, in two orders, and of its factor")


def _plane(corners: np.ndarray) -> np.ndarray:
    """(3, 2) two orthogonal directions in a triangle's plane, the first one along its first edge."""
    return np.linalg.qr((corners[1:] - corners[0]).T)[0] * [-1, -1]


def _outline(axis, corners: np.ndarray, plane: np.ndarray, colour: str, label: str, style: str = "-") -> None:
    """Draw a triangle (3, 3) in ``plane``, with its first corner at the origin, because S has no translation."""
    closed = (np.vstack([corners, corners[:1]]) - corners[0]) @ plane
    axis.plot(closed[:, 0], closed[:, 1], style, color=colour, label=label, lw=1.6)


def _density(matrix, bins: int = 160) -> np.ndarray:
    """(bins, bins) share of entries in each block of a sparse matrix: at least 1e-4 if there is one, NaN if there is none."""
    rows, columns = matrix.nonzero()
    count, _, _ = np.histogram2d(rows, columns, bins, [(0, matrix.shape[0]), (0, matrix.shape[1])])
    share = count * bins**2 / np.prod(matrix.shape, dtype=float)
    return np.where(count > 0, np.maximum(share, 1e-4), np.nan)


def _pixel(portraits: Portraits, point: np.ndarray) -> np.ndarray:
    """(2,) place of a head's point (3,) in a portrait, px."""
    pose = portraits._pose(0.0)
    camera = portraits.camera
    return camera.project((pose[:3, :3] @ point + pose[:3, 3])[None])[0] * portraits.size[0] / camera.width
