"""What the evaluations of synthetic performers share: their options, and one process per performer and noise."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path

from adaptiveface.parameters import Parameters


def run_parser(doc: str, seeds: Sequence[int], noises: Sequence[str], stride: int, cache: str) -> argparse.ArgumentParser:
    """A parser with the shared options and these defaults; ``doc`` describes the script, ``cache`` what that keeps."""
    parser = argparse.ArgumentParser(description=doc, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, nargs="+", default=list(seeds))
    parser.add_argument("--noises", nargs="+", default=list(noises), choices=["structured-light", "truedepth", "none"])
    parser.add_argument("--frames", type=int, default=300, help="frames of one performance (default 300)")
    parser.add_argument("--neutral-frames", type=int, default=40)
    parser.add_argument("--stride", type=int, default=stride, help=f"score every so many frames (default {stride})")
    parser.add_argument("--set", action="append", default=[], metavar="STAGE.NAME=VALUE", help="change a parameter")
    parser.add_argument("--cache", type=Path, help=f"folder that keeps {cache}")
    parser.add_argument("--jobs", type=int, default=2, help="processes (default 2)")
    parser.add_argument("--json", type=Path, help="write every figure here")
    return parser


def run_performers(args: argparse.Namespace, run: Callable[[int, str, dict], dict]) -> list[dict]:
    """The rows ``run(seed, noise, options)`` of all seeds and noises, in their order.

    ``options``: ``args`` as a dict, ``set`` as a dict of its own. A wrong parameter is an error before any work.
    """
    changed = dict(entry.partition("=")[::2] for entry in args.set)
    Parameters().replace(**changed)
    options = vars(args) | {"set": changed}
    tasks = [(seed, noise) for seed in args.seeds for noise in args.noises]
    rows = []
    with ProcessPoolExecutor(max_workers=max(1, min(args.jobs, len(tasks)))) as pool:
        pending = {pool.submit(run, seed, noise, options) for seed, noise in tasks}
        for number, future in enumerate(as_completed(pending), start=1):
            rows.append(future.result())
            print(f"{number} of {len(tasks)} performers", file=sys.stderr)
    return sorted(rows, key=lambda row: tasks.index((row["seed"], row["noise"])))


def write_json(args: argparse.Namespace, rows: list[dict]) -> None:
    """Every row and option to ``--json``, if that was given."""
    if args.json:
        args.json.write_text(json.dumps(dict(options=vars(args), rows=rows), indent=1, default=str))
