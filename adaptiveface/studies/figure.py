"""Draw a figure of the paper, describe it, and save the picture and its numbers as PNG, SVG and CSV."""

from __future__ import annotations

import csv
import importlib
import os
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import matplotlib

from ..errors import ParameterError
from ..files import replacing
from ..runtime.threads import one_thread

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from matplotlib.typing import RcKeyType

#: Number in the paper -> the module that draws the figure, and its subject.
FIGURES = {
    3: ("construction", "from a neutral scan to personal blendshapes"),
    4: ("pipeline", "one frame, stage by stage"),
    5: ("influence", "the influence of each stage"),
    6: ("out_of_space", "the two deformations out of the adaptive space"),
    7: ("correctives", "the adaptive model while it learns"),
    8: ("transfer", "coefficients drive other faces"),
    9: ("emotions", "six emotions, beside a tracker that does not adapt"),
    10: ("people", "more people, beside a tracker that does not adapt"),
    11: ("convergence", "the distance from the anchor space and from the adaptive space"),
}
_STYLE: dict[RcKeyType, object] = {"svg.hashsalt": "adaptiveface", "svg.fonttype": "none", "image.composite_image": False}


@dataclass(frozen=True)
class PaperFigure:
    """One drawn figure.

    Attributes
    ----------
    number : int
        Of the figure in the paper.
    title : str
        Its subject.
    caption : str
        What it shows, and how it differs from the paper's figure.
    figure : matplotlib.figure.Figure
        The drawing.
    rows : list of dict
        The numbers: one dict per row of the table, all with the same keys.
    """

    number: int
    title: str
    caption: str
    figure: Figure
    rows: list[dict]

    def save(self, folder: str | os.PathLike, dpi: int = 120) -> list[Path]:
        """Write ``figure_N.png``, ``.svg`` and ``.csv`` to ``folder``, which is made if needed, and return their paths."""
        folder = Path(folder)
        folder.mkdir(parents=True, exist_ok=True)
        paths = [folder / f"figure_{self.number}.{kind}" for kind in ("png", "svg", "csv")]
        with matplotlib.rc_context(_STYLE):
            for path in paths[:2]:
                with replacing(path) as temporary:
                    metadata = {"Date": None} if path.suffix == ".svg" else {}
                    self.figure.savefig(temporary, dpi=dpi, facecolor="white", metadata=metadata)
        with replacing(paths[2]) as temporary, open(temporary, "w", newline="", encoding="utf-8") as stream:
            writer = csv.DictWriter(stream, list(self.rows[0]))
            writer.writeheader()
            writer.writerows(self.rows)
        return paths


def paper_figure(number: int, seed: int = 1000, noise: str = "structured-light", frames: int | None = None) -> PaperFigure:
    """Draw figure ``number`` of the paper.

    Parameters
    ----------
    number : int
        One of ``FIGURES``.
    seed : int
        Of the synthetic performer. Performers from 1000 on were not used to develop the tracker.
    noise : str
        Of the depth sensor, as in :class:`~adaptiveface.synthetic.sensor.SyntheticSensor`.
    frames : int, optional
        Number of frames of one performance; by default the number that the figure needs. Fewer frames are faster.

    Returns
    -------
    PaperFigure
        The drawing, its caption and its numbers.

    Raises
    ------
    ParameterError
        There is no such figure, or the performer's values make no sense.
    """
    if number not in FIGURES:
        raise ParameterError(f"figure {number}: one of {', '.join(map(str, FIGURES))} is expected")
    module, title = FIGURES[number]
    with one_thread():
        caption, figure, rows = importlib.import_module(f".{module}", __package__).draw(seed, noise, frames)
    return PaperFigure(number, title, caption, figure, rows)
