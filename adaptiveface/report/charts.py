"""Draw the report's charts as inline SVG.

Lines have the colours of Okabe & Ito (2008) and heat maps use cividis; both are safe for colour-blind readers.
"""

from __future__ import annotations

import io
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import matplotlib
import numpy as np
from matplotlib.figure import Figure

from ..bench.paper import PAPER_MS
from ..evaluation.coefficients import INITIAL, RESOLVED, KnownCoefficients
from ..parameters.tracking import BlendshapeParameters
from ..result import Result
from ..retargeting.smoothing import COMPARED, step_response
from ..tracking.held_out import BAD
from ..tracking.types import SampleState
from .context import Spans
from .page import INK, inline_svg

if TYPE_CHECKING:
    from markupsafe import Markup

BLUE, ORANGE, GREEN, VERMILLION, SKY, PURPLE, GREY = (
    "#0072b2",
    "#e69f00",
    "#009e73",
    "#d55e00",
    "#56b4e9",
    "#cc79a7",
    "#8a94a3",
)
STATE_COLOURS = {
    SampleState.UNTRACKED: (GREY, "not tracked"),
    SampleState.IN_ANCHOR_SPACE: (SKY, "in the anchor space"),
    SampleState.LEARNED: (GREEN, "learned"),
    SampleState.OUTLIER: (VERMILLION, "outlier"),
    SampleState.HIDDEN: (ORANGE, "face hidden"),
}

_STYLE: dict[Any, Any] = {
    "svg.fonttype": "none",
    "svg.hashsalt": "report",
    "font.family": "sans-serif",
    "font.size": 10,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": INK,
    "axes.labelcolor": INK,
    "axes.grid": True,
    "grid.color": GREY,
    "grid.alpha": 0.25,
    "grid.linewidth": 0.6,
    "axes.axisbelow": True,
    "xtick.color": INK,
    "ytick.color": INK,
    "text.color": INK,
    "legend.frameon": False,
    "axes.facecolor": "none",
    "axes.linewidth": 0.7,
    "lines.linewidth": 1.3,
    "legend.fontsize": 9,
    "axes.titlesize": 10,
    "axes.titlelocation": "left",
    "image.composite_image": False,
}


def _figure(height: float, rows: int = 1, ratios: Sequence[float] | None = None, width: float = 9.6):
    figure = Figure(figsize=(width, height), layout="constrained", facecolor="none")
    axes = figure.subplots(rows, 1, sharex=rows > 1, squeeze=False, height_ratios=ratios or [1] * rows)[:, 0]
    return figure, axes


def _svg(figure: Figure, name: str) -> Markup:
    stream = io.StringIO()
    figure.savefig(stream, format="svg", metadata={"Date": None}, facecolor="none")
    return inline_svg(stream.getvalue(), name)


def _mark_spans(axis, spans: Spans) -> None:
    for start, end, name in spans:
        if start > axis.get_xlim()[0]:
            axis.axvline(start, color=GREY, linewidth=0.8, linestyle=(0, (4, 3)))
        axis.text(
            (start + end) / 2,
            1.01,
            name,
            transform=axis.get_xaxis_transform(),
            ha="center",
            va="bottom",
            fontsize=9,
            color=GREY,
        )


def _over_time(axis, times: np.ndarray, label: str, columns: int, spans: Spans) -> None:
    """Set limits, labels, a legend of ``columns`` columns and marked spans on an axis over the whole take."""
    axis.set_xlim(times[0], times[-1] + 1e-6)
    axis.set_ylabel(label)
    axis.set_xlabel("time, s")
    axis.legend(loc="upper left", ncols=columns)
    _mark_spans(axis, spans)


def _break_at_gaps(values: np.ndarray, tracked: np.ndarray) -> np.ndarray:
    return np.where(tracked, values, np.nan)


def _top(values, default: float = 1.0) -> float:
    """Return the upper end of an axis. It is the 99.8th percentile of the values plus a margin."""
    finite = np.asarray(values)[np.isfinite(values)]
    return float(np.percentile(finite, 99.8)) * 1.15 + 1e-6 if finite.size else default


def stage_timings(result: Result) -> Markup:
    """Times per stage, ms: the median as a bar, the 95th percentile as a whisker, the paper's figure as a diamond."""
    with matplotlib.rc_context(_STYLE):
        names = result.stage_names
        # A lost frame may have stopped before a stage began. Its time is then unknown, not zero.
        times = np.where(result.tracked[:, None] | (result.stage_ms > 0), result.stage_ms, np.nan)
        keep = [k for k in range(len(names)) if np.isfinite(times[:, k]).any()]
        median = np.array([np.nanmedian(times[:, k]) for k in keep])
        p95 = np.array([np.nanpercentile(times[:, k], 95) for k in keep])
        figure, (axis,) = _figure(0.34 * len(keep) + 1.0)
        y = np.arange(len(keep))
        axis.barh(y, median, height=0.55, color=BLUE, label="median")
        axis.hlines(y, median, p95, color=ORANGE, linewidth=2, label="to the 95th percentile")
        paper = [(row, PAPER_MS[names[k]]) for row, k in enumerate(keep) if names[k] in PAPER_MS]
        if paper:
            rows, values = zip(*paper, strict=True)
            axis.plot(values, rows, "D", color=VERMILLION, markersize=5, label="paper (4 cores, 2012)")
        axis.set_yticks(y, [names[k].replace("_", " ") for k in keep])
        axis.set_ylim(len(keep) - 0.5, -0.6)
        axis.set_xlim(left=0)
        axis.set_xlabel("ms per frame")
        axis.grid(axis="y", visible=False)
        axis.legend(loc="lower right")
        return _svg(figure, "timings")


