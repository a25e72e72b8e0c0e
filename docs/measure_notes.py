"""Measure the decisions of the paper notes on synthetic performers: one decision changed in each row.

    python docs/measure_notes.py paper      # starts from Parameters.paper(), writes docs/tables/from_paper.md
    python docs/measure_notes.py ours       # starts from our defaults, writes docs/tables/from_defaults.md

The performance is played twice with other noise and head motion; rows score the repeat against the ground truth. The notes
include what is written. A performer takes a minute of one core for each table.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from datetime import date
from pathlib import Path

import numpy as np

from adaptiveface.evaluation import bootstrap_interval
from adaptiveface.evaluation.ablation import Variant, run_ablations
from adaptiveface.evaluation.truth import REPEAT
from adaptiveface.parameters import KalmanParameters, Parameters
from adaptiveface.pipeline import capture_source, one_thread
from adaptiveface.synthetic.sensor import SyntheticSensor
from adaptiveface.tracking.kalman import CoefficientFilter

#: Seeds that nothing was tuned on.
SEEDS = tuple(range(1000, 1010))
#: A take of 80 frames never fills the paper's buffer of 200 samples: rows about a full buffer have a smaller one.
FULL_BUFFER = {"adaptive_pca.startup": "full-buffer", "adaptive_pca.S": 40}
FIGURES = ("surface_median", "surface_p95", "active_share", "normal", "tangential")

OURS = Parameters()
PAPER = Parameters.paper()


def changes(start: Parameters, end: Parameters, *names: str) -> dict:
    """What leads from one set to another, restricted to these parameters or stages; everything without names."""
    found = {key: there for key, (_, there) in start.diff(end).items()}
    chosen = {key: value for key, value in found.items() if not names or key in names or key.split(".")[0] in names}
    for name in names:
        if not any(name in (key, key.split(".")[0]) for key in chosen):
            raise ValueError(f"{name} is alike in both")
    return chosen


def ours(name: str, *names: str, **more) -> Variant:
    """A row of the first table: these parameters, or whole stages, as our defaults have them."""
    return Variant(name, changes=changes(PAPER, OURS, *names) | {key.replace("__", "."): value for key, value in more.items()})


SOFT = ("laplacian.feature_rows", "laplacian.feature_weight", "laplacian.final_feature_weight")
FROM_PAPER = (
    Variant("`Parameters.paper()`"),
    Variant("*printed, but not in `paper()`:* eq. (4) as printed", changes={"laplacian.feature_rows": "printed"}),
    Variant("eq. (7): w1, w2 on rows", changes={"laplacian.weights": "rows"}),
    Variant("eq. (7): pseudo-inverse, w1 and w2 cancel", changes={"laplacian.weights": "pseudo-inverse"}),
    Variant("the output v4 is what is aligned", changes={"rigid.shape": "output"}),
    Variant("no re-alignment where ICP and features disagree", changes={"rigid.max_reprojection_error": 100.0}),
    Variant("Kalman noises read as accelerations", changes={"kalman.model": "acceleration"}),
    ours("*ours, one at a time:* window that follows the model", "depth"),
    ours("ICP until it stands still", "rigid.stop"),
    ours("robust and cosine weights in ICP and eq. (1), stiff vertices lead", "rigid.outlier_distance", "rigid.weights",
         "rigid.half_weight_motion", "blendshapes.outlier_distance", "blendshapes.weights",
         "blendshapes.max_correspondence_distance"),
    ours("ridge, temporal penalty, stiffer in profile",
         "blendshapes.ridge", "blendshapes.temporal", "blendshapes.profile_stiffness"),
    ours("every third vertex in ICP and eq. (1)", "blendshapes.vertex_stride"),
    ours("pose solved with the coefficients", "blendshapes.joint_pose"),
    ours("depth point to plane, one conjugate-gradient step", "laplacian.depth_term", "laplacian.max_correspondence_distance"),
    ours("soft 2D features", *SOFT),
    ours("less smoothing: w2 = 1.5, 5 in the end", "laplacian.w2", "laplacian.final_w2"),
    ours("the three rows above together", "laplacian"),
    ours("learning from the first sample", "adaptive_pca.startup"),
    Variant("learning from a full buffer of 40", changes=FULL_BUFFER),
    ours("K = 12, learning from the first sample", "adaptive_pca.K", "adaptive_pca.startup"),
    ours("hidden faces are not learned", "adaptive_pca.min_coverage", "adaptive_pca.max_occluded"),
    ours("**all of ours**"),
)  # fmt: skip
FROM_OURS = (
    Variant("defaults"),
    Variant("learning off", changes={"adaptive_pca.learn": False}),
    Variant("one ICP step", changes={"rigid.iterations": 1}),
    Variant("pose not solved with the coefficients", changes={"blendshapes.joint_pose": False}),
    Variant("the same, and one ICP step", changes={"blendshapes.joint_pose": False, "rigid.iterations": 1}),
    Variant("no ridge and temporal penalty", changes={"blendshapes.ridge": 0.0, "blendshapes.temporal": 0.0}),
    Variant("equal weights in ICP and eq. (1)", changes={"rigid.weights": "equal", "blendshapes.weights": "equal"}),
    Variant("depth point to point, direct solve", changes={"laplacian.depth_term": "point-to-point"}),
    Variant("w2 = 100 (energy weight)", changes={"laplacian.w2": 100.0, "laplacian.final_w2": 100.0}),
    Variant("hard 2D features", changes={"laplacian.feature_weight": 1e4, "laplacian.final_feature_weight": 1e4}),
    Variant("Kalman: accelerations", changes={"kalman.model": "acceleration"}),
    Variant("learning starts with a full buffer of 40", changes=FULL_BUFFER),
    Variant("K = 7", changes={"adaptive_pca.K": 7}),
)

#: What the first row is -> its parameters, the rows, and the file that the notes include.
TABLES = {
    "paper": (PAPER, FROM_PAPER, "from_paper.md"),
    "ours": (OURS, FROM_OURS, "from_defaults.md"),
}


def kalman_gain(model: str, frames: int = 600) -> tuple[float, int]:
    """Share of the first step that the settled filter takes over at once, and frames until it has taken over 90 %."""
    smoother = CoefficientFilter(KalmanParameters(model=model))
    for _ in range(frames):
        smoother.update(np.zeros(1))
    answers = np.array([float(smoother.update(np.ones(1))[0]) for _ in range(frames)])
    return answers[0], int(np.argmax(answers > 0.9)) + 1


def measure(seed: int, frames: int, stride: int, start: Parameters, variants: Sequence[Variant]) -> dict[str, list[float]]:
    """Variant -> the figures of one performer's repeat, and how many frames were lost."""
    sensor = SyntheticSensor(seed, frames=frames, neutral_frames=16, colour=False)
    actor = capture_source(sensor, neutral_frames=sensor.neutral_frames)
    taken = (sensor.read(index) for index in range(sensor.neutral_frames - 2, len(sensor)))
    with one_thread():
        found = run_ablations(taken, sensor, actor, start, variants, stride, sensor.neutral_frames + frames)
    out = {}
    for name, evaluation in found.items():
        figures = evaluation.summary(evaluation.stages[0], REPEAT)
        out[name] = [*(figures[key] for key in FIGURES), sum(evaluation.lost.values())]
    return out


