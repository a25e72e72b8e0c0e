"""Commands around the method: ``bench`` and ``lab``."""

from __future__ import annotations

import argparse
from pathlib import Path

from .arguments import whole


def add_bench(commands) -> None:
    """``bench``."""
    bench = commands.add_parser("bench", help="the per-stage timing table, with its peers where they are installed")
    bench.add_argument("--frames", type=whole(10, 10_000), metavar="N", help="synthetic frames to time")
    bench.add_argument("--live", action="store_true", help="instead: latency and lost frames of the live chain")
    bench.add_argument("--seconds", type=whole(1, 86_400), default=60, metavar="N", help="of --live: %(default)s")
    bench.add_argument("--soak", type=whole(1, 10_000), metavar="MINUTES", help="instead: does the live chain grow?")
    bench.add_argument("--json", action="store_true", help="of --live and --soak: one line of JSON")
    bench.set_defaults(run=run_bench)


def run_bench(args: argparse.Namespace) -> int:
    """``bench``: time every stage on a synthetic performance, beside the paper's figures and other libraries."""
    from ..bench import run_bench as run

    return run(args)


def add_lab(commands) -> None:
    """``lab``."""
    lab = commands.add_parser("lab", help="JupyterLab on a copy of the notebooks, on this machine only")
    lab.add_argument("--dir", type=Path, default=Path("adaptiveface-notebooks"), metavar="DIR", help="%(default)s")
    lab.add_argument("--port", type=whole(1, 65_535), metavar="N", help="default: 8888, or the next free one")
    lab.add_argument("--no-browser", action="store_true", help="only print the address")
    lab.set_defaults(run=run_lab)


def run_lab(args: argparse.Namespace) -> int:
    """``lab``."""
    from ..lab import open_lab

    return open_lab(args.dir, args.port, not args.no_browser)
