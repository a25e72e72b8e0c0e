"""How far real faces take each generic expression, and which go together: writes assets/expression_statistics.csv.

    python data_synth/build_expression_statistics.py take.csv --seconds 0 67

From a Live Link Face take of a person who performs every expression. What is shipped comes from the first half (67 s) of
``range_of_motion.csv`` of github.com/alexdjulin/LiveLinkFace-CSV-Retarget-For-Motionbuilder (MIT licence); reports are
made on the other half. A face and its mirror image count alike. The numbers are second moments of coefficients, about
zero: E[x_i x_j], one row and column per expression.
"""

from __future__ import annotations

import argparse
import csv
from pathlib import Path

import numpy as np

from adaptiveface.model.face_model import embedded_face_model
from adaptiveface.retargeting.arkit import arkit_weights
from adaptiveface.synthetic.take import read_take

OUT = Path(__file__).resolve().parents[1] / "adaptiveface" / "assets" / "expression_statistics.csv"


def main() -> None:
    """Write the table."""
    parser = argparse.ArgumentParser()
    parser.add_argument("take")
    parser.add_argument("--seconds", type=float, nargs=2, default=(0.0, 67.0))
    args = parser.parse_args()
    names = embedded_face_model().generic_names
    take = read_take(args.take)
    inside = (take.times >= args.seconds[0]) & (take.times < args.seconds[1])
    x = arkit_weights(names).coefficients(take.curves[inside])
    x = np.concatenate([x, x[:, [names.index(mirrored(name)) for name in names]]])
    with OUT.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(names)
        writer.writerows([f"{value:.5f}" for value in row] for row in x.T @ x / len(x))


def mirrored(name: str) -> str:
    """The expression on the other side."""
    return name.replace("Left", "~").replace("Right", "Left").replace("~", "Right")


if __name__ == "__main__":
    main()
