"""Detected 2D features against exact ones: their pixel error per group, and what they cost the tracked face.

    python data_synth/evaluate_features.py                              # what is reported: seeds 1000 to 1002
    python data_synth/evaluate_features.py --seeds 3 12 --cache /tmp/f  # while developing: seeds below 100
    python data_synth/evaluate_features.py --skin                       # detected features without and with dense skin
    python data_synth/evaluate_features.py --skin --looks               # the same in other skins, lights and cameras
    python data_synth/evaluate_features.py --take take.csv              # a real take in place of the script

Each performer's colour pictures are rendered and searched by MediaPipe. The face is captured and tracked twice on the
same depth frames: with the detected features (refined by the pictures, unless --set refinement.on=false), and with the
exact pixels of the truth (hidden ones left out). Figures of v4 are in mm, on the second performance of the script, but for
the active share.

Two tables: motion errors as everywhere, with the actor's head laid onto the true one by the vertices of both neutrals; and,
for comparison, with the head where the frames of the resting face were tracked, so that vertices that slid along the skin
of the forehead or the cheeks in the neutral do not count at the lips (``metrics.tracked_alignment``). Exit status 1 when, by
the first, the mean over the performers of any figure is more than 25 % worse with detected features.

``--looks`` takes names of looks as sources have them (``skin=oily:light=moving``), without any all of ``LOOKS``. Then a last
table has a row for each, and says by how much figures with dense skin are worse in moving or changing light than in steady
light, and, where the skin has no texture, worse than without dense skin.

With a take there is one performance, and the figures are shares: the motion error in proportion to the motion, where skin
moves by more than 2 mm, of the whole face and of each region. Tuned on the take's first 67 s.
"""

from __future__ import annotations

import dataclasses
import os
import re
import sys
from pathlib import Path

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")  # before NumPy is loaded: every process takes one core

import numpy as np  # noqa: E402
from performer_runs import run_parser, run_performers, write_json  # noqa: E402

from adaptiveface.evaluation import FIRST, REPEAT, ErrorCollector, tracked_alignment  # noqa: E402
from adaptiveface.geometry.frame import FEATURE_REGIONS, DetectedFace, Features2D, RgbdFrame  # noqa: E402
from adaptiveface.landmarks import FeatureDetector, Upright  # noqa: E402
from adaptiveface.model.actor import Actor  # noqa: E402
from adaptiveface.neutral.capture import capture_actor  # noqa: E402
from adaptiveface.parameters import Parameters  # noqa: E402
from adaptiveface.synthetic.look import parse_performer  # noqa: E402
from adaptiveface.synthetic.sensor import SyntheticSensor  # noqa: E402
from adaptiveface.synthetic.take import read_take  # noqa: E402
from adaptiveface.tracking.tracker import FaceTracker  # noqa: E402

REPORTING_SEEDS = (1000, 1001, 1002)
GROUPS = ("lips", "eyes", "brows")
#: By what the actor's head is laid onto the true one; the first, as everywhere else, is judged.
PLACEMENTS = ("all vertices", "the neutral frames")
FIGURES = ("surface_p95", "active_share", "lips", "eyes", "brows")
#: Two ways to track that are compared: the features and what is set for each.
EXACT_DETECTED = {"exact": ("exact", {}), "detected": ("detected", {})}
SKIN = {"without": ("detected", {"skin__on": False}), "with": ("detected", {"skin__on": True})}
SKIN_FIGURES = (*FIGURES, "cheeks", "chin", "tangential")
#: Skins in steady light, of which one has no texture; then the same in other light. "": the drawn skin before a plain camera.
LOOKS = (
    "",
    "skin=even",
    *(f"skin={skin}:camera=video" for skin in ("freckled", "bearded", "made-up", "oily")),
    *(f"skin={skin}:light=moving:camera=video" for skin in ("freckled", "oily")),
    "skin=freckled:light=changing:camera=video",
)
#: What must not be worse in other light or without texture.
HELD = ("active_share", "lips", "tangential", "surface_p95")
TAKE_FIGURES = ("active_share", "lips_share", "eyes_share", "cheeks_share", "chin_share", "lips")
#: v4 with detected features may be this much worse than with exact ones.
TOLERANCE = 0.25


