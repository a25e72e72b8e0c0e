"""How far tracking gets without depth: synthetic performers scored against their truth, beside the same frames with depth.

    python data_synth/evaluate_colour_only.py [SEED ...] [--frames 150]
    python data_synth/evaluate_colour_only.py --take take.csv --seconds 70 80   # a real take in place of the script
    python data_synth/evaluate_colour_only.py --only "MediaPipe: colour, saved" # that row alone, in a few minutes

For every performer: features exact to half a pixel and detected by MediaPipe on the rendered pictures; the actor saved
from an RGB-D scan, the average head as it is, and the average head fitted to the features of the neutral frames, or
(detected ones) to those of the performance alone, in which no frame is neutral. Scored on one performance after 40
neutral frames: the head pose's error in degrees (median and 95 %) and millimetres, the active share of the
face's motion in the head frame (v1, v4), and of v4 in space, pose error included. Without depth the head's size and so
its distance are unknowable, which is why only the head frame's share says how good the expressions are. Report on seeds
of 1000 and above; nothing was tuned on them.
"""

from __future__ import annotations

import argparse
import dataclasses
from functools import lru_cache, partial

import numpy as np

from adaptiveface.evaluation import ErrorCollector
from adaptiveface.geometry.mesh import transform_points
from adaptiveface.landmarks import FeatureDetector
from adaptiveface.model.face_model import embedded_face_model
from adaptiveface.neutral.capture import build_actor, capture_actor
from adaptiveface.neutral.colour import capture_colour_actor
from adaptiveface.parameters import Parameters
from adaptiveface.pipeline import one_thread
from adaptiveface.synthetic.sensor import SyntheticSensor
from adaptiveface.synthetic.take import Take, read_take
from adaptiveface.tracking.colour_tracker import make_tracker

NEUTRAL = 40


def main() -> None:
    """Print one row per way of tracking and performer, then the means."""
    parser = argparse.ArgumentParser()
    parser.add_argument("seeds", nargs="*", type=int, default=[1000, 1001, 1002])
    parser.add_argument("--frames", type=int, default=150)
    parser.add_argument("--only", default="", help="only the rows whose name contains this, such as 'MediaPipe: colour, saved'")
    parser.add_argument("--take", help="a Live Link Face CSV to perform; tuned on its first 67 s, report on the rest")
    parser.add_argument("--seconds", type=float, nargs=2, default=(70.0, 80.0), help="which part of the take")
    args = parser.parse_args()
    take = read_take(args.take).part(*args.seconds) if args.take else None
    rows: dict[str, list[np.ndarray]] = {}
    titles = ("performer", "turn deg", "95 %", "shift mm", "face v1", "face v4", "with pose", "lips mm", "lost")
    print(f"{'':40}" + "".join(f"{title:>10}" for title in titles))
    for seed in args.seeds:
        with one_thread():
            for name, row in evaluate(seed, args.frames, take, args.only):
                rows.setdefault(name, []).append(row)
                print(f"{name:40}{seed:10d}" + _figures(row), flush=True)
    for name, values in rows.items():
        print(f"{name:40}{'mean':>10}" + _figures(np.mean(values, axis=0)))


def _figures(row: np.ndarray) -> str:
    shares = "".join(f"{value:10.3f}" for value in row[3:6])
    return f"{row[0]:10.2f}{row[1]:10.2f}{row[2]:10.1f}{shares}{row[6]:10.2f}{row[7]:10.1f}"


def evaluate(seed: int, count: int, take: Take | None = None, only: str = ""):
    """Yield (name, figures) for one performer, of the names that contain ``only``; :func:`_score` says which figures."""
    sensor = SyntheticSensor(seed, "truedepth", NEUTRAL, count, repeats=1, take=take)
    exact = list(sensor)
    detector = FeatureDetector()
    detected = [dataclasses.replace(frame, features=detector.detect(frame)) for frame in exact]
    average = build_actor(embedded_face_model(), embedded_face_model().mean)
    for kind, frames in (("exact", exact), ("MediaPipe", detected)):
        blind = [dataclasses.replace(f, depth=np.zeros_like(f.depth), colour=None) for f in frames]
        saved = lru_cache(partial(capture_actor, frames[:NEUTRAL]))
        ways = {
            "RGB-D, saved actor": (frames, saved, False),
            "colour, saved actor": (blind, saved, True),
            "colour, average head": (blind, lambda: average, True),
            "colour, fitted average head": (blind, partial(capture_colour_actor, blind[:NEUTRAL]), True),
        }
        if kind == "MediaPipe":  # the 40 features alone need neutral frames
            ways["colour, fitted to the performance"] = (blind, partial(capture_colour_actor, blind[NEUTRAL:]), True)
        for name, (seen, actor, colour_only) in ways.items():
            if only in f"{kind}: {name}":
                yield f"{kind}: {name}", _score(sensor, seen, actor(), colour_only)


def _score(sensor, frames, actor, colour_only: bool) -> np.ndarray:
    tracker, whole, face = make_tracker(actor, Parameters(), colour_only), *_collectors(sensor, actor)
    for frame in frames:
        tracked = tracker.track(frame)
        if frame.index < NEUTRAL:
            continue
        whole.add(tracked)
        if tracked.tracked:  # the same expression on the true pose
            pose = sensor.ground_truth(frame.index).head_pose @ face.alignment
            meshes = {stage: transform_points(pose, getattr(tracked, stage)) for stage in face.stages}
            face.score(frame.index, tracked.head_pose, meshes)
    whole, face = whole.finish(), face.finish()
    lips = face.region_error("v4", "lips", None)
    turn = np.percentile(whole.pose_angle, [50, 95])
    return np.array(
        [
            *turn,
            np.median(whole.pose_shift),
            face.active_share("v1", None),
            face.active_share("v4", None),
            whole.active_share("v4", None),
            lips,
            sum(whole.lost.values()),
        ]
    )


def _collectors(sensor, actor):
    return ErrorCollector(sensor, actor), ErrorCollector(sensor, actor)


if __name__ == "__main__":
    main()
