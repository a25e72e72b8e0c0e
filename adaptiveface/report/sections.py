"""The sections of the report, each one function from data to HTML."""

from __future__ import annotations

from collections import Counter
from html import escape

import numpy as np

from .. import __version__
from ..evaluation import FIRST, PERFORMANCE_NAMES, REPEAT, Evaluation
from ..parameters import Parameters, describe
from ..result import COLOUR_ONLY
from ..tracking.held_out import describe as describe_fit
from ..tracking.types import SampleState
from . import charts, page, pictures
from .context import Context
from .scenes import legend

#: Upper end of the map of mean errors, mm.
MEAN_ERROR_LIMIT = 2.0
#: A corrective shape is drawn with this largest displacement, mm.
CORRECTIVE_SIZE = 5.0


def heading(name: str, colour_only: bool = False) -> str:
    """Title, and what this is."""
    if colour_only:
        return (
            f"<h1>{escape(name)}</h1><p><b>{COLOUR_ONLY}.</b> A facial performance tracked from a colour video by its 2D "
            "features alone: the head's size and distance are assumed, what lies between the features is guessed from "
            "the generic expressions, and nothing was learned.</p>"
        )
    return (
        f'<h1>{escape(name)}</h1><p class="soft">A facial performance tracked with one depth camera: no training, the '
        "correctives learned on the fly (Li, Yu, Ye, Bregler 2013).</p>"
    )


def doubt(context: Context) -> str:
    """What has to be said first: that much of the face was not tracked, and the likely reason."""
    text = context.result.doubt
    return f"<p><b>{escape(text[0].upper() + text[1:])}.</b></p>" if text else ""


def tiles(context: Context) -> str:
    """The figures one looks for first."""
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
    cells = "".join(f'<div class="tile"><b>{escape(b)}</b><span>{escape(s)}</span></div>' for b, s in entries)
    return f'<div class="tiles">{cells}</div>'


def losses(context: Context) -> str:
    """How many frames were skipped or lost, and why."""
    result = context.result
    if result.tracked.all():
        return "<p>No frame was skipped or lost.</p>"
    reasons = Counter(reason or "not tracked" for reason, kept in zip(result.reasons, result.tracked, strict=True) if not kept)
    text = "; ".join(f"{count} × {escape(reason)}" for reason, count in reasons.most_common(6))
    return f"<p><b>{(~result.tracked).sum()} of {len(result)} frames were skipped or lost:</b> {text}.</p>"


def coefficients(context: Context) -> str:
    """The animation curves, re-solved from the final mesh."""
    chart = charts.coefficients(context.result, context.parameters.blendshapes, context.spans)
    return (
        "<h2>Animation</h2><p>The blendshape coefficients, solved once more from the final mesh (section 6): what a "
        f'retargeted character receives.</p><div class="chart">{chart}</div>'
    )


def fit(context: Context) -> str:
    """How far landmarks that no fit used are from where the face puts them; nothing where none were detected."""
    result = context.result
    if result.held_out is None or not (text := describe_fit(result.held_out[result.tracked], result.held_out_regions)):
        return ""
    return (
        "<h2>Does the face fit?</h2><p>Some of the detector's landmarks are left out of every fit. They show how far the "
        f"tracked face is from the one in the picture: shape, pose and expression together. {escape(text)}.</p>"
        f'<div class="chart">{charts.held_out(result, context.spans)}</div>'
    )


def learning(context: Context, correctives: np.ndarray | None) -> str:
    """Figure 11, the sample states, and the corrective shapes as faces."""
    result = context.result
    parts = [
        "<h2>Learning on the fly</h2><p>Each frame whose Laplacian deformation leaves the space of the blendshapes "
        "becomes a training sample for the corrective shapes (section 5). The chart shows how far the deformed mesh v2 is "
        "from the blendshapes' space, and from the adaptive space before the frame is learned from (the paper's figure "
        "11): with a new expression both rise, and the second drops within a few frames. Of a face that is hidden, or of "
        "which too little has depth, nothing is learned.</p>"
    ]
    if not result.colour_only:
        parts.append(f'<div class="chart">{charts.adaptation(result, context.spans)}</div>')
    parts.append(f'<div class="chart">{charts.learning(result, context.spans)}</div>')
    if correctives is not None and len(correctives):
        parts.append(_corrective_faces(context.actor, correctives))
    return "".join(parts)


