"""Capture, track and score synthetic performers the tracker has never seen; hold the figures against the limits.

    python data_synth/evaluate_performers.py                                  # what is reported: seeds 1000 to 1004
    python data_synth/evaluate_performers.py --seeds 1 2 --cache /tmp/frames   # while developing: seeds below 100

Each performer is captured from its neutral frames and tracked twice over the same frames, with learning on and off.
The initial blendshapes v1 that v4 is compared with are those of learning off, since personal blendshapes learn, too.
All figures are in mm, on the second performance of the script (the repeat), but for the shares. Exit status 1 when a
limit is missed by any performer.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import sys
import time
from dataclasses import dataclass
from pathlib import Path

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")  # before NumPy is loaded: every process takes one core

import numpy as np  # noqa: E402
from performer_runs import run_parser, run_performers, write_json  # noqa: E402

import adaptiveface  # noqa: E402
from adaptiveface.evaluation import REPEAT, ErrorCollector, Evaluation  # noqa: E402
from adaptiveface.evaluation.ablation import ablation_table, run_ablations  # noqa: E402
from adaptiveface.geometry.frame import Features2D, RgbdFrame  # noqa: E402
from adaptiveface.neutral.capture import capture_actor  # noqa: E402
from adaptiveface.parameters import Parameters  # noqa: E402
from adaptiveface.synthetic.sensor import SyntheticSensor  # noqa: E402
from adaptiveface.tracking.tracker import FaceTracker  # noqa: E402

REPORTING_SEEDS = (1000, 1001, 1002, 1003, 1004)
NOISES = ("structured-light", "truedepth")


@dataclass(frozen=True)
class Limit:
    """A figure of a performer's row that must not pass ``bound``: at most, or at least where ``at_least``."""

    name: str
    label: str
    bound: float
    at_least: bool = False

    def holds(self, value: float) -> bool:
        return value >= self.bound if self.at_least else value <= self.bound

    def worst(self, rows: list[dict]) -> dict:
        return min(rows, key=lambda r: r[self.name]) if self.at_least else max(rows, key=lambda r: r[self.name])


LIMITS = (
    Limit("surface_median", "surface median, mm", 0.3),
    Limit("surface_p95", "surface 95th percentile, mm", 1.1),
    Limit("active_share", "active share", 0.34),
    Limit("lips", "lips, mm", 1.1),
    Limit("gain_v1", "v4 over v1, 95th percentile", 0.20, at_least=True),
    Limit("gain_learning", "learning on over off, 95th percentile", 0.15, at_least=True),
    Limit("lost", "share of frames lost (lost frames are not scored)", 0.01),
)


class CachedFrames:
    """The frames of a sensor, rendered once and kept in a folder: depth in the driver's units, 2D features."""

    def __init__(self, sensor: SyntheticSensor, folder: Path | None):
        self.sensor, self.unit = sensor, sensor.depth_scale / 1000.0
        self.folder = None if folder is None else folder / f"{sensor.seed}-{sensor.noise}-{_fingerprint(sensor)}"
        if self.folder is not None:
            if not (self.folder / "complete").exists():
                self._render()
            self._depth = np.load(self.folder / "depth.npy", mmap_mode="r")
            self._tables = dict(np.load(self.folder / "tables.npz", allow_pickle=False))

    def _render(self) -> None:
        self.folder.mkdir(parents=True, exist_ok=True)
        depths, windows, pixels, confidences = [], [], [], []
        for index in range(len(self.sensor)):
            frame = self.sensor.read(index)
            rows, columns = (np.flatnonzero((frame.depth > 0).any(axis=axis)) for axis in (1, 0))
            window = (rows[0], rows[-1] + 1, columns[0], columns[-1] + 1)
            depth = np.rint(frame.depth[window[0] : window[1], window[2] : window[3]] * self.unit).astype(np.uint16)
            if not np.array_equal(self._in_millimetres(depth, window), frame.depth):
                raise RuntimeError(f"frame {index} of {self.sensor.name} is not a whole number of the driver's units")
            depths.append(depth.ravel())
            windows.append(window)
            pixels.append(frame.features.pixels)
            confidences.append(frame.features.confidence)
        np.save(self.folder / "depth.npy", np.concatenate(depths))
        starts = np.concatenate([[0], np.cumsum([len(depth) for depth in depths])])
        np.savez(self.folder / "tables.npz", windows=windows, starts=starts, pixels=pixels, confidences=confidences)
        (self.folder / "complete").touch()

    def _in_millimetres(self, depth: np.ndarray, window) -> np.ndarray:
        full = np.zeros((self.sensor.camera.height, self.sensor.camera.width), np.float32)
        full[window[0] : window[1], window[2] : window[3]] = (depth / self.unit).astype(np.float32)
        return full

    def read(self, index: int) -> RgbdFrame:
        if self.folder is None:
            return self.sensor.read(index)
        tables = self._tables
        top, bottom, left, right = window = tables["windows"][index]
        depth = self._depth[tables["starts"][index] : tables["starts"][index + 1]].reshape(bottom - top, right - left)
        features = Features2D(tables["pixels"][index], tables["confidences"][index])
        frame_depth = self._in_millimetres(depth, window)
        return RgbdFrame(frame_depth, self.sensor.camera, None, index, index / self.sensor.fps, features)