class Frames:
    """Every frame of a sensor as {"exact": frame, "detected": frame}; with ``folder`` the pictures are searched once."""

    def __init__(self, sensor: SyntheticSensor, detector: FeatureDetector | None, folder: Path | None) -> None:
        self.sensor, self.detector = sensor, detector
        name = "-".join(re.findall(r"[\w.]+", sensor.name))
        look = str(sensor.look).replace(":", "-")
        self.folder = None if folder is None else folder / f"features-{name}-{len(sensor)}{look and '-'}{look}"
        if self.folder is not None:
            self.folder.mkdir(parents=True, exist_ok=True)

    def __getitem__(self, index: int) -> dict[str, RgbdFrame]:
        kept = None if self.folder is None else self.folder / f"{index}.npz"
        if kept is not None and kept.exists():
            data = np.load(kept, allow_pickle=False)
            depth, colour = data["depth"], data["colour"]
            face = DetectedFace(data["mesh"], data["scores"]) if len(data["mesh"]) else None
            pairs = {"exact": Features2D(*_split(data["exact"])), "detected": Features2D(*_split(data["detected"]), face)}
        else:
            frame = self.sensor.read(index)
            detected = self.detector.detect(frame)
            unseen = Features2D(np.full((40, 2), np.nan), np.zeros(40))
            depth, colour = frame.depth, frame.colour
            pairs = {"exact": frame.features, "detected": detected or unseen}
            if kept is not None:
                tables = {name: np.column_stack([f.pixels, f.confidence]) for name, f in pairs.items()}
                face = pairs["detected"].face or DetectedFace(np.zeros((0, 3)), np.zeros(0))
                np.savez_compressed(kept, depth=depth, colour=colour, mesh=face.mesh, scores=face.scores, **tables)
        plain = RgbdFrame(depth, self.sensor.camera, colour, index, index / self.sensor.fps)
        return {name: dataclasses.replace(plain, features=features) for name, features in pairs.items()}