def coefficients(result: Result, limits: BlendshapeParameters, spans: Spans = ()) -> Markup:
    """Draw all coefficients over time as one heat map. Its colours cover the range of the bounds."""
    with matplotlib.rc_context(_STYLE):
        count = result.coefficients.shape[1]
        figure, (axis,) = _figure(0.17 * count + 1.1)
        values = np.where(result.tracked[:, None], result.coefficients, np.nan).T
        t = result.timestamps
        step = (t[-1] - t[0]) / max(len(t) - 1, 1) or 1 / 30
        picture = axis.imshow(
            values,
            aspect="auto",
            cmap="cividis",
            vmin=limits.lower,
            vmax=limits.upper,
            interpolation="nearest",
            extent=(t[0] - step / 2, t[-1] + step / 2, count - 0.5, -0.5),
        )
        axis.set_yticks(range(count), result.expression_names, fontsize=7.5)
        axis.set_xlabel("time, s")
        axis.grid(visible=False)
        bar = figure.colorbar(picture, ax=axis, fraction=0.025, pad=0.01, aspect=35)
        bar.outline.set_visible(False)
        bar.set_label("coefficient", fontsize=9)
        _mark_spans(axis, spans)
        return _svg(figure, "coefficients")


def adaptation(result: Result, spans: Spans = ()) -> Markup:
    """Draw Figure 11: the distance of v2 from the anchor and adaptive spaces.

    Distances are means in mm. They are measured before the frame's update.
    """
    with matplotlib.rc_context(_STYLE):
        figure, (axis,) = _figure(2.9)
        t = result.timestamps
        anchor = _break_at_gaps(result.anchor_distance, result.tracked)
        adaptive = _break_at_gaps(result.adaptive_distance, result.tracked)
        axis.plot(t, anchor, color=GREEN, label="to the anchor space (initial blendshapes)")
        axis.plot(t, adaptive, color=BLUE, label="to the adaptive space (with the learned correctives)")
        axis.set_ylim(0, _top(np.concatenate([anchor, adaptive])) * 1.2)
        _over_time(axis, t, "distance of v2, mm", 2, spans)
        return _svg(figure, "adaptation")


def held_out(result: Result, spans: Spans = ()) -> Markup:
    """Draw the error of the held-out landmarks over time for each region, in % of the distance between the eyes."""
    assert result.held_out is not None  # the section is written only then
    with matplotlib.rc_context(_STYLE):
        figure, (axis,) = _figure(2.9)
        t, seen = result.timestamps, result.tracked & np.any(result.held_out > 0, axis=1)
        colours = (BLUE, ORANGE, GREEN, VERMILLION, SKY, PURPLE, GREY, "#333333", "#a05a2c")
        for number, region in enumerate(result.held_out_regions):
            errors = _break_at_gaps(result.held_out[:, number], seen)
            axis.plot(t, errors, color=colours[number % len(colours)], linewidth=1, label=region)
        axis.axhline(BAD, color=GREY, linewidth=0.8, linestyle="--")
        axis.set_ylim(0, max(_top(result.held_out[seen]), BAD) * 1.35)
        _over_time(axis, t, "% of the eyes' distance", 5, spans)
        return _svg(figure, "held_out")


def learning(result: Result, spans: Spans = ()) -> Markup:
    """Draw the state of each frame as a training sample, and the number of PCA updates so far."""
    with matplotlib.rc_context(_STYLE):
        figure, (states, updates) = _figure(2.9, rows=2, ratios=(1, 2.4))
        t, state = result.timestamps, np.asarray(result.sample_state)
        width = max(650 / len(t), 0.4)  # in points, so that the strip has no gaps
        for value, (colour, name) in STATE_COLOURS.items():
            times = t[state == value]
            label = f"{name} ({len(times)})"
            states.eventplot([times], lineoffsets=0, linelengths=1, linewidths=width, colors=[colour], label=label)
        states.set_yticks([])
        states.set_ylim(-0.5, 0.5)
        states.grid(visible=False)
        states.spines["left"].set_visible(False)
        states.legend(loc="lower left", bbox_to_anchor=(0, 1.12), ncols=5, borderaxespad=0, handlelength=1.2)
        updates.step(t, result.corrective_updates, where="post", color=PURPLE)
        updates.set_ylabel("PCA updates so far")
        updates.set_xlabel("time, s")
        updates.set_ylim(bottom=0)
        updates.set_xlim(t[0], t[-1] + 1e-6)
        for start, *_ in spans[1:]:
            updates.axvline(start, color=GREY, linewidth=0.8, linestyle=(0, (4, 3)))
        return _svg(figure, "learning")


