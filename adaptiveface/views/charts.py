"""Charts that are updated in place, fast enough to grow while a performance plays.

A full Matplotlib drawing takes at least 50 ms. Here the axes and labels are drawn once, and an update only draws the lines
over a copy of them. Charts are transparent, so that they suit light and dark pages.
"""

from __future__ import annotations

from collections.abc import Sequence

import ipywidgets as widgets
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from .figures import INK, inked, pixels
from .pictures import encode, image_widget

#: The colours of Okabe & Ito, which people with any colour vision can tell apart.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", INK)

#: Narrow spacing between the entries of a legend.
LEGEND_TIGHT = {"columnspacing": 1.0, "handletextpad": 0.3, "borderpad": 0.2}
#: Widths in a legend, pixels: of a line with the space around it, and of a letter.
LEGEND_HANDLE, LEGEND_LETTER = 42, 6

#: Values of a line: an array over 0, 1, 2, ..., or a pair (x, y).
Series = np.ndarray | tuple[np.ndarray, np.ndarray]

_BAR = np.array([0x00, 0x72, 0xB2, 0xFF], np.uint8)  # the first of them


class LiveChart:
    """Lines over frame numbers, or over any x, with fixed axes and a cursor. Display its ``widget``.

    Parameters
    ----------
    names : sequence of str
        Of the lines.
    x, y : (float, float)
        Ends of the axes.
    xlabel, ylabel, title : str
        Their labels, and the title of the chart.
    size : (int, int)
        Width and height, pixels.
    log : bool
        Whether the y axis is logarithmic.
    styles : dict, optional
        Matplotlib's ``Line2D`` properties of the lines that do not have the default look, by name.
    """

    @inked()
    def __init__(
        self,
        names: Sequence[str],
        x: tuple[float, float],
        y: tuple[float, float],
        xlabel: str,
        ylabel: str,
        title: str = "",
        size: tuple[int, int] = (380, 220),
        log: bool = False,
        styles: dict[str, dict] | None = None,
    ) -> None:
        figure = Figure(figsize=(size[0] / 100, size[1] / 100), dpi=100, layout="constrained")
        self._canvas, self._axis = FigureCanvasAgg(figure), figure.add_subplot()
        axis = self._axis
        axis.set(xlim=(x[0], max(x[1], x[0] + 1)), ylim=y, xlabel=xlabel, ylabel=ylabel, yscale="log" if log else "linear")
        axis.set_title(title, fontsize=9)
        axis.tick_params(labelsize=8)
        axis.xaxis.label.set_fontsize(9)
        axis.yaxis.label.set_fontsize(9)
        axis.grid(alpha=0.3)
        self._lines = {}
        for name, colour in zip(names, COLOURS, strict=False):
            style = {"color": colour, "lw": 1.6} | (styles or {}).get(name, {})
            (line,) = axis.plot([], [], label=name, animated=True, **style)
            self._lines[name] = line
        self._cursor = axis.axvline(np.nan, color=INK, lw=1, animated=True)
        if len(self._lines) > 1:  # below the axes, where it hides no line
            handles = [_copy(line, name) for name, line in self._lines.items()]
            room = max(1, int(size[0] / (LEGEND_HANDLE + LEGEND_LETTER * max(map(len, self._lines)))))
            figure.legend(
                handles=handles, fontsize=8, loc="outside lower center", ncols=min(room, len(handles)), **LEGEND_TIGHT
            )
        self._canvas.draw()
        self._background = self._canvas.copy_from_bbox(figure.bbox)
        self._image = self._picture(size)
        self.widget = widgets.VBox([self._image])
        self.update()

    def _picture(self, size: tuple[int, int]) -> widgets.DOMWidget:
        """The widget that holds the PNG as its ``value``."""
        return image_widget(*size, format="png", name="adaptiveface-chart")

    def update(self, cursor: float = np.nan, /, **series: Series) -> None:
        """Draw other lines.

        Parameters
        ----------
        cursor : float
            Place of the vertical line; NaN hides it.
        **series
            For each name an array over 0, 1, 2, ..., or a pair (x, y). NaN leaves a gap.
        """
        for name, values in series.items():
            x, y = values if isinstance(values, tuple) else (np.arange(len(values)), values)
            self._lines[name].set_data(x, y)
        self._cursor.set_xdata([cursor, cursor])
        self._canvas.restore_region(self._background)
        for artist in (self._cursor, *self._lines.values()):
            self._axis.draw_artist(artist)
        self._image.value = encode(pixels(self._canvas), "png")


def _copy(line: Line2D, name: str) -> Line2D:
    """A line that looks the same, for the legend."""
    copy = Line2D([], [], label=name)
    copy.update_from(line)
    copy.set_animated(False)
    return copy