def _fingerprint(sensor: SyntheticSensor) -> str:
    """Changes with everything that frames depend on: the sensor's options, its code and the model it draws from."""
    package = Path(adaptiveface.__file__).parent
    sources = sorted((package / "synthetic").glob("*.py"))
    sources += [package / "geometry" / name for name in ("rendering.py", "camera.py", "mesh.py")]
    sources.append(package / "assets/face_model.npz")
    digest = hashlib.sha256(repr((sensor.neutral_frames, sensor.frames, sensor.repeats, sensor.feature_noise)).encode())
    digest.update(np.ascontiguousarray(sensor.script).tobytes())
    for path in sources:
        digest.update(path.read_bytes())
    return digest.hexdigest()[:12]


def run_performer(seed: int, noise: str, options: dict) -> dict:
    """One performer with one noise: capture, track with learning on and off, score. Returns its row of figures."""
    sensor = SyntheticSensor(
        seed, noise, neutral_frames=options["neutral_frames"], frames=options["frames"], repeats=2, colour=False
    )
    frames = CachedFrames(sensor, options["cache"])
    parameters = Parameters().replace(**options["set"])
    started = time.perf_counter()
    actor = capture_actor([frames.read(i) for i in range(options["neutral_frames"])], parameters=parameters)
    row = dict(seed=seed, noise=noise, capture_s=time.perf_counter() - started)
    runs = {"on": (FaceTracker(actor, parameters), ErrorCollector(sensor, actor))}
    if not options["no_ablation"]:
        frozen = parameters.replace(adaptive_pca__learn=False)
        runs["off"] = (FaceTracker(actor, frozen), ErrorCollector(sensor, actor, ("v1", "v4")))
    times = []
    for index in range(len(sensor)):
        frame = frames.read(index)
        scored = index >= options["neutral_frames"] and index % options["stride"] == 0
        for name, (tracker, collector) in runs.items():
            tracked = tracker.track(frame)
            if name == "on":
                times.append(sum(tracked.stage_ms.values()))
            if scored or not tracked.tracked:
                collector.add(tracked)
    evaluations = {name: collector.finish() for name, (_, collector) in runs.items()}
    row.update(_figures(evaluations), track_ms=float(np.median(times)), table=evaluations["on"].table())
    row["lost"] = sum(evaluations["on"].lost.values()) / len(sensor)
    if options["figure_5"]:
        again = (frames.read(index) for index in range(len(sensor)))
        row["figure_5"] = ablation_table(run_ablations(again, sensor, actor, parameters, stride=options["stride"]))
    return row


