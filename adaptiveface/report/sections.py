"""Write the sections of the report. Each function passes its data to a macro of ``assets/report.html``."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING

import numpy as np

from .. import __version__
from ..evaluation import FIRST, PERFORMANCE_NAMES, REPEAT, Evaluation
from ..model.actor import Actor
from ..parameters import describe
from ..result import COLOUR_ONLY
from ..tracking.held_out import describe as describe_fit
from ..tracking.types import SampleState
from . import charts, page, pictures
from .context import Context
from .scenes import legend

if TYPE_CHECKING:
    from markupsafe import Markup

#: Upper end of the map of mean errors, mm.
MEAN_ERROR_LIMIT = 2.0
#: Largest displacement with which a corrective shape is drawn, mm.
CORRECTIVE_SIZE = 5.0


def heading(name: str, colour_only: bool = False) -> Markup:
    """Write the title and a description of the page."""
    return page.html().heading(name, colour_only, COLOUR_ONLY)


def doubt(context: Context) -> Markup:
    """Write the warning at the top if the tracked face is doubtful, with the likely reason."""
    return page.html().doubt(context.result.doubt)


def tiles(context: Context) -> Markup:
    """Write the most important figures."""
    result, evaluation = context.result, context.evaluation
    total = result.stage_ms[result.tracked].sum(axis=1) if result.tracked.any() else np.array([np.nan])
    learned = int(np.count_nonzero(np.asarray(result.sample_state) == SampleState.LEARNED))
    entries = [
        (f"{result.tracked.sum()} / {len(result)}", "frames tracked"),
        (
            f"{np.nanmedian(total):.1f} ms",
            f"per frame (median), {np.nanpercentile(total, 95):.1f} ms (95th percentile)",
        ),
        (str(learned), f"samples learned, {int(result.corrective_updates[-1])} PCA updates"),
    ]
    if evaluation is not None:
        performance = REPEAT if evaluation.frames(REPEAT).any() else None
        row = evaluation.summary(evaluation.stages[-1], performance)
        name = "on the repeat" if performance == REPEAT else "over the run"
        entries += [
            (f"{row['surface_median']:.2f} mm", f"median surface error {name}"),
            (f"{row['surface_p95']:.2f} mm", f"95th percentile {name}"),
            (f"{row['active_share']:.2f}", f"active share {name}: 1 is a face that never moves, 0 is perfect"),
        ]
    return page.html().tiles(entries)


def losses(context: Context) -> Markup:
    """Write how many frames were skipped or lost, and why."""
    result = context.result
    reasons = Counter(reason or "not tracked" for reason, kept in zip(result.reasons, result.tracked, strict=True) if not kept)
    return page.html().losses(int((~result.tracked).sum()), len(result), reasons.most_common(6))


def coefficients(context: Context) -> Markup:
    """Draw the animation curves, which are re-solved from the final mesh."""
    return page.html().coefficients(charts.coefficients(context.result, context.parameters.blendshapes, context.spans))


def fit(context: Context) -> Markup | str:
    """Write the distance of the held-out landmarks from their places on the tracked face, or "" if none were detected."""
    result = context.result
    if result.held_out is None or not (text := describe_fit(result.held_out[result.tracked], result.held_out_regions)):
        return ""
    return page.html().fit(text, charts.held_out(result, context.spans))


def learning(context: Context, correctives: np.ndarray | None) -> Markup:
    """Draw figure 11, the states of the samples, and the corrective shapes as faces."""
    result = context.result
    drawn = [charts.learning(result, context.spans)]
    if not result.colour_only:
        drawn.insert(0, charts.adaptation(result, context.spans))
    faces = "" if correctives is None or not len(correctives) else _corrective_faces(context.actor, correctives)
    return page.html().learning(drawn, faces)


def _corrective_faces(actor: Actor, correctives: np.ndarray) -> Markup:
    portraits = pictures.Portraits(actor, (130, 168))
    faces = []
    for number, shape in enumerate(correctives, start=1):
        size = np.linalg.norm(shape, axis=1)
        scale = CORRECTIVE_SIZE / max(float(size.max()), 1e-12)
        pixels = portraits.draw(actor.neutral + scale * shape, scale * size, (0, CORRECTIVE_SIZE))
        faces.append(page.figure(pixels, f"corrective {number}", 130))
    largest = f"{CORRECTIVE_SIZE:g} mm"
    return page.html().corrective_faces(largest, legend("0 mm", largest, "displacement"), faces)


def errors(context: Context, note: str = "") -> Markup | str:
    """Write the errors against the ground truth: a table by stage and performance, curves, and maps over the face."""
    evaluation = context.evaluation
    if evaluation is None:
        return ""
    return page.html().errors(
        note,
        _error_table(evaluation),
        charts.errors(evaluation, context.scored_times, context.spans),
        legend("0 mm", f"{MEAN_ERROR_LIMIT:g} mm and more", "mean error of motion"),
        _error_faces(context, evaluation),
    )


def _error_table(evaluation: Evaluation) -> Markup:
    figures = ("surface_median", "surface_p95", "active_share", *evaluation.regions, "normal", "tangential")
    header = ("performance", "stage", "surface median", "95 %", "active share", *figures[3:])
    rows, strong = [], []
    for performance in (FIRST, REPEAT):
        if not evaluation.frames(performance).any():
            continue
        for stage in evaluation.stages:
            row = evaluation.summary(stage, performance)
            rows.append([PERFORMANCE_NAMES[performance], stage, *(f"{row[name]:.2f}" for name in figures)])
        strong.append(len(rows) - 1)
    return page.html().table(header, rows, strong)


def _error_faces(context: Context, evaluation: Evaluation) -> list[Markup]:
    portraits = pictures.Portraits(context.actor, (200, 258))
    last = REPEAT if evaluation.frames(REPEAT).any() else None
    faces = []
    for stage in dict.fromkeys((evaluation.stages[0], evaluation.stages[-1])):
        pixels = portraits.draw(context.actor.neutral, evaluation.mean_error_map(stage, last), (0, MEAN_ERROR_LIMIT))
        faces.append(page.figure(pixels, f"mean error of {stage}"))
    return faces


def timings(context: Context) -> Markup:
    """Write the time of each stage beside the paper's figures."""
    return page.html().timings(charts.stage_timings(context.result))


def parameters(context: Context) -> Markup:
    """Write every parameter of the run, and mark those that differ from the default."""
    rows = []
    for entry in describe():
        value = getattr(getattr(context.parameters, entry["stage"]), entry["name"])
        text = f"{value:g}" if isinstance(value, float) else str(value)
        cell = page.Changed(text) if value != entry["default"] else text
        paper = "" if entry["paper"] is None else str(entry["paper"])
        rows.append([f"{entry['stage']}.{entry['name']}", cell, entry["unit"], paper, entry["section"], entry["doc"]])
    changed = sum(isinstance(row[1], page.Changed) for row in rows)
    table = page.html().table(("parameter", "value", "unit", "paper", "section", "meaning"), rows, kind="text")
    return page.html().parameters(len(rows), changed, table)


def footer() -> Markup:
    """Write the name and version of the program."""
    return page.html().footer(__version__)