class BarChart:
    """Horizontal bars with fixed axes: one number for each name, updated in place. Display its ``widget``."""

    @inked()
    def __init__(
        self, names: Sequence[str], x: tuple[float, float], xlabel: str, title: str, size: tuple[int, int] = (330, 460)
    ) -> None:
        figure = Figure(figsize=(size[0] / 100, size[1] / 100), dpi=100, layout="constrained")
        canvas = FigureCanvasAgg(figure)
        axis, places = figure.add_subplot(), np.arange(len(names))
        axis.set(xlim=x, ylim=(len(names) - 0.5, -0.5))
        axis.set_xlabel(xlabel, fontsize=9)
        axis.set_yticks(places, names, fontsize=8)
        axis.tick_params(axis="x", labelsize=8)
        axis.set_title(title, fontsize=9)
        axis.grid(axis="x", alpha=0.3)
        canvas.draw()
        self._background = pixels(canvas).copy()

        def places_of(data: np.ndarray) -> np.ndarray:
            """Places of data (n, 2) in the picture, (n, 2) px."""
            return axis.transData.transform(data)

        (self._left, _), (self._right, _) = places_of(np.array([[x[0], 0], [x[1], 0]]))
        self._low, self._high = x
        edges = np.stack([places_of(np.column_stack([0 * places, places + side])) for side in (-0.35, 0.35)])
        self._rows = np.rint(size[1] - edges[..., 1]).astype(int).T
        self._image = image_widget(*size, format="png", name="adaptiveface-chart")
        self.widget = widgets.VBox([self._image])
        self.update(np.zeros(len(names)))

    def update(self, values: Sequence[float] | np.ndarray) -> None:
        """Draw bars of other lengths. A bar that is longer than the axis ends at its edge."""
        picture = self._background.copy()
        share = (np.nan_to_num(np.asarray(values, float)) - self._low) / (self._high - self._low)
        ends = np.rint(self._left + np.clip(share, 0, 1) * (self._right - self._left)).astype(int)
        for (top, bottom), end in zip(self._rows, ends, strict=True):
            picture[top:bottom, int(np.ceil(self._left)) : end] = _BAR
        self._image.value = encode(picture, "png")


class GridChart:
    """A table of numbers as a heat map that is filled cell by cell, for sweeps over parameters.

    Parameters
    ----------
    rows, columns : sequence
        Values of the two parameters.
    row_label, column_label, title : str
        Labels of the axes, and the title.
    limits : (float, float)
        Range of the colours. It is fixed from the start, so that a cell keeps its colour while others are filled.
    size : (int, int)
        Width and height, pixels.
    """

    def __init__(
        self,
        rows: Sequence,
        columns: Sequence,
        row_label: str,
        column_label: str,
        title: str,
        limits: tuple[float, float],
        size: tuple[int, int] = (460, 340),
    ) -> None:
        self.rows, self.columns, self.limits = list(rows), list(columns), limits
        self._labels, self._size = (row_label, column_label, title), size
        self.values = np.full((len(self.rows), len(self.columns)), np.nan)
        self._image = image_widget(*size, format="png", name="adaptiveface-chart")
        self.widget = widgets.VBox([self._image])
        self.draw()

    def set(self, row: int, column: int, value: float) -> None:
        """Fill one cell and redraw."""
        self.values[row, column] = value
        self.draw()

    @inked()
    def draw(self) -> None:
        """Draw the map as it is now."""
        figure = Figure(figsize=(self._size[0] / 100, self._size[1] / 100), dpi=100, layout="constrained")
        canvas, axis = FigureCanvasAgg(figure), figure.add_subplot()
        low, high = self.limits
        image = axis.imshow(self.values, vmin=low, vmax=high, cmap="viridis", aspect="auto")
        axis.set_xticks(range(len(self.columns)), self.columns, fontsize=8)
        axis.set_yticks(range(len(self.rows)), self.rows, fontsize=8)
        for (row, column), value in np.ndenumerate(self.values):
            if np.isfinite(value):
                dark = (value - low) / (high - low) < 0.6
                axis.text(column, row, f"{value:.3f}", ha="center", va="center", fontsize=8, color="w" if dark else "k")
        row_label, column_label, title = self._labels
        axis.set_xlabel(column_label, fontsize=9)
        axis.set_ylabel(row_label, fontsize=9)
        axis.set_title(title, fontsize=9)
        figure.colorbar(image, ax=axis).ax.tick_params(labelsize=8)
        canvas.draw()
        self._image.value = encode(pixels(canvas), "png")
