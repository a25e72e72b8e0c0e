"""Print the scores of ``adaptiveface evaluate``: a table per run, the mean over the runs, and how their parameters differ."""

from __future__ import annotations

import csv
import math
from collections.abc import Sequence
from pathlib import Path

from ..errors import FileFormatError
from ..evaluation import GroundTruth, bootstrap_interval, score_other, score_result, truth_of
from ..evaluation.compare import is_result
from ..evaluation.table import evaluation_table
from ..files import check_output, replacing
from ..parameters import Parameters


def compare_runs(pairs: Sequence[tuple[str, str]], actor: Path | None, step: int, table: Path | None) -> int:
    """Score each (result, truth), print the scores, and write them to ``table`` (.csv) if it is given."""
    if table is not None:
        check_output(table, "scores", [actor, *(path for pair in pairs for path in pair)])
    rows, parameters = [], []
    for result, truth in pairs:
        row, used = _score(Path(result), truth, actor, step)
        rows.append({"result": result, "truth": truth, **row})
        parameters += [] if used is None else [(result, used)]
    if len(rows) > 1:
        print(mean_table(rows))
    for (first, ours), (other, theirs) in zip(parameters, parameters[1:], strict=False):
        differences = ours.diff(theirs)
        if differences:
            print(f"{first} and {other} differ in " + ", ".join(f"{k} {a} | {b}" for k, (a, b) in differences.items()))
    if table is not None:
        names = list(dict.fromkeys(name for row in rows for name in row))
        with replacing(table) as temporary, open(temporary, "w", newline="", encoding="utf-8") as stream:
            writer = csv.DictWriter(stream, names, restval="")
            writer.writeheader()
            writer.writerows(rows)
        print(f"{table}: {len(rows)} rows")
    return 0


def _score(path: Path, text: str, actor_file: Path | None, step: int) -> tuple[dict[str, float], Parameters | None]:
    truth = _truth(text)
    if not is_result(path):
        row = score_other(path, truth, step=step)
        print(f"{path}: " + ", ".join(f"{name} {value:.3f}" for name, value in row.items()))
        return row, None
    from ..model.actor import Actor
    from ..result import Result

    actor_file = actor_file or path.with_name("actor.npz")
    if not actor_file.is_file():
        raise FileFormatError(f"{path}: there is no actor.npz beside it; name the rig with --actor")
    result, actor = Result.load(path), Actor.load(actor_file)
    evaluation = score_result(result, truth, actor, step)
    print(f"{path}\n{evaluation_table(evaluation)}")
    return evaluation.summary("v4", int(evaluation.performance.max())), Parameters.from_json(result.parameters)


def _truth(text: str) -> GroundTruth:
    if text.endswith(".npz"):
        return GroundTruth.load(text)
    from ..sensors import open_source

    found = truth_of(open_source(text))
    if found is None:
        raise FileFormatError(f"{text}: holds no ground_truth.npz, so nothing can be scored against it")
    return GroundTruth.of(found)


def mean_table(rows: Sequence[dict]) -> str:
    """Format the mean of each figure over the rows that have it, with its 95 % interval from a bootstrap over the rows."""
    lines = [f"{'mean over ' + str(len(rows)) + ' runs':<24} {'mean':>8}   95 % interval"]
    for name in dict.fromkeys(name for row in rows for name in row):
        values = [row[name] for row in rows if isinstance(row.get(name), float) and math.isfinite(row[name])]
        if len(values) > 1:
            low, high = bootstrap_interval(values)
            lines.append(f"{name:<24} {sum(values) / len(values):>8.3f}   {low:.3f} to {high:.3f}")
    return "\n".join(lines)
