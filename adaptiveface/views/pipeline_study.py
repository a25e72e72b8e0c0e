"""For notebooks 07 and 08: the pipeline with stages left out, side by side, and sweeps over parameters."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Sequence

import ipywidgets as widgets
import numpy as np

from ..batch import completed, dask_client
from ..evaluation.ablation import VARIANTS, Variant
from ..insides.gaze import GazeEstimator
from ..parameters import Parameters
from .charts import GridChart
from .face_view import FaceView
from .kernel import Displayed
from .measures import Measures
from .player import Player
from .replay import Replay
from .session import Session


class AblationView(Displayed):
    """The same frame by several variants of the pipeline, coloured by the error; ``widget`` is what to display."""

    def __init__(
        self,
        session: Session,
        variants: Sequence[Variant] | None = None,
        parameters: Parameters | None = None,
        frames: int | None = None,
        start: int = 0,
    ) -> None:
        self.session, self.measures = session, Measures(session)
        self.variants = list(variants or [v for v in VARIANTS if v.fit][:6])
        self.frames, parameters = session.frames[:frames], parameters or Parameters()
        runs: dict[tuple, Replay] = {}
        for variant in self.variants:
            key = tuple(variant.changes.items())
            if key not in runs:
                runs[key] = Replay(self.frames, session.actor, parameters.replace(**variant.changes))
                runs[key].run()
        self._runs = [runs[tuple(variant.changes.items())] for variant in self.variants]
        columns = min(3, len(self.variants))
        shape = (-(-len(self.variants) // columns), columns)
        names = (variant.name for variant in self.variants)
        self._titles = titles = [
            name.replace("without the adaptive space and the final deformation", "v2 as the output") for name in names
        ]
        self.view = FaceView.of(session.actor, titles, limits=(0, 2), label=self.measures.label, shape=shape, pane=(220, 250))
        self._eyes, self.note = GazeEstimator(session.actor), widgets.HTML()
        self.player = Player(len(self.frames), self.show)
        row = widgets.Layout(flex_flow="row wrap", align_items="flex-start")
        self.note.layout.max_width = "420px"
        self.widget = widgets.VBox(
            [widgets.HBox([widgets.VBox([self.view.widget, self.player.widget]), self.note], layout=row)]
        )
        self.player.go_to(start) if start else self.show(0)

    def show(self, index: int) -> None:
        """Draw frame ``index`` by every variant."""
        rows = []
        for pane, (variant, run, title) in enumerate(zip(self.variants, self._runs, self._titles, strict=True)):
            heat = self.measures.error(run.results[index], self.frames[index], variant.stage)
            gaze = self._eyes.see(run.results[index], self.frames[index])
            gaze = None if gaze is None else np.nan_to_num(gaze)  # straight ahead where unknown
            self.view.show(pane, getattr(run.results[index], variant.stage), heat, gaze=gaze)
            name = title if title == variant.name else f"{title} ({variant.name})"
            mean = f"<td style='white-space:nowrap'>{np.nanmean(heat):.3f} mm</td>"
            rows.append(f"<tr><td style='padding-right:1em'>{name}</td>{mean}</tr>")
        self.view.refresh()
        self.note.value = f"<table>{''.join(rows)}</table>"

    def close(self) -> None:
        """Stop the player; the last picture stays."""
        self.player.close()
        self.view.close()


def repeat_error(session: Session, parameters: Parameters) -> float:
    """Mean error of v4, mm, over the second half of the performance (the repeat, where there is one)."""
    measures, half = Measures(session), len(session.frames) // 2
    results = Replay(session.frames, session.actor, parameters).run()
    errors = [measures.mean_error(r, f) for r, f in zip(results[half:], session.frames[half:], strict=True)]
    return float(np.nanmean(errors))


def sweep(
    session: Session,
    rows: dict[str, Iterable],
    columns: dict[str, Iterable],
    chart: GridChart | None = None,
    parameters: Parameters | None = None,
    measure: Callable[[Session, Parameters], float] = repeat_error,
    client=None,
) -> np.ndarray:
    """``measure`` for every pair of values of two parameters: (R, C) array, with a progress bar.

    ``rows``, ``columns``: {"adaptive_pca.K": values}. ``chart`` fills while the sweep runs. ``client``:
    a ``dask.distributed.Client`` that computes the cells in parallel (:func:`cluster`), None: one by one.
    """
    from tqdm.auto import tqdm

    (row_name, row_values), (column_name, column_values) = *rows.items(), *columns.items()
    row_values, column_values, base = list(row_values), list(column_values), parameters or Parameters()
    out = np.full((len(row_values), len(column_values)), np.nan)
    cells = list(itertools.product(range(len(row_values)), range(len(column_values))))
    settings = [base.replace(**{row_name: row_values[r], column_name: column_values[c]}) for r, c in cells]
    _ = session.actor  # captured once, before it is sent anywhere
    for (r, c), value in tqdm(_computed(session, cells, settings, measure, client), total=len(cells), desc="sweep", unit="run"):
        out[r, c] = value
        if chart is not None:
            chart.set(r, c, value)
    return out


def _computed(session, cells, settings, measure, client):
    """Yield (cell, value) as they are done; the first error ends the sweep."""
    items = list(zip(cells, settings, strict=True))
    for (cell, _), value in completed(_measured, items, client, processes=0, shared=(measure, session)):
        if isinstance(value, Exception):
            raise value
        yield cell, value


def _measured(measure, session, item):
    return measure(session, item[1])


#: A Dask client for :func:`sweep`, as for ``adaptiveface batch``.
cluster = dask_client
