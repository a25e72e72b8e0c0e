"""Figure 11: how far the tracked mesh lies from the anchor space and from the adaptive space, frame by frame."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from .performances import PARAMETER_SETS, Take, track

FRAMES, TIMES = 110, 3
GREEN, BLUE, RED = "#009e73", "#0072b2", "#d55e00"


def draw(seed: int, noise: str, frames: int | None) -> tuple[str, Figure, list[dict]]:
    """Caption, drawing and numbers."""
    take = Take.performed(seed, noise, frames or FRAMES, TIMES)
    frontal, rows = take.actor.frontal, []
    for name, result, model in track(take):
        if not result.tracked:
            continue
        row: dict = {"parameters": name, "frame": result.index, "updates": model.updates}
        for stage in ("v2", "v4"):
            displacement = (getattr(result, stage) - take.actor.neutral)[frontal].ravel()
            row[f"{stage}_from_anchors_mm"], row[f"{stage}_from_adaptive_mm"] = model.parts(displacement).distances()
        rows.append(row)
    figure = Figure(figsize=(9.5, 6.4), layout="constrained")
    axes = figure.subplots(2, 1, sharex=True, sharey=True)
    for axis, name in zip(axes, PARAMETER_SETS, strict=True):
        _curves(axis, [row for row in rows if row["parameters"] == name], take.sensor)
        axis.set_title(name, loc="left", fontsize=10)
        axis.set_ylabel("mean distance, mm")
        axis.spines[["top", "right"]].set_visible(False)
    axes[1].legend(fontsize=8, ncols=2, frameon=False, loc="upper right")
    axes[1].set_xlabel("frame (the same performance again from each line on)")
    caption = (
        f"{take.sensor.name}. Distances before a frame is learned from. Thin: v4, as the paper's caption has it; it starts in "
        "the adaptive space, and lies outside only by what the 2D features add. Thick: v2, from which samples are taken. "
        "Red: where v2 moves out of the adaptive space and is learned; dotted, the first update: paper() waits for a buffer of "
        "200 samples."
    )
    return caption, figure, rows


def _curves(axis, rows: list[dict], sensor) -> None:
    """Draw the four curves of one parameter set, the beginnings of the repeats, and the peaks of new expressions."""
    frame = np.array([row["frame"] for row in rows])
    for stage, width, alpha in (("v2", 1.8, 1.0), ("v4", 0.8, 0.8)):
        for space, colour, words in (("anchors", GREEN, "anchor space"), ("adaptive", BLUE, "adaptive space")):
            distance = [row[f"{stage}_from_{space}_mm"] for row in rows]
            axis.plot(frame, distance, color=colour, linewidth=width, alpha=alpha, label=f"{stage} from the {words}")
    for time in range(TIMES):
        axis.axvline(sensor.neutral_frames + time * sensor.frames, color="0.7", linewidth=0.8, zorder=0)
    values = np.array([row["v2_from_adaptive_mm"] for row in rows])
    learned = next((row["frame"] for row in rows if row["updates"]), None)
    if learned is not None:
        drops = [k for k in falls(values) if frame[k] >= learned - 1]
        axis.plot(frame[drops], values[drops], "o", color=RED, markersize=4, label="a new expression")
        axis.axvline(learned, color=RED, linewidth=0.8, linestyle=":", label="first update")


def falls(values: np.ndarray, window: int = 6, share: float = 0.6) -> np.ndarray:
    """Indices of the local peaks of values (F,) that drop to ``share`` of their height within ``window`` frames."""
    found = []
    for k in range(1, len(values) - 1):
        before, after = values[max(k - window, 0) : k], values[k + 1 : k + 1 + window]
        stands_out = values[k] > max(before.max(), 1.2 * np.median(values)) and values[k] >= after.max()
        if stands_out and after.min() < share * values[k]:
            found.append(k)
    return np.array(found, int)
