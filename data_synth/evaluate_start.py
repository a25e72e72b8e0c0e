"""Whether it matters how a recording starts: the same performance after a neutral start and after a smiling one.

    python data_synth/evaluate_start.py [SEED ...] [--ways colour live depth] [--frames 150]
    python data_synth/evaluate_start.py --take take.csv --seconds 70 80        # a real take in place of the script

A performer turns the head for 40 frames, with a face at rest or smiling throughout; then the same frames follow, so that
whatever differs comes from the start. Features are detected by MediaPipe. What captures the head:

colour   ``capture_source`` without depth: frames from all over the recording, as ``adaptiveface track video.mp4`` does
live     the frames of the start alone, without depth, as ``adaptiveface live webcam`` does
depth    ``capture_source`` with depth and 40 neutral frames, as ``adaptiveface track RECORDING`` does

Printed for each: by how much the two heads differ over the face after alignment, root mean square, mm; by how much the
coefficients of the performance differ, root mean square over frames and expressions; and how far each head is from the
true one, mm, after alignment and, without depth, which cannot tell it, at the true size. Report on seeds of 1000 and
above; nothing was tuned on them.
"""

from __future__ import annotations

import argparse
import dataclasses
from collections.abc import Sequence

import numpy as np

from adaptiveface.geometry.frame import RgbdFrame
from adaptiveface.geometry.mesh import rigid_alignment, transform_points
from adaptiveface.geometry.source import NumberedFrames
from adaptiveface.landmarks import FeatureDetector
from adaptiveface.pipeline import capture_source, one_thread, track_source
from adaptiveface.synthetic.script import EMOTIONS, unit_vector
from adaptiveface.synthetic.sensor import SyntheticSensor
from adaptiveface.synthetic.take import Take, read_take

#: Frames of the start.
START = 40
WAYS = ("colour", "live", "depth")


class SmilingSensor(SyntheticSensor):
    """A performer who smiles, now more and now less, where others are neutral."""

    def _activations(self, index: int) -> tuple[np.ndarray, int]:
        activations, part = super()._activations(index)
        if index >= self.neutral_frames:
            return activations, part
        smile = unit_vector(EMOTIONS["happiness"], self.performer.expression_names)
        return (0.85 + 0.15 * np.sin(index / 5.0)) * smile, part


@dataclasses.dataclass(frozen=True)
class Frames(NumberedFrames):
    """A source of ``frames``, which bring their features."""

    name: str
    frames: Sequence[RgbdFrame]
    colour_only: bool

    def __len__(self) -> int:
        return len(self.frames)

    def read(self, index: int) -> RgbdFrame:
        """Frame ``index``; without depth and its picture where there is no depth camera."""
        frame = self.frames[index]
        return dataclasses.replace(frame, depth=np.zeros((1, 1), np.float32), colour=None) if self.colour_only else frame


def main() -> None:
    """Print one row per performer and way, then the means."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("seeds", nargs="*", type=int, default=[1000, 1001, 1002])
    parser.add_argument("--ways", nargs="+", choices=WAYS, default=list(WAYS))
    parser.add_argument("--frames", type=int, default=150)
    parser.add_argument("--take", help="a Live Link Face CSV to perform")
    parser.add_argument("--seconds", type=float, nargs=2, default=(70.0, 80.0), help="which part of the take")
    args = parser.parse_args()
    take = read_take(args.take).part(*args.seconds) if args.take else None
    print(f"{'way':8}{'performer':>10}{'heads mm':>10}{'coeff.':>10}{'neutral to truth':>20}{'smile to truth':>20}")
    rows: dict[str, list] = {way: [] for way in args.ways}
    for seed in args.seeds:
        neutral, smiling, truth = observe(seed, args.frames, take)
        for way in args.ways:
            with one_thread():
                row = compare(way, neutral, smiling, truth)
            rows[way].append(row)
            print(f"{way:8}{seed:10d}" + _figures(row), flush=True)
    for way, values in rows.items():
        print(f"{way:8}{'mean':>10}" + _figures(np.mean(values, axis=0)))


def _figures(row: Sequence[float]) -> str:
    return f"{row[0]:10.2f}{row[1]:10.3f}{row[2]:20.2f}{row[3]:20.2f}"


def observe(seed: int, count: int, take: Take | None) -> tuple[list[RgbdFrame], list[RgbdFrame], np.ndarray]:
    """The frames with the neutral start, those with the smiling one, and the true neutral head (V, 3), mm."""
    options = dict(noise="truedepth", neutral_frames=START, frames=count, repeats=1, take=take)
    calm, smiling = SyntheticSensor(seed, **options), SmilingSensor(seed, **options)
    detector = FeatureDetector()

    def seen(sensor: SyntheticSensor, index: int) -> RgbdFrame:
        frame = sensor.read(index)
        return dataclasses.replace(frame, features=detector.detect(frame))

    smiles = [seen(smiling, index) for index in range(START)]
    frames = [seen(calm, index) for index in range(len(calm))]
    detector.close()
    return frames, smiles + frames[START:], calm.performer.neutral


def compare(way: str, neutral: list[RgbdFrame], smiling: list[RgbdFrame], truth: np.ndarray) -> tuple[float, ...]:
    """Difference of the heads, of the coefficients, and both heads' distances from the ``truth`` (V, 3)."""
    colour_only = way != "depth"
    frames_of_neutral = range(START) if way == "live" else START
    actors, coefficients = [], []
    for name, frames in (("neutral start", neutral), ("smiling start", smiling)):
        source = Frames(name, frames, colour_only)
        actors.append(capture_source(source, neutral_frames=frames_of_neutral))
        coefficients.append(track_source(source, actors[-1]).coefficients[START:])
    first, second = actors
    face = first.frontal
    return (
        difference(first.neutral[face], second.neutral[face]),
        float(np.sqrt(np.mean((coefficients[0] - coefficients[1]) ** 2))),
        *(difference(actor.neutral[face], truth[face], scaled=colour_only) for actor in actors),
    )


def difference(head: np.ndarray, other: np.ndarray, scaled: bool = False) -> float:
    """Root mean square distance, mm, of points (n, 3) from ``other`` (n, 3) after alignment, of its size if ``scaled``."""
    if scaled:
        spread = [np.sqrt(((points - points.mean(axis=0)) ** 2).sum()) for points in (head, other)]
        head = head * spread[1] / spread[0]
    aligned = transform_points(rigid_alignment(head, other), head)
    return float(np.sqrt(((aligned - other) ** 2).sum(axis=1).mean()))


if __name__ == "__main__":
    main()