def _corrective_faces(actor, correctives: np.ndarray) -> str:
    portraits = pictures.Portraits(actor, (130, 168))
    cells = []
    for number, shape in enumerate(correctives, start=1):
        size = np.linalg.norm(shape, axis=1)
        scale = CORRECTIVE_SIZE / max(float(size.max()), 1e-12)
        pixels = portraits.draw(actor.neutral + scale * shape, scale * size, (0, CORRECTIVE_SIZE))
        cells.append(page.figure(page.image(pixels, f"corrective {number}", 130), f"corrective {number}"))
    return (
        '<h3>The corrective shapes at the end</h3><p class="soft">Added to the neutral, each scaled so that its '
        f"largest displacement is {CORRECTIVE_SIZE:g} mm.</p>"
        f"{legend('0 mm', f'{CORRECTIVE_SIZE:g} mm', 'displacement')}"
        f'<div class="strip wide">{"".join(cells)}</div>'
    )


def errors(context: Context, note: str = "") -> str:
    """Errors against the ground truth: a table per stage and performance, curves, and where on the face they are."""
    evaluation = context.evaluation
    if evaluation is None:
        return ""
    chart, faces = charts.errors(evaluation, context.scored_times, context.spans), _error_faces(context, evaluation)
    return (
        "<h2>Errors against the truth</h2><p>In mm, but for the active share. Surface: distance to the true surface, "
        "over the frontal vertices that may take depth. The rest: error of every vertex's motion, with the constant "
        "error of the neutral removed and the error of the head pose kept; regions as means over all frames, normal "
        "and tangential parts over vertices that truly moved by more than 2 mm, the active share likewise. "
        f'{escape(note)}</p>{_error_table(evaluation)}<div class="chart">{chart}</div>{faces}'
    )


def _error_table(evaluation) -> str:
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
    return page.table(header, rows, strong)


def _error_faces(context: Context, evaluation: Evaluation) -> str:
    portraits = pictures.Portraits(context.actor, (200, 258))
    last = REPEAT if evaluation.frames(REPEAT).any() else None
    faces = ""
    for stage in dict.fromkeys((evaluation.stages[0], evaluation.stages[-1])):
        mean = evaluation.mean_error_map(stage, last)
        pixels = portraits.draw(context.actor.neutral, mean, (0, MEAN_ERROR_LIMIT))
        faces += page.figure(page.image(pixels, f"mean error of {stage}"), f"mean error of {stage}")
    scale = legend("0 mm", f"{MEAN_ERROR_LIMIT:g} mm and more", "mean error of motion")
    return f'{scale}<div class="pair">{faces}</div>'


def timings(context: Context) -> str:
    """Time per stage beside the paper's figures."""
    return (
        "<h2>Time per stage</h2><p>Measured while this run was tracked, beside the paper's own figures (section 7; its "
        "9 ms for the fit in adaptive space are split into the Laplacian deformation and the projection).</p>"
        f'<div class="chart">{charts.stage_timings(context.result)}</div>'
    )


def parameters(context: Context) -> str:
    """Every parameter of the run, those that differ from the default marked."""
    run: Parameters = context.parameters
    rows = []
    for entry in describe():
        value = getattr(getattr(run, entry["stage"]), entry["name"])
        text = f"{value:g}" if isinstance(value, float) else str(value)
        cell = page.Changed(text) if value != entry["default"] else text
        paper = "" if entry["paper"] is None else str(entry["paper"])
        rows.append([f"{entry['stage']}.{entry['name']}", cell, entry["unit"], paper, entry["section"], entry["doc"]])
    changed = sum(isinstance(row[1], page.Changed) for row in rows)
    table = page.table(("parameter", "value", "unit", "paper", "section", "meaning"), rows, kind="text")
    return (
        f"<h2>Parameters</h2><details><summary>All {len(rows)} parameters of this run, {changed} changed from the "
        f"default</summary>{table}</details>"
    )


def footer() -> str:
    """Which program wrote this."""
    return f"<footer>Written by adaptiveface {__version__}.</footer>"
