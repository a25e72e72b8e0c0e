"""Write a synthetic performance as a recording with exact ground truth.

    python data_synth/make_performance.py OUT [--seed 0] [--noise truedepth] [--frames 300] [--repeats 2] ...

OUT gets the layout of a recording (intrinsic.json, color/, depth/, timestamps.csv, features.csv) and ground_truth.npz:

    vertices (F, V, 3) float32 mm, camera frame     rigid (F, 4, 4) float32, head to camera
    neutral (V, 3) float32 mm, head frame           triangles (T, 3) int32
    activations (F, E) float32                      expression_names (E,)
    features (F, 40, 2) float32 exact pixels        performance (F,) int8: -1 neutral scan, 0 first, 1 repeat, ...

Seeds 0 to 99 are for development and tuning; report results on seeds of 1000 and above only.
"""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path

import numpy as np
from tqdm import tqdm

from adaptiveface.errors import AdaptiveFaceError
from adaptiveface.files.npz import write_npz
from adaptiveface.sensors.recording import RecordingWriter
from adaptiveface.synthetic.noise import DEPTH_SCALES
from adaptiveface.synthetic.sensor import SyntheticSensor


def make_performance(
    out: str | os.PathLike, sensor: SyntheticSensor, colour_format: str = "jpg", progress: bool = True
) -> None:
    """Write every frame of ``sensor`` and its ground truth to the folder ``out``.

    Raises :class:`FileFormatError` where ``out`` holds a recording already.
    """
    performer, truths = sensor.performer, []
    with RecordingWriter(out, sensor.camera, sensor.fps, sensor.depth_scale, colour_format) as writer:
        for index in tqdm(range(len(sensor)), desc=sensor.name, unit="frame", disable=not progress):
            writer.write(sensor.read(index))
            truths.append(sensor.ground_truth(index))
    names = {"vertices": "vertices", "rigid": "head_pose", "activations": "activations", "features": "features"}
    arrays = {key: np.array([getattr(truth, name) for truth in truths], np.float32) for key, name in names.items()}
    arrays["performance"] = np.array([truth.performance for truth in truths], np.int8)
    arrays["neutral"] = performer.neutral.astype(np.float32)
    arrays["triangles"] = performer.triangles.astype(np.int32)
    arrays["expression_names"] = np.array(performer.expression_names)
    write_npz(Path(out) / "ground_truth.npz", arrays, compressed=True)


def main(arguments: list[str] | None = None) -> int:
    """Command line; returns the exit status."""
    parser = argparse.ArgumentParser(description="Write a synthetic performance as a recording with ground truth.")
    parser.add_argument("out", type=Path, help="folder to write")
    parser.add_argument("--seed", type=int, default=0, help="performer, script, motion and noise (default 0)")
    parser.add_argument("--noise", choices=tuple(DEPTH_SCALES), default="structured-light")
    parser.add_argument("--neutral-frames", type=int, default=40)
    parser.add_argument("--frames", type=int, default=300, help="frames of one performance")
    parser.add_argument("--repeats", type=int, default=2, help="how often it is performed")
    parser.add_argument("--feature-noise", type=float, default=0.5, help="pixels per coordinate")
    parser.add_argument("--distance", type=float, default=600.0, help="mm")
    parser.add_argument("--colour-format", choices=("jpg", "png"), default="jpg")
    parser.add_argument("--no-colour", action="store_true", help="depth and features only")
    options = parser.parse_args(arguments)
    try:
        sensor = SyntheticSensor(
            options.seed,
            options.noise,
            options.neutral_frames,
            options.frames,
            options.repeats,
            feature_noise=options.feature_noise,
            colour=not options.no_colour,
            distance=options.distance,
        )
        make_performance(options.out, sensor, options.colour_format)
    except AdaptiveFaceError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