def _figures(evaluations: dict[str, Evaluation]) -> dict:
    on = evaluations["on"]
    row = on.summary("v4", REPEAT)
    chosen = on.frames(REPEAT)
    row.update(pose_mm=float(on.pose_shift[chosen].mean()), pose_degrees=float(on.pose_angle[chosen].mean()))
    if "off" in evaluations:
        off = evaluations["off"].summary("v4", REPEAT)
        row.update(off_p95=off["surface_p95"], off_active=off["active_share"])
        v1 = evaluations["off"].surface_percentiles("v1", REPEAT)[1]
        row.update(v1_p95=v1, gain_v1=1 - row["surface_p95"] / v1)
        row["gain_learning"] = 1 - row["surface_p95"] / off["surface_p95"]
    return row


_COLUMNS = (
    ("surface_median", "median", ".3f"),
    ("surface_p95", "p95", ".3f"),
    ("active_share", "active", ".3f"),
    ("lips", "lips", ".3f"),
    ("lips_active", "(active)", ".3f"),
    ("eyes", "eyes", ".3f"),
    ("brows", "brows", ".3f"),
    ("cheeks", "cheeks", ".3f"),
    ("chin", "chin", ".3f"),
    ("normal", "normal", ".3f"),
    ("tangential", "tangent.", ".3f"),
    ("v1_p95", "v1 p95", ".3f"),
    ("gain_v1", "gain", ".0%"),
    ("off_p95", "off p95", ".3f"),
    ("gain_learning", "gain", ".0%"),
    ("pose_mm", "pose mm", ".2f"),
    ("pose_degrees", "deg", ".2f"),
    ("lost", "lost", ".1%"),
    ("track_ms", "ms", ".1f"),
)


def table(rows: list[dict]) -> str:
    """One line per performer, and their mean."""
    columns = [c for c in _COLUMNS if c[0] in rows[0]]
    lines = [f"{'performer':<24}" + "".join(f"{label:>9}" for _, label, _ in columns)]
    for row in rows:
        lines.append(f"{_name(row):<24}" + "".join(f"{row[key]:>9{form}}" for key, _, form in columns))
    means = (f"{np.mean([row[key] for row in rows]):>9{form}}" for key, _, form in columns)
    lines.append(f"{'mean':<24}" + "".join(means))
    return "\n".join(lines)


def verdict(rows: list[dict]) -> tuple[str, bool]:
    """One line per limit with the worst performer named; True when every performer keeps every limit."""
    lines, all_hold = [], True
    for limit in LIMITS:
        if limit.name not in rows[0]:
            continue
        worst = limit.worst(rows)
        holds = limit.holds(worst[limit.name])
        mean = float(np.mean([row[limit.name] for row in rows]))
        relation = "at least" if limit.at_least else "at most"
        lines.append(
            f"{'pass' if holds else 'FAIL'}  {limit.label:<52} {relation} {limit.bound:<5} mean {mean:.3f}, "
            f"worst {worst[limit.name]:.3f} ({_name(worst)})"
        )
        all_hold &= holds
    return "\n".join(lines), all_hold


def _name(row: dict) -> str:
    return f"{row['seed']} {row['noise']}"


def parse(arguments: list[str] | None) -> argparse.Namespace:
    cache = "the rendered frames (about 130 MB per performer)"
    parser = run_parser(__doc__, REPORTING_SEEDS, NOISES, stride=1, cache=cache)
    parser.add_argument("--no-ablation", action="store_true", help="leave out the runs with learning off")
    parser.add_argument("--figure-5", action="store_true", help="leave out stages one by one, as the paper's figure 5")
    parser.add_argument("--stages", action="store_true", help="print every stage's table per performer")
    return parser.parse_args(arguments)


def main(arguments: list[str] | None = None) -> int:
    args = parse(arguments)
    rows = run_performers(args, run_performer)
    for row in rows:
        wanted = [row[key] for key, asked in (("table", args.stages), ("figure_5", args.figure_5)) if asked]
        for text in wanted:
            print(f"{_name(row)}\n{text}\n")
    print(table(rows) + "\n")
    text, all_hold = verdict(rows)
    print(text)
    write_json(args, rows)
    return 0 if all_hold else 1


if __name__ == "__main__":
    sys.exit(main())
