"""Track a performance with every pair of values of two parameters, and measure each run."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Iterator
from typing import Any, Protocol

import numpy as np

from ..batch import completed, dask_client
from ..parameters import Parameters
from .measures import Measures
from .session import Session


class Table(Protocol):
    """Can be filled by a sweep while it runs."""

    def set(self, row: int, column: int, value: float) -> None:
        """Show one value."""


def repeat_error(session: Session, parameters: Parameters) -> float:
    """Mean error of v4, mm, over the second half of the performance (the repeat, where there is one)."""
    measures, half = Measures(session), len(session.frames) // 2
    runs = zip(session.tracked(parameters), session.frames, strict=True)
    errors = [measures.mean_error(result, frame) for number, (result, frame) in enumerate(runs) if number >= half]
    return float(np.nanmean(errors))


def sweep(
    session: Session,
    rows: dict[str, Iterable],
    columns: dict[str, Iterable],
    chart: Table | None = None,
    parameters: Parameters | None = None,
    measure: Callable[[Session, Parameters], float] = repeat_error,
    client: Any = None,
) -> np.ndarray:
    """Measure a performance with every pair of values of two parameters; a progress bar is shown.

    Parameters
    ----------
    session : Session
        The performance.
    rows, columns : dict
        One parameter each, with its values: ``{"adaptive_pca.K": (0, 3, 10)}``.
    chart : Table, optional
        Is filled while the sweep runs, such as :class:`~adaptiveface.views.charts.GridChart`.
    parameters : Parameters, optional
        All other parameters; our defaults without.
    measure : callable
        ``measure(session, parameters)`` -> one number.
    client : dask.distributed.Client, optional
        Computes the cells in parallel (:func:`cluster`). Without it, they are computed one by one.

    Returns
    -------
    (R, C)
        The measured numbers.
    """
    from tqdm.auto import tqdm

    (row_name, row_values), (column_name, column_values) = *rows.items(), *columns.items()
    row_values, column_values, base = list(row_values), list(column_values), parameters or Parameters()
    out = np.full((len(row_values), len(column_values)), np.nan)
    cells = list(itertools.product(range(len(row_values)), range(len(column_values))))
    settings = [base.replace(**{row_name: row_values[r], column_name: column_values[c]}) for r, c in cells]
    _ = session.actor  # the actor is captured once, before it is sent anywhere
    for (r, c), value in tqdm(_computed(session, cells, settings, measure, client), total=len(cells), desc="sweep", unit="run"):
        out[r, c] = value
        if chart is not None:
            chart.set(r, c, value)
    return out


def _computed(session, cells, settings, measure, client) -> Iterator[tuple[tuple[int, int], float]]:
    """Yield cells and their values as they are done; the first error ends the sweep."""
    items = list(zip(cells, settings, strict=True))
    for (cell, _), value in completed(_measured, items, client, processes=0, shared=(measure, session)):
        if isinstance(value, Exception):
            raise value
        yield cell, value


def _measured(measure, session, item):
    return measure(session, item[1])


#: Makes a Dask client for :func:`sweep`, as for ``adaptiveface batch``.
cluster = dask_client
