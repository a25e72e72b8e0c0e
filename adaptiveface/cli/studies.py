"""Commands for studies: ``batch``, ``evaluate`` and ``paper``."""

from __future__ import annotations

import argparse
from pathlib import Path

from ..errors import ParameterError
from ..export.arguments import FORMATS, add_actor
from ..files import check_folder, check_output
from .arguments import add_command, add_performer, add_settings, parameters, whole

#: The keys of ``studies.FIGURES``, whose import would make the help slow.
PAPER_FIGURES = (3, 4, 5, 6, 7, 8, 9, 10, 11)


def add_batch(commands) -> None:
    """Add the command ``batch``."""
    batch = add_command(commands, "batch")
    batch.add_argument("sources", metavar="FOLDER_OR_LIST", help="a folder of recordings, or a text file that lists them")
    batch.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder for results, tables and index.html")
    batch.add_argument(
        "--sweep",
        nargs="+",
        action="extend",
        default=[],
        metavar="stage.name=v,v,...",
        help="track with each of the values; several sweeps make every combination",
    )
    add_actor(batch, "captured from each recording")
    batch.add_argument(
        "--neutral-frames",
        type=whole(1, 99_999),
        default=40,
        metavar="N",
        help="leading frames that show the resting face (default: %(default)s)",
    )
    batch.add_argument(
        "--export",
        nargs="+",
        choices=list(FORMATS),
        default=[],
        metavar="FORMAT",
        help=f"also export every result: {', '.join(FORMATS)}",
    )
    batch.add_argument("--no-report", action="store_true", help="write no report.html")
    batch.add_argument(
        "--processes", type=whole(1, 1024), metavar="N", help="recordings at the same time (default: one per processor)"
    )
    batch.add_argument(
        "--cluster", metavar="tcp://HOST:PORT", help="work on the workers of this Dask scheduler instead of on this machine"
    )
    add_settings(batch)
    batch.set_defaults(run=run_batch)


def run_batch(args: argparse.Namespace) -> int:
    """Run ``batch FOLDER_OR_LIST --out DIR``. The exit status is 1 if a recording failed."""
    from ..batch import Batch, dask_client, expand, find_sources, parse_sweep
    from ..model.actor import Actor

    check_folder(args.out)
    if args.out.is_dir():
        check_output(args.out / "index.html", "html")
    actor = None
    if args.actor:
        Actor.load(args.actor)  # a damaged rig is an error here, not in every recording
        actor = str(args.actor.resolve())
    jobs = expand(
        find_sources(args.sources),
        parameters(args.set),
        parse_sweep(args.sweep),
        actor=actor,
        neutral_frames=args.neutral_frames,
        formats=tuple(args.export),
        report=not args.no_report,
    )
    client = dask_client(args.cluster) if args.cluster else None
    try:
        records = Batch(jobs, args.out).run(client, args.processes, progress=True)
    finally:
        if client is not None:
            client.close()
    failed = [record for record in records if record["status"] != "done"]
    for record in failed:
        print(f"failed: {record['source']}: {record['reason']}")
    print(f"{args.out / 'index.html'}: {len(records) - len(failed)} of {len(records)} done, {len(failed)} failed")
    return 1 if failed else 0


def add_evaluate(commands) -> None:
    """Add the command ``evaluate``."""
    evaluate = add_command(commands, "evaluate")
    evaluate.add_argument(
        "pairs",
        nargs="+",
        metavar="RESULT TRUTH",
        help="result.npz or another tracker's .npz, and its truth: a ground_truth.npz, the folder of the recording, or "
        "synthetic:SEED[:NOISE]",
    )
    add_actor(evaluate, "the one beside each result")
    evaluate.add_argument(
        "--step", type=whole(1, 1000), default=1, metavar="N", help="score every N-th frame (default: %(default)s)"
    )
    evaluate.add_argument("--csv", type=Path, metavar="FILE", help="also write a table with a row for each result")
    evaluate.set_defaults(run=run_evaluate)


def run_evaluate(args: argparse.Namespace) -> int:
    """Run ``evaluate RESULT TRUTH [RESULT TRUTH ...]``."""
    from .scores import compare_runs

    if len(args.pairs) % 2:
        raise ParameterError(f"{args.pairs[-1]}: each result needs its truth after it")
    return compare_runs(list(zip(args.pairs[::2], args.pairs[1::2], strict=True)), args.actor, args.step, args.csv)


def add_paper(commands) -> None:
    """Add the command ``paper``."""
    paper = add_command(commands, "paper")
    paper.add_argument(
        "--figure",
        type=int,
        nargs="+",
        choices=PAPER_FIGURES,
        default=PAPER_FIGURES,
        metavar="N",
        help="figures to draw (default: all)",
    )
    paper.add_argument(
        "--out",
        type=Path,
        default=Path("paper-figures"),
        metavar="DIR",
        help="folder for PNG, SVG and CSV files (default: %(default)s)",
    )
    add_performer(paper, seed=1000)
    paper.add_argument(
        "--frames",
        type=whole(12, 100_000),
        metavar="N",
        help="length of a performance, frames (default: what each figure needs)",
    )
    paper.set_defaults(run=run_paper)


def run_paper(args: argparse.Namespace) -> int:
    """Run ``paper [--figure N ...] [--out DIR]``."""
    from ..studies import paper_figure

    check_folder(args.out)
    for number in args.figure:
        drawn = paper_figure(number, args.seed, args.noise, args.frames)
        print(f"figure {number}, {drawn.title}: {drawn.caption}")
        print("  " + ", ".join(map(str, drawn.save(args.out))))
    return 0
