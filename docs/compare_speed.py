"""The times of two versions of the code, measured in turns: ``python docs/compare_speed.py REVISION``.

Both versions track the same recording with the same actor, through the command line and the result's file, which are the
same in all versions. They take turns, in the order A B B A, because a machine is not as fast now as it was a minute ago.
Of each frame and stage the fastest round counts, since whatever else the machine does only makes a round slower. The table
has the median over the frames, and the processor time of the whole command, the fastest round again.
"""

from __future__ import annotations

import argparse
import os
import resource
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

from adaptiveface.sensors import RecordingWriter
from adaptiveface.synthetic.sensor import SyntheticSensor

HERE = Path(__file__).resolve().parents[1]


def run(checkout: Path, *words: str | Path) -> float:
    """Run a command of a checkout; the processor time that it took, s."""
    before = _used()
    environment = os.environ | {"PYTHONPATH": str(checkout), "OMP_NUM_THREADS": "1"}
    command = [sys.executable, "-m", "adaptiveface", *map(str, words)]
    done = subprocess.run(command, cwd=checkout, env=environment, capture_output=True, text=True)
    if done.returncode:
        sys.exit(f"{checkout}: {' '.join(map(str, words))}\n{done.stderr}")
    return _used() - before


def _used() -> float:
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime


def record(folder: Path, frames: int) -> int:
    """A synthetic performance as a recording, its neutral first; returns how many frames are the neutral."""
    sensor = SyntheticSensor(5, "structured-light", frames=frames, repeats=1)
    with RecordingWriter(folder, sensor.camera, sensor.fps, sensor.depth_scale) as writer:
        for index in range(len(sensor)):
            writer.write(sensor.read(index))
    return sensor.neutral_frames


def measure(checkouts: list[Path], folder: Path, frames: int, rounds: int) -> tuple[list[dict[str, float]], list[float]]:
    """For each checkout: stage -> median ms, and the processor time of the command, s."""
    neutral = record(folder / "take", frames)
    run(checkouts[0], "capture", folder / "take", "--out", folder / "actor.npz", "--neutral-frames", str(neutral))
    out = folder / "result.npz"
    words = ("track", folder / "take", "--actor", folder / "actor.npz", "--out", out)
    times: list[list[np.ndarray]] = [[], []]
    used: list[list[float]] = [[], []]
    names: list[list[str]] = [[], []]
    order = [0, 1] + [1, 0, 0, 1] * rounds  # the first two compile what is not compiled yet
    for turn, which in enumerate(order):
        took = run(checkouts[which], *words)
        with np.load(out) as result:
            kept = result["stage_ms"][result["tracked"]]
            names[which] = result["stage_names"].tolist()
        out.unlink()
        if turn > 1:
            times[which].append(kept)
            used[which].append(took)
        print(f"\r{turn + 1}/{len(order)}", end="", file=sys.stderr)
    print(file=sys.stderr)
    medians = [
        dict(zip(n, np.median(np.min(t, axis=0), axis=0).tolist(), strict=True)) for n, t in zip(names, times, strict=True)
    ]
    return medians, [min(seconds) for seconds in used]


def table(medians: list[dict[str, float]], used: list[float], label: str) -> str:
    """Times before and after, and their ratio; stages that one of the versions lacks have no ratio."""
    before, after = medians
    rows = [f"| | {label} | this | ratio |", "|---|---|---|---|"]
    for name in dict.fromkeys([*before, *after]):
        values = [f"{side[name]:.2f}" if name in side else "" for side in medians]
        ratio = f"{after[name] / before[name]:.2f}" if all(side.get(name, 0) > 0.005 for side in medians) else ""
        rows.append(f"| {name}, ms | {values[0]} | {values[1]} | {ratio} |")
    sums = [sum(side.values()) for side in medians]
    rows.append(f"| all stages, ms | {sums[0]:.2f} | {sums[1]:.2f} | {sums[1] / sums[0]:.2f} |")
    rows.append(f"| the command, s of processor time | {used[0]:.1f} | {used[1]:.1f} | {used[1] / used[0]:.2f} |")
    return "\n".join(rows)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("revision", help="git revision to compare this checkout with, or the folder of another checkout")
    parser.add_argument("--frames", type=int, default=60, help="frames of the performance (default: %(default)s)")
    parser.add_argument("--rounds", type=int, default=3, help="so many times A B B A (default: %(default)s)")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        other = Path(args.revision).resolve()
        if not other.is_dir():
            other = place / "checkout"
            subprocess.run(["git", "worktree", "add", "-q", "--detach", other, args.revision], cwd=HERE, check=True)
        try:
            print(table(*measure([other, HERE], place, args.frames, args.rounds), args.revision))
        finally:
            if other.is_relative_to(place):
                subprocess.run(["git", "worktree", "remove", "--force", other], cwd=HERE, check=True)


if __name__ == "__main__":
    main()
