"""A batch on a local Dask cluster: killed, resumed, a worker killed; its tables against an undisturbed run, its pace.

    python tests/batch_runs.py [--recordings 24] [--frames 24] [--workers 2] [--folder DIR]

The recordings are short synthetic performances with ground truth, each of another performer. They are batched three times:
in a plain loop in this process and, a few recordings by turns, on the cluster undisturbed; then on the cluster by the
command line, which is ended by SIGKILL after a third of the recordings and run again, while a worker is ended by SIGKILL
as well. Exit status 1 where the tables differ in anything but times.
"""

from __future__ import annotations

import argparse
import csv
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "data_synth"))

from make_performance import make_performance  # noqa: E402
from tqdm import tqdm  # noqa: E402

from adaptiveface.batch import Batch, Job, completed, dask_client, expand, find_sources  # noqa: E402
from adaptiveface.batch.work import DONE, run_job  # noqa: E402
from adaptiveface.runtime.threads import one_thread  # noqa: E402
from adaptiveface.synthetic.sensor import SyntheticSensor  # noqa: E402

#: Leading frames that show the neutral; each performance is played twice.
NEUTRAL = 12
#: Seeds that nothing was tuned on.
FIRST_SEED = 1100


def write_recordings(folder: Path, count: int, frames: int) -> None:
    """Recordings of ``NEUTRAL`` + ``frames`` frames, depth and features only; those that lie there already are kept."""
    for seed in tqdm(range(FIRST_SEED, FIRST_SEED + count), desc="recordings", disable=None):
        target = folder / f"performer_{seed}"
        if not (target / "ground_truth.npz").is_file():
            sensor = SyntheticSensor(seed, "structured-light", NEUTRAL, frames // 2, 2, colour=False)
            make_performance(target, sensor, progress=False)


def rows(path: Path) -> list[dict[str, str]]:
    """A table without its times."""
    with open(path, newline="", encoding="utf-8") as stream:
        return [
            {key: value for key, value in row.items() if not key.startswith("ms_") and key != "seconds"}
            for row in csv.DictReader(stream)
        ]


def finished(out: Path) -> int:
    """How many recordings are done."""
    return len(list(out.glob(f"*/{DONE}")))


def timed(work: Callable[[], object]) -> float:
    """Seconds that it takes."""
    start = time.perf_counter()
    work()
    return time.perf_counter() - start


def in_turn(jobs: list[Job], plain: Path, whole: Path, client, workers: int) -> tuple[float, float]:
    """Seconds that a plain loop and the cluster take for all jobs; by turns, so that both meet what else the machine does."""
    loop = cluster = 0.0
    turn = 2 * workers
    for first in tqdm(range(0, len(jobs), turn), desc="loop and cluster", disable=None):
        mine = jobs[first : first + turn]
        with one_thread():
            loop += timed(lambda: [run_job(str(plain), job) for job in mine])  # noqa: B023
        cluster += timed(lambda: list(completed(partial(run_job, str(whole)), mine, client)))  # noqa: B023
    Batch(jobs, whole).run(client)  # all are done: it writes the tables
    return loop, cluster


def disturbed(takes: Path, out: Path, client, count: int) -> tuple[list[int], int]:
    """The batch by the command line, ended after a third, then run to its end while a worker is ended after two thirds.

    Returns how many recordings were done when each of the two was ended, and the exit status of the second run.
    """
    command = [sys.executable, "-m", "adaptiveface", "batch", str(takes), "--out", str(out), "--no-report"]
    command += ["--neutral-frames", str(NEUTRAL), "--cluster", client.scheduler.address]
    done = []
    for share, victim in ((1 / 3, "batch"), (2 / 3, "worker")):
        batch = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        while finished(out) < share * count and batch.poll() is None:
            time.sleep(0.2)
        pid = batch.pid if victim == "batch" else next(iter(client.run(os.getpid).values()))
        os.kill(pid, signal.SIGKILL)
        status = batch.wait()
        done.append(finished(out))
    return done, status


def main() -> int:
    """Print the table; 0 where the tables are equal."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--recordings", type=int, default=24)
    parser.add_argument("--frames", type=int, default=24, help="of the two performances together")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--folder", type=Path, help="keep recordings and results here")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        return run(args, args.folder or Path(temporary))


def run(args: argparse.Namespace, folder: Path) -> int:
    """The three runs in ``folder``, and what came of them."""
    takes, count = folder / "takes", args.recordings
    write_recordings(takes, count, args.frames)
    jobs = expand(find_sources(takes), neutral_frames=NEUTRAL, report=False)
    plain = folder / "plain"
    os.environ |= {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}  # of the workers
    client = dask_client(workers=args.workers)
    try:
        client.run(lambda: __import__("adaptiveface.pipeline"))
        loop, cluster = in_turn(jobs, plain, folder / "whole", client, args.workers)
        done, status = disturbed(takes, folder / "disturbed", client, count)
    finally:
        client.close()
    equal = [rows(folder / "whole" / name) == rows(folder / "disturbed" / name) for name in ("recordings.csv", "frames.csv")]
    whole, frames = rows(folder / "whole" / "recordings.csv"), rows(folder / "whole" / "frames.csv")
    failed = sum(row["status"] != "done" for row in whole)
    print(f"| {count} recordings of {NEUTRAL + args.frames} frames | s | recordings a minute | against the loop |")
    print("|---|---|---|---|")
    for name, seconds in (("plain loop", loop), (f"Dask, {args.workers} workers", cluster)):
        print(f"| {name} | {seconds:.0f} | {60 * count / seconds:.1f} | {loop / seconds:.2f} |")
    print(f"\nfailed: {failed}; load {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores")
    print(f"batch killed with {done[0]} done, resumed; a worker killed; {done[1]} done in the end, exit status {status}")
    for name, same, size in zip(("recordings.csv", "frames.csv"), equal, (len(whole), len(frames)), strict=True):
        print(f"{name}: {size} rows, {'equal' if same else 'NOT EQUAL'} to the undisturbed run's")
    return 0 if all(equal) and status == 0 and not failed else 1


if __name__ == "__main__":
    sys.exit(main())