def _split(table: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return table[:, :2], table[:, 2]


def run_performer(seed: int, noise: str, options: dict) -> dict:
    """One performer with one depth noise; returns its row: v4 with either kind of features, pixel errors."""
    neutral = options["neutral_frames"]
    look = parse_performer(":".join(filter(None, (str(seed), noise, options["look"]))))[2]
    take = None if options["take"] is None else read_take(options["take"]).part(*options["seconds"])
    sensor = SyntheticSensor(seed, noise, neutral, options["frames"], repeats=2, feature_noise=0.0, look=look, take=take)
    frames, parameters = Frames(sensor, FeatureDetector(), options["cache"]), Parameters().replace(**options["set"])
    scan = [frames[index] for index in range(neutral)]
    runs, actors = {}, {}
    for name, (kind, changed) in (SKIN if options["skin"] else EXACT_DETECTED).items():
        if kind not in actors:
            actors[kind] = capture_actor([pair[kind] for pair in scan], parameters=parameters)
        runs[name] = Run(sensor, actors[kind], parameters.replace(**changed), neutral, kind)
    errors, found = [], 0
    for index in range(len(sensor)):
        pair = frames[index]
        for run in runs.values():
            run.add(pair[run.kind], scored=index % options["stride"] == 0)
        found += pair["detected"].features.valid.any()
        if index >= neutral:
            errors.append(np.where(pair["exact"].features.valid[:, None], _error(pair), np.nan))
    row = dict(seed=seed, noise=noise, look=options["look"], found=found / len(sensor), pixels=pixel_errors(np.array(errors)))
    for name, run in runs.items():
        scored = FIRST if take else REPEAT
        row[name] = {by: collector.finish().summary("v4", scored) for by, collector in run.collectors.items()}
        row[name]["searched"] = run.searched / len(sensor)
    return row


class _Found:
    """A detector that has looked at every frame already."""

    def detect(self, frame: RgbdFrame) -> Features2D | None:
        return frame.features


class Run:
    """One actor tracked by a ``kind`` of features, scored by either placement of the head: ``collectors``."""

    def __init__(self, sensor: SyntheticSensor, actor: Actor, parameters: Parameters, neutral: int, kind: str) -> None:
        self.sensor, self.actor, self.neutral, self.kind = sensor, actor, neutral, kind
        self.tracker, self.poses = FaceTracker(actor, parameters), []
        self.reader, self.searched = Upright(_Found()), 0
        self.collectors: dict[str, ErrorCollector] = {}

    def add(self, frame: RgbdFrame, scored: bool) -> None:
        """Track the next frame: of the neutral, to learn where the head is placed, then of the performance."""
        frame = self.reader.detect(frame)
        self.searched += frame.searched
        tracked = self.tracker.track(frame)
        self.reader.spare(self.tracker.detect_every)
        if frame.index < self.neutral:
            if tracked.tracked:
                self.poses.append((tracked.head_pose, self.sensor.ground_truth(frame.index).head_pose))
            return
        if not self.collectors:
            placed = tracked_alignment(*(np.array(poses) for poses in zip(*self.poses, strict=True)))
            for by, alignment in zip(PLACEMENTS, (None, placed), strict=True):
                self.collectors[by] = ErrorCollector(self.sensor, self.actor, ("v4",), alignment)
        if scored:
            for collector in self.collectors.values():
                collector.add(tracked)


def _error(pair: dict[str, RgbdFrame]) -> np.ndarray:
    return pair["detected"].features.pixels - pair["exact"].features.pixels


def pixel_errors(errors: np.ndarray) -> dict[str, dict[str, float]]:
    """Per group of features, from errors (F, 40, 2) px, NaN where hidden or not found.

    median, p95: length of the whole error; constant: median length of each feature's mean error, what a calibration
    can take out; noise, noise_p95: length of the rest.
    """
    mean = np.nanmean(errors, axis=0)
    whole, rest = np.linalg.norm(errors, axis=2), np.linalg.norm(errors - mean, axis=2)
    out = {}
    for group in (*GROUPS, "all"):
        chosen = np.ones(40, bool) if group == "all" else FEATURE_REGIONS == group
        out[group] = dict(
            median=float(np.nanmedian(whole[:, chosen])),
            p95=float(np.nanpercentile(whole[:, chosen], 95)),
            constant=float(np.nanmedian(np.linalg.norm(mean[chosen], axis=1))),
            noise=float(np.nanmedian(rest[:, chosen])),
            noise_p95=float(np.nanpercentile(rest[:, chosen], 95)),
        )
    return out


def report(rows: list[dict], skin: bool, take: bool = False) -> tuple[str, bool]:
    """The tables as text, and whether the means of detected features keep the tolerance (``skin``, ``take``: always)."""
    (first, second), figures = (SKIN, SKIN_FIGURES) if skin else (EXACT_DETECTED, TAKE_FIGURES if take else FIGURES)
    names = list(rows[0]["pixels"]["all"])
    lines = ["pixel error of detected features" + "".join(f"{name:>11}" for name in names)]
    for group in (*GROUPS, "all"):
        means = (np.mean([row["pixels"][group][name] for row in rows]) for name in names)
        lines.append(f"{group:<32}" + "".join(f"{value:>11.2f}" for value in means))
    means = {}
    for by in PLACEMENTS:
        heads = "".join(f"{name:>23}" for name in figures)
        lines += ["", f"v4, {first} / {second}; head placed by {by}", " " * 26 + heads + "   found"]
        total = []
        for row in rows:
            pairs = [(row[first][by][name], row[second][by][name]) for name in figures]
            total.append(pairs)
            lines.append(f"{row['seed']} {row['noise']:<20}" + _cells(pairs) + f"{row['found']:>8.1%}")
        means[by] = np.mean(total, axis=0)
        lines.append(f"{'mean':<26}" + _cells(means[by]))
    if skin or take:
        return "\n".join(lines), True
    worst, name = max((b / a - 1, name) for (a, b), name in zip(means[PLACEMENTS[0]], figures, strict=True))
    holds = worst <= TOLERANCE
    lines.append(f"{'pass' if holds else 'FAIL'}  detected at most {TOLERANCE:.0%} worse than exact: {name} {worst:+.0%}")
    return "\n".join(lines), holds


def report_looks(rows: list[dict]) -> str:
    """A table with a row for each look, the mean over its performers, without and with dense skin; and what got worse."""
    means = {}
    for look in dict.fromkeys(row["look"] for row in rows):
        here = [row for row in rows if row["look"] == look]
        pairs = [[(r["without"][PLACEMENTS[0]][f], r["with"][PLACEMENTS[0]][f]) for f in SKIN_FIGURES] for r in here]
        means[look] = dict(zip(SKIN_FIGURES, np.mean(pairs, axis=0), strict=True))
    heads = "".join(f"{name:>23}" for name in SKIN_FIGURES)
    lines = ["", f"v4, without / with, mean of the performers; head placed by {PLACEMENTS[0]}", f"{'look':<44}" + heads]
    lines += [f"{look or 'skin=drawn':<44}" + _cells(pairs.values()) for look, pairs in means.items()]
    for look, pairs in means.items():
        steady = means.get(":".join(part for part in look.split(":") if not part.startswith("light=")))
        if "light=" in look and steady is not None:
            against = ", ".join(f"{name} {pairs[name][1] / steady[name][1] - 1:+.0%}" for name in HELD)
            lines.append(f"{look}, against steady light: {against}")
        if "skin=even" in look:
            lines.append(f"{look}, against without: " + ", ".join(f"{n} {pairs[n][1] / pairs[n][0] - 1:+.1%}" for n in HELD))
    return "\n".join(lines)


def _cells(pairs) -> str:
    return "".join(f"{a:>8.3f} /{b:>6.3f} {b / a - 1:>+6.0%}" for a, b in pairs)


def main(arguments: list[str] | None = None) -> int:
    parser = run_parser(__doc__, REPORTING_SEEDS, ["truedepth"], stride=2, cache="depth and features of every frame")
    parser.add_argument("--skin", action="store_true", help="compare detected features without and with dense skin")
    parser.add_argument("--looks", nargs="*", metavar="LOOK", help="with --skin: looks of the performers; without names all")
    parser.add_argument("--take", type=Path, help="a Live Link Face CSV to perform")
    parser.add_argument("--seconds", type=float, nargs=2, default=(70.0, 80.0), help="which part of the take (default 70 80)")
    args = parser.parse_args(arguments)
    if args.looks is not None and not args.skin:
        parser.error("--looks compares dense skin: add --skin")
    rows, holds = [], True
    for look in [""] if args.looks is None else args.looks or LOOKS:
        args.look = look
        found = run_performers(args, run_performer)
        text, kept = report(found, args.skin, args.take is not None)
        print(f"{look}\n{text}\n" if look else text, flush=True)
        rows, holds = rows + found, holds and kept
    if args.looks is not None:
        print(report_looks(rows))
    write_json(args, rows)
    return 0 if holds else 1


if __name__ == "__main__":
    sys.exit(main())
