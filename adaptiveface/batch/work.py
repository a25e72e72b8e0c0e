"""Do one job of a batch: capture, track, score and export. Its folder appears whole or not at all."""

from __future__ import annotations

import argparse
import csv
import glob
import json
import os
import re
import shutil
import time
from contextlib import redirect_stdout
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import AdaptiveFaceError
from ..files import read_json, replacing
from ..tracking.types import SampleState
from .jobs import Job

DONE, LOG = "done.json", "log.txt"
_MAX_JSON_BYTES = 16 << 20


def finished(folder: Path, job: Job) -> dict | None:
    """Look for the record of a job that was done before.

    Parameters
    ----------
    folder : Path
        The batch's output folder.
    job : Job

    Returns
    -------
    dict or None
        The record. It is None if the job was not done before with the same options.
    """
    path = folder / job.name / DONE
    if not path.is_file():
        return None
    try:
        record = read_json(path, _MAX_JSON_BYTES)
    except (AdaptiveFaceError, ValueError):
        return None
    return record if isinstance(record, dict) and record.get("fingerprint") == job.fingerprint else None


def drop_unfinished(folder: Path, job: Job) -> None:
    """Remove the unfinished folders that killed workers left for a finished job."""
    target = folder / job.name
    for left in target.parent.glob(f"{glob.escape(target.name)}.part*"):
        if re.fullmatch(r"\.part\d+", left.name[len(target.name) :]):
            shutil.rmtree(left, ignore_errors=True)


def run_job(folder: str, job: Job) -> dict:
    """Do one job and return its record: one row of the table of recordings.

    Parameters
    ----------
    folder : str
        The batch's output folder. The job's files go to ``folder/job.name``: ``result.npz``, ``actor.npz``,
        ``frames.csv``, the exports, the report, and ``done.json`` with the record.
    job : Job
        The job to do.

    Returns
    -------
    dict
        The record.

    Notes
    -----
    Errors that come from the recording or the options end in a record with ``status`` "failed" and the reason.
    The files are written to a temporary folder. When all are written, it replaces the job's own folder.
    """
    target = Path(folder) / job.name
    unfinished = target.with_name(f"{target.name}.part{os.getpid()}")
    shutil.rmtree(unfinished, ignore_errors=True)
    unfinished.mkdir(parents=True)
    start = time.perf_counter()
    record: dict[str, Any] = {"recording": job.name.split("/")[0], "source": job.source, **dict(job.settings)}
    try:
        with open(unfinished / LOG, "w", encoding="utf-8", errors="backslashreplace") as log, redirect_stdout(log):
            record |= _work(unfinished, job)
    except AdaptiveFaceError as error:
        shutil.rmtree(unfinished, ignore_errors=True)
        return record | {"status": "failed", "reason": " ".join(str(error).split())}
    except BaseException:
        shutil.rmtree(unfinished, ignore_errors=True)
        raise
    record |= {"status": "done", "reason": "", "folder": job.name, "seconds": round(time.perf_counter() - start, 2)}
    with replacing(unfinished / DONE) as temporary:
        temporary.write_text(json.dumps({"fingerprint": job.fingerprint, **record}, indent=1), encoding="utf-8")
    shutil.rmtree(target, ignore_errors=True)
    os.replace(unfinished, target)
    return record