def table(performers: Sequence[dict[str, list[float]]]) -> list[str]:
    """One table as lines of Markdown: means over performers, and the change of p95 with a bootstrap interval."""
    lines = [
        "| | median | p95 | active | normal | tangential | change of p95 (95 % interval) | lost |",
        "|---|---|---|---|---|---|---|---|",
    ]
    first = next(iter(performers[0]))
    for name in performers[0]:
        rows = np.array([performer[name] for performer in performers])
        change = rows[:, 1] - [performer[first][1] for performer in performers]
        low, high = bootstrap_interval(change)
        words = "" if name == first else f"{change.mean():+.3f} ({low:+.3f} to {high:+.3f})"
        means = " | ".join(f"{value:.3f}" for value in rows[:, :-1].mean(axis=0))
        lines.append(f"| {name} | {means} | {words} | {rows[:, -1].sum():.0f} |")
    return lines


def page(results: Sequence[dict], args: argparse.Namespace) -> str:
    """The table, and below the one from our defaults the filter's gains, as Markdown."""
    command = f"python docs/measure_notes.py {args.start} --frames {args.frames} --stride {args.stride}"
    command += f" --seeds {' '.join(map(str, args.seeds))}"
    lines = [*table(results), "", f"`{command}`, {date.today()}: {len(results)} performers.", ""]
    for model in ("variance", "acceleration") if args.start == "ours" else ():
        gain, late = kalman_gain(model)
        lines.append(f"* Kalman filter, `{model}`: gain {gain:.2f}, 90 % of a step after {late} frames")
    return "\n".join(lines) + "\n"


def main() -> None:
    """Measure, print, and write the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("start", choices=list(TABLES), help="the first row: Parameters.paper(), or our defaults")
    parser.add_argument("--seeds", type=int, nargs="+", default=SEEDS)
    parser.add_argument("--frames", type=int, default=40, help="of one performance, which is repeated (default 40)")
    parser.add_argument("--stride", type=int, default=4, help="score every so many frames of the repeat (default 4)")
    parser.add_argument("--json", type=Path, help="also write the figures of every performer here")
    args = parser.parse_args()
    start, variants, name = TABLES[args.start]
    results = {}
    for number, seed in enumerate(args.seeds, start=1):
        results[seed] = measure(seed, args.frames, args.stride, start, variants)
        print(f"{number} of {len(args.seeds)} performers", file=sys.stderr)
        if args.json:
            args.json.write_text(json.dumps(results, indent=1))
    text = page(list(results.values()), args)
    print(text)
    (Path(__file__).parent / "tables" / name).write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