def errors(evaluation, timestamps: np.ndarray, spans: Spans = ()) -> Markup:
    """Surface and motion error of the first and the last stage over time, mm. ``timestamps`` (F,) s are of scored frames."""
    with matplotlib.rc_context(_STYLE):
        figure, (surface, motion) = _figure(4.6, rows=2)
        stages = [(evaluation.stages[-1], BLUE)]
        if len(evaluation.stages) > 1:
            stages.insert(0, (evaluation.stages[0], ORANGE))
        tops: tuple[list[float], list[float]] = [], []
        for stage, colour in stages:
            p95 = np.percentile(evaluation.surface[evaluation.stages.index(stage)], 95, axis=1)
            mean = evaluation.motion_length(stage).mean(axis=1)
            surface.plot(timestamps, p95, color=colour, label=f"{stage}, 95th percentile")
            motion.plot(timestamps, mean, color=colour, label=f"{stage}, mean")
            tops[0].append(_top(p95))
            tops[1].append(_top(mean))
        moved = evaluation.motion.mean(axis=1)
        motion.plot(timestamps, moved, color=GREY, linewidth=0.9, label="true motion, mean (a face that never moves)")
        surface.set_ylabel("from the true surface, mm")
        motion.set_ylabel("error of motion, mm")
        surface.set_ylim(0, max(tops[0]) * 1.15)
        motion.set_ylim(0, max(*tops[1], _top(moved)) * 1.15)
        motion.set_xlabel("time, s")
        motion.set_xlim(timestamps[0], timestamps[-1] + 1e-6)
        for axis in (surface, motion):
            axis.legend(loc="upper left", ncols=3)
        _mark_spans(surface, spans)
        return _svg(figure, "errors")


def coefficient_errors(known: KnownCoefficients) -> Markup:
    """Draw the root mean square error of every expression's coefficient. Initial and re-solved values are side by side."""
    with matplotlib.rc_context(_STYLE):
        initial, resolved = (known.rms_by_expression(name) for name in (INITIAL, RESOLVED))
        order = np.argsort(-initial)
        figure, (axis,) = _figure(3.4)
        x = np.arange(len(order))
        axis.bar(x - 0.2, initial[order], width=0.38, color=ORANGE, label=f"initial ({known.rms(INITIAL):.3f} over all)")
        label = f"re-solved ({known.rms(RESOLVED):.3f} over all)"
        axis.bar(x + 0.2, resolved[order], width=0.38, color=BLUE, label=label)
        axis.set_xticks(x, [known.names[k] for k in order], rotation=40, ha="right", rotation_mode="anchor", fontsize=8)
        axis.set_xlim(-0.7, len(order) - 0.3)
        axis.set_ylabel("rms error of the coefficient")
        axis.grid(axis="x", visible=False)
        axis.legend(loc="upper right")
        return _svg(figure, "coefficient-errors")


def known_curves(known: KnownCoefficients, count: int = 4) -> Markup:
    """Draw true, initial and re-solved coefficients over time for the ``count`` expressions that move most."""
    with matplotlib.rc_context(_STYLE):
        chosen = sorted(np.argsort(-known.truth.std(axis=0))[:count])
        figure, axes = _figure(1.15 * len(chosen) + 0.6, rows=len(chosen))
        for axis, k in zip(axes, chosen, strict=True):
            axis.plot(known.timestamps, known.truth[:, k], color=GREY, linewidth=3.2, alpha=0.6, label="truth")
            axis.plot(known.timestamps, known.found[INITIAL][:, k], color=ORANGE, label=INITIAL)
            axis.plot(known.timestamps, known.found[RESOLVED][:, k], color=BLUE, label=RESOLVED)
            axis.set_title(known.names[k], fontsize=9)
            axis.set_ylim(-0.05, 1.1)
        axes[0].legend(loc="lower right", bbox_to_anchor=(1, 1.0), ncols=3)
        axes[-1].set_xlabel("time, s")
        axes[-1].set_xlim(known.timestamps[0], known.timestamps[-1] + 1e-6)
        return _svg(figure, "known-curves")


def step_responses(fps: float) -> Markup:
    """Draw the response of every smoothing to a step, at ``fps`` frames per second."""
    with matplotlib.rc_context(_STYLE):
        figure, (axis,) = _figure(2.7)
        for (name, smoothing), colour in zip(COMPARED.items(), (BLUE, SKY, ORANGE, VERMILLION), strict=True):
            times, step, out = step_response(smoothing.apply, fps)
            axis.plot(1e3 * times, out, color=colour, label=name, marker="o", markersize=2.5)
        axis.step(1e3 * times, step, where="mid", color=GREY, linewidth=1, linestyle=(0, (4, 3)), label="the step")
        axis.set_xlim(-150, 900)
        axis.set_ylim(-0.08, 1.3)
        axis.set_xlabel("time after the step, ms")
        axis.set_ylabel("coefficient")
        axis.legend(loc="lower right")
        return _svg(figure, "steps")