def _work(folder: Path, job: Job) -> dict:
    from ..evaluation import ErrorCollector, truth_of
    from ..model.actor import Actor
    from ..parameters import Parameters
    from ..pipeline import FrameReader, capture_source, track_to_file
    from ..sensors import open_source

    parameters = Parameters.from_json(job.parameters)
    source = open_source(job.source)
    still_frames: list[int] = []  # numbers of neutral frames, if the neutral is captured here

    def on_take(take) -> None:
        still_frames.append(len(take.frames) if take.leading else 0)

    with FrameReader(source, remember=not job.actor) as reader:
        actor = Actor.load(job.actor) if job.actor else capture_source(reader, parameters, job.neutral_frames, on_take=on_take)
        truth = truth_of(source)
        collector = None if truth is None else ErrorCollector(truth, actor, ("v1", "v4"))
        collect = None if collector is None else lambda tracked, _: collector.add(tracked)
        result = track_to_file(reader, actor, folder / "result.npz", parameters, on_frame=collect)
    if not job.actor:
        actor.save(folder / "actor.npz")
    evaluation = None if collector is None else collector.finish()
    write_frames(folder / "frames.csv", job, result, evaluation)
    for kind in job.formats:
        _export(folder, kind)
    if job.report:
        from ..report import write_report

        write_report(
            result,
            source,
            actor,
            folder,
            truth,
            evaluation=evaluation,
            correctives=result.correctives,
            still_frames=sum(still_frames),
        )
    return summary(result, evaluation)


def _export(folder: Path, kind: str) -> None:
    """Export as ``adaptiveface export`` does, with its default output names."""
    from ..export.arguments import add_export_arguments
    from ..export.command import run_export

    parser = argparse.ArgumentParser()
    add_export_arguments(parser)
    run_export(parser.parse_args([str(folder / "result.npz"), "--format", kind]))


def summary(result, evaluation) -> dict:
    """Counts, times and, where the truth is known, errors of v4 on the last performance that it has (mm, shares)."""
    tracked = result.tracked
    row: dict[str, Any] = {
        "frames": len(result),
        "tracked": int(tracked.sum()),
        "lost": int((~tracked & ~result.skipped).sum()),
        "broken": int(result.skipped.sum()),
        "learned": int((result.sample_state == SampleState.LEARNED).sum()),
        "colour_only": bool(result.colour_only),
    }
    if tracked.any():
        ms = result.stage_ms[tracked].sum(axis=1)
        row |= {"ms_median": float(np.median(ms)), "ms_p95": float(np.percentile(ms, 95))}
        row |= {"residual": float(np.mean(result.residual[tracked]))}
        row |= {"adaptive_distance": float(np.mean(result.adaptive_distance[tracked]))}
    if evaluation is not None:
        last = int(evaluation.performance.max())
        row |= {f"v4_{name}": float(value) for name, value in evaluation.summary("v4", last).items()}
    return row


def write_frames(path: Path, job: Job, result, evaluation=None) -> None:
    """``frames.csv``: one row per frame, with the recording's name and the swept values as its first columns."""
    columns: dict[str, list] = {"recording": [job.name.split("/")[0]] * len(result)}
    columns |= {name: [value] * len(result) for name, value in job.settings}
    columns["frame"] = list(range(len(result)))
    columns["timestamp"] = [f"{t:.6f}" for t in result.timestamps]
    for name in ("tracked", "skipped"):
        columns[name] = [int(value) for value in getattr(result, name)]
    columns["reason"] = list(result.reasons)
    for name in ("sample_state", "corrective_updates"):
        columns[name] = [int(value) for value in getattr(result, name)]
    for name in ("residual", "anchor_distance", "adaptive_distance"):
        columns[name] = [f"{value:.5f}" for value in getattr(result, name)]
    if evaluation is not None:
        surface = evaluation.surface[evaluation.stages.index("v4")]
        errors = dict(zip(evaluation.index.tolist(), surface, strict=True))
        for name, percent in (("v4_surface_median", 50), ("v4_surface_p95", 95)):
            columns[name] = [f"{np.percentile(errors[i], percent):.5f}" if i in errors else "" for i in range(len(result))]
    for k, stage in enumerate(result.stage_names):
        columns[f"ms_{stage}"] = [f"{value:.4f}" for value in result.stage_ms[:, k]]
    for k, expression in enumerate(result.expression_names):
        columns[expression] = [f"{value:.5f}" for value in result.coefficients[:, k]]
    with replacing(path) as temporary, open(temporary, "w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream)
        writer.writerow(columns)
        writer.writerows(zip(*columns.values(), strict=True))
