"""Measure the decisions of the paper notes on a synthetic performer: one table, one decision undone per row.

    python docs/measure_notes.py [--seed 3] [--frames 60]

The performance is played twice with other noise and head motion; rows score the repeat against the ground truth. Writes
``docs/measured.md``, which the notes include.
"""

from __future__ import annotations

import argparse
from datetime import date
from pathlib import Path

import numpy as np

from adaptiveface.evaluation.ablation import Variant, run_ablations
from adaptiveface.evaluation.truth import REPEAT
from adaptiveface.parameters import KalmanParameters, Parameters, describe
from adaptiveface.pipeline import capture_from, one_blas_thread
from adaptiveface.synthetic.sensor import SyntheticSensor
from adaptiveface.tracking.kalman import CoefficientFilter

PAPER = {f"{row['stage']}.{row['name']}": row["paper"] for row in describe() if row["paper"] is not None}
DECISIONS = (
    Variant("defaults"),
    Variant("learning off", changes={"adaptive_pca.learn": False}),
    Variant("one ICP step", changes={"rigid.iterations": 1}),
    Variant("pose not solved with the coefficients", changes={"blendshapes.joint_pose": False}),
    Variant("the same, and one ICP step", changes={"blendshapes.joint_pose": False, "rigid.iterations": 1}),
    Variant("no ridge and temporal penalty", changes={"blendshapes.ridge": 0.0, "blendshapes.temporal": 0.0}),
    Variant("w2 = 100 (energy weight)", changes={"laplacian.w2": 100.0, "laplacian.final_w2": 100.0}),
    Variant("hard 2D features", changes={"laplacian.feature_weight": 1e4, "laplacian.final_feature_weight": 1e4}),
    Variant("Kalman: accelerations", changes={"kalman.model": "acceleration"}),
    Variant("learning starts with a full buffer", changes={"adaptive_pca.startup": "full-buffer"}),
    Variant("K = 7", changes={"adaptive_pca.K": 7}),
    Variant("the paper's values, all of them", changes=PAPER),
)


def kalman_gain(model: str, frames: int = 600) -> tuple[float, int]:
    """Share of the first step that the settled filter takes over at once, and frames until it has taken over 90 %."""
    smoother = CoefficientFilter(KalmanParameters(model=model))
    for _ in range(frames):
        smoother.update(np.zeros(1))
    answers = np.array([float(smoother.update(np.ones(1))[0]) for _ in range(frames)])
    return answers[0], int(np.argmax(answers > 0.9)) + 1


def table(evaluations: dict, args: argparse.Namespace) -> str:
    """The two tables as Markdown."""
    lines = ["| | median | p95 | active | normal | tangential |", "|---|---|---|---|---|---|"]
    for name, evaluation in evaluations.items():
        row = evaluation.summary(evaluation.stages[0], REPEAT)
        keys = ("surface_median", "surface_p95", "active_share", "normal", "tangential")
        lines.append(f"| {name} | " + " | ".join(f"{row[key]:.3f}" for key in keys) + " |")
    lines += [
        "",
        f"`python docs/measure_notes.py --seed {args.seed} --frames {args.frames}`, {date.today()}. One performer: "
        "differences in the third decimal mean nothing.",
        "",
    ]
    for model in ("variance", "acceleration"):
        gain, late = kalman_gain(model)
        lines.append(f"* Kalman filter, `{model}`: gain {gain:.2f}, 90 % of a step after {late} frames")
    return "\n".join(lines) + "\n"


def main() -> None:
    """Measure, print, and write the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seed", type=int, default=3)
    parser.add_argument("--frames", type=int, default=60)
    args = parser.parse_args()
    sensor = SyntheticSensor(args.seed, frames=args.frames)
    actor = capture_from(sensor, neutral_frames=sensor.neutral_frames)
    frames = [sensor.read(index) for index in range(len(sensor))]
    with one_blas_thread():
        evaluations = run_ablations(frames, sensor, actor, Parameters(), DECISIONS)
    text = table(evaluations, args)
    print(text)
    (Path(__file__).parent / "measured.md").write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
