"""What learning brings: on a repeat, one minute after an expression was learned, and to known coefficients.

    python data_synth/evaluate_learning.py --study repeat                       # seeds 1000 to 1002 are reported
    python data_synth/evaluate_learning.py --study minute --seeds 2000 2001      # while developing: other seeds
    python data_synth/evaluate_learning.py --study known --variants on "off: adaptive_pca.learn=false"

Studies:

repeat
    The performance of `evaluate_performers.py`, first and second time.
minute
    An open smile three times; a minute of everything but smiles; an open smile again. Scored are the first time, the third
    time (just learned), and the one after the minute.
known
    Known coefficients of the 23 generic expressions, performed twice: root mean square error of the coefficients.

All variants, each a name and parameters that differ from the defaults, track the same frames with the same actor.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from types import SimpleNamespace

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")  # before NumPy is loaded: every process takes one core

import numpy as np  # noqa: E402
from evaluate_performers import NOISES, CachedFrames  # noqa: E402
from performer_runs import run_parser, run_performers, write_json  # noqa: E402

from adaptiveface.evaluation import ErrorCollector, Evaluation  # noqa: E402
from adaptiveface.evaluation.coefficients import known_performance  # noqa: E402
from adaptiveface.neutral.capture import capture_actor  # noqa: E402
from adaptiveface.parameters import Parameters  # noqa: E402
from adaptiveface.synthetic.script import GESTURES, Event, performance, unit_vector  # noqa: E402
from adaptiveface.synthetic.sensor import SyntheticSensor  # noqa: E402
from adaptiveface.tracking.tracker import FaceTracker  # noqa: E402
from adaptiveface.tracking.types import SampleState, TrackedFrame  # noqa: E402

REPORTING_SEEDS = (1000, 1001, 1002)
VARIANTS = (
    "nothing: adaptive_pca.learn=false",
    "newest: adaptive_pca.buffer=newest, personal_blendshapes.on=false",
    "distinct: personal_blendshapes.on=false",
    "personal",
)
#: Frames of one open smile.
SMILE = 40
#: What the minute between goes without.
SMILING = ("mouthSmile", "cheekSquint", "mouthDimple")


def changed(variant: str) -> tuple[str, dict[str, str]]:
    """Name and parameters of "name: stage.name=value, stage.name=value"."""
    name, _, settings = variant.partition(":")
    pairs = (entry.strip().partition("=") for entry in settings.split(",") if entry.strip())
    return name.strip(), {key: value for key, _, value in pairs}


# ---- the performances ----------------------------------------------------------------------------------------------
def repeat_sensor(seed: int, noise: str, options: dict) -> tuple[SyntheticSensor, dict[str, range]]:
    """The usual performance twice; the parts to score, as frame numbers."""
    start, count = options["neutral_frames"], options["frames"]
    sensor = SyntheticSensor(seed, noise, neutral_frames=start, frames=count, repeats=2, colour=False)
    return sensor, {"first": range(start, start + count), "repeat": range(start + count, start + 2 * count)}


def minute_sensor(seed: int, noise: str, options: dict) -> tuple[SyntheticSensor, dict[str, range]]:
    """Three open smiles, ``minute`` frames of everything else, another open smile; the parts to score."""
    start, between = options["neutral_frames"], options["minute"]
    sensor = SyntheticSensor(seed, noise, neutral_frames=start, frames=300, repeats=1, colour=False)
    names = sensor.performer.expression_names
    smile = Event(4, 10, 12, 10, unit_vector(GESTURES["open smile"], names)).level(np.arange(SMILE))
    smile = np.outer(smile, unit_vector(GESTURES["open smile"], names))
    rounds = [performance(seed + 100_000 * k, names, 300) for k in range(1, -(-between // 300) + 1)]
    others = np.concatenate(rounds)[:between] if rounds else np.zeros((0, len(names)))
    others[:, [name.startswith(SMILING) for name in names]] = 0.0
    sensor.script = np.concatenate([smile, smile, smile, others, smile])
    sensor.frames = len(sensor.script)
    after = start + 3 * SMILE + between
    parts = {"first": start, "just learned": start + 2 * SMILE, "a minute later": after}
    return sensor, {name: range(begin, begin + SMILE) for name, begin in parts.items()}


def known_sensor(seed: int, noise: str, options: dict) -> tuple[SyntheticSensor, dict[str, range]]:
    """Known coefficients twice; ``truth`` (frames, A) is an attribute of the sensor."""
    sensor, parts = repeat_sensor(seed, noise, options)
    known, truth = known_performance(sensor, options["frames"], options["neutral_frames"])
    known.repeats, known.truth = 2, truth
    return known, parts


SENSORS: dict[str, Callable[[int, str, dict], tuple[SyntheticSensor, dict[str, range]]]] = {
    "repeat": repeat_sensor,
    "minute": minute_sensor,
    "known": known_sensor,
}


# ---- one performer -------------------------------------------------------------------------------------------------
def run_performer(seed: int, noise: str, options: dict) -> dict:
    """All variants over the same frames. Returns one row of figures per variant and part."""
    sensor, parts = SENSORS[options["study"]](seed, noise, options)
    frames, neutral = CachedFrames(sensor, options["cache"]), options["neutral_frames"]
    parameters = Parameters().replace(**options["set"])
    actor = capture_actor([frames.read(i) for i in range(neutral)], parameters=parameters)
    runs = {}
    for name, values in map(changed, options["variants"]):
        tracker = FaceTracker(actor, parameters.replace(**values))
        runs[name] = SimpleNamespace(tracker=tracker, scores=ErrorCollector(sensor, actor, ("v4",)), frames=[], x=[])
    wanted = {index for part in parts.values() for index in part[:: options["stride"]]}
    for index in range(len(sensor)):
        frame = frames.read(index)
        for run in runs.values():
            follow(run, run.tracker.track(frame), index in wanted)
    rows = [row for name, run in runs.items() for row in part_rows(name, run, parts, sensor)]
    return dict(seed=seed, noise=noise, rows=rows)


def follow(run: SimpleNamespace, tracked: TrackedFrame, wanted: bool) -> None:
    """Take note of one frame of one variant."""
    run.frames.append((tracked.sample_state is SampleState.LEARNED, sum(tracked.stage_ms.values())))
    run.x.append((tracked.coefficients_initial, tracked.coefficients))
    if wanted:
        run.scores.add(tracked)


def part_rows(name: str, run: SimpleNamespace, parts: dict[str, range], sensor: SyntheticSensor) -> Iterator[dict]:
    """The figures of one variant in each part of the performance."""
    learned, ms = np.array(run.frames, float).T
    evaluation: Evaluation = run.scores.finish()
    number = np.full(len(sensor), -1)
    for k, part in enumerate(parts.values()):
        number[part] = k
    evaluation = replace(evaluation, performance=number[evaluation.index])
    for k, (label, part) in enumerate(parts.items()):
        row = dict(variant=name, part=label, **evaluation.summary("v4", k), ms=float(np.median(ms)), learned=learned.mean())
        if hasattr(sensor, "truth"):
            initial, resolved = np.array([run.x[i] for i in part]).transpose(1, 0, 2)
            truth = sensor.truth[: len(part)]
            row.update(initial=rms(initial - truth), resolved=rms(resolved - truth))
        yield row


def rms(error: np.ndarray) -> float:
    """Root mean square of all entries."""
    return float(np.sqrt(np.mean(error**2)))


# ---- the table -----------------------------------------------------------------------------------------------------
_COLUMNS = (
    ("active_share", "active", ".4f"),
    ("lips", "lips", ".4f"),
    ("eyes", "eyes", ".4f"),
    ("cheeks", "cheeks", ".4f"),
    ("tangential", "tangent.", ".3f"),
    ("surface_median", "median", ".4f"),
    ("surface_p95", "p95", ".4f"),
    ("initial", "initial x", ".4f"),
    ("resolved", "resolved", ".4f"),
    ("learned", "learned", ".0%"),
    ("ms", "ms", ".1f"),
)


def table(performers: list[dict]) -> str:
    """Means over the performers, one line per variant and part; mm, but for shares and coefficients."""
    rows = [row for performer in performers for row in performer["rows"]]
    columns = [column for column in _COLUMNS if column[0] in rows[0]]
    lines = [f"{'variant':<16}{'part':<16}" + "".join(f"{label:>10}" for _, label, _ in columns)]
    for variant, part in dict.fromkeys((row["variant"], row["part"]) for row in rows):
        chosen = [row for row in rows if (row["variant"], row["part"]) == (variant, part)]
        means = (f"{np.mean([row[key] for row in chosen]):>10{form}}" for key, _, form in columns)
        lines.append(f"{variant:<16}{part:<16}" + "".join(means))
    return "\n".join(lines)


def main(arguments: list[str] | None = None) -> int:
    parser = run_parser(__doc__, REPORTING_SEEDS, NOISES, stride=1, cache="the rendered frames (about 130 MB per performer)")
    parser.add_argument("--study", choices=sorted(SENSORS), default="repeat")
    parser.add_argument("--variants", nargs="+", default=list(VARIANTS), help='"name: stage.name=value, ..."')
    parser.add_argument("--minute", type=int, default=1800, help="frames between, in the study of that name (default 1800)")
    args = parser.parse_args(arguments)
    performers = run_performers(args, run_performer)
    if len(performers) > 1:
        for performer in performers:
            print(f"{performer['seed']} {performer['noise']}\n{table([performer])}\n")
    print(f"mean\n{table(performers)}")
    write_json(args, performers)
    return 0


if __name__ == "__main__":
    sys.exit(main())
