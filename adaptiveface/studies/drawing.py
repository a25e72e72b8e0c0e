"""Draw portraits on a grid, coloured in millimetres, and plain charts, without Matplotlib's global state."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from ..model.actor import Actor
from ..report.pictures import SKIN, Portraits, on_backdrop

BACKDROP = (235, 236, 238)
SIZE = (230, 280)


class Faces:
    """Draws heads (N, 3) in the head frame as pictures. The colour scale ends at ``top`` mm."""

    def __init__(self, actor: Actor, top: float, size: tuple[int, int] = SIZE) -> None:
        self.top = top
        self._portraits = Portraits(actor, size)

    def plain(self, head: np.ndarray) -> np.ndarray:
        """Draw a head in the colour of skin, (h, w, 3) uint8."""
        return on_backdrop(self._portraits.draw(head), BACKDROP)

    def heat(self, head: np.ndarray, values: np.ndarray) -> np.ndarray:
        """Draw a head coloured by ``values`` (N,) mm, (h, w, 3) uint8. NaN is grey."""
        return on_backdrop(self._portraits.draw(head, values, (0.0, self.top)), BACKDROP)


def grid(
    pictures: Sequence[Sequence[np.ndarray | None]],
    titles: Sequence[Sequence[str]],
    labels: Sequence[str],
    top: float | None = None,
    words: str = "",
) -> Figure:
    """Make a figure with one picture per cell.

    Parameters
    ----------
    pictures : sequence of sequences of (h, w, 3) arrays or None
        The cells of every row.
    titles : sequence of sequences of str
        Text above every picture.
    labels : sequence of str
        Text before every row.
    top : float, optional
        End of a colour scale from 0 beside the grid, mm. Without it, there is no scale.
    words : str
        Meaning of the scale.
    """
    rows, columns = len(pictures), max(map(len, pictures))
    high, wide = next(picture for line in pictures for picture in line if picture is not None).shape[:2]
    lines = 1 + max((title.count("\n") for above in titles for title in above), default=0)
    size = 1.75 * columns + 0.6, (1.65 * high / wide + 0.15 * lines + 0.15) * rows + 0.2
    figure = Figure(figsize=size, layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False)
    for line, above, label, row in zip(pictures, titles, labels, axes, strict=True):
        for axis in row:
            axis.set(xticks=[], yticks=[], frame_on=False)
        for axis, picture, title in zip(row, line, above, strict=False):
            if picture is not None:
                axis.imshow(picture)
            axis.set_title(title, fontsize=8)
        row[0].set_ylabel(label, fontsize=10)
    if top is not None:
        _add_scale(figure, top, words)
    return figure


def _add_scale(figure: Figure, top: float, words: str) -> None:
    scale = ScalarMappable(Normalize(0.0, top), "viridis")
    bar = figure.colorbar(scale, ax=figure.axes, shrink=0.7, fraction=0.03, pad=0.01)
    bar.set_label(words, fontsize=9)
    bar.ax.tick_params(labelsize=8)


def scan_picture(actor: Actor, points: np.ndarray, normals: np.ndarray, size: tuple[int, int] = SIZE) -> np.ndarray:
    """Draw a scan (P, 3) with normals (P, 3) in the head frame from the front, as wide as the face, (h, w, 3) uint8."""
    wide, high = size
    face = actor.neutral[actor.frontal]
    centre, scale = (face.min(axis=0) + face.max(axis=0)) / 2, wide / (1.25 * np.ptp(face[:, 0]))
    light = np.array([-0.3, 0.4, 0.87])
    shade = np.clip(0.35 + 0.65 * normals @ light, 0.15, 1.0)[:, None] * SKIN
    picture = np.full((high, wide, 3), BACKDROP, np.uint8)
    order = np.argsort(points[:, 2])  # the nearest last
    for step in np.ndindex(3, 3):
        u = np.round((points[order, 0] - centre[0]) * scale + wide / 2).astype(int) + step[0] - 1
        v = np.round((centre[1] - points[order, 1]) * scale + high / 2).astype(int) + step[1] - 1
        inside = (u >= 0) & (u < wide) & (v >= 0) & (v < high)
        picture[v[inside], u[inside]] = shade[order][inside]
    return picture
