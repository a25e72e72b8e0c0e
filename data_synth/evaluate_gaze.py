"""How right the gaze from the detector's irises is on rendered performers that do a real take, whose gaze is known.

``python data_synth/evaluate_gaze.py TAKE.csv [SEED ...] [--wide] [--iris DEGREES]``, 15 s a performer. Shape and pose are the
true ones, so that all errors are those of irises, corners and eyeballs. ``--wide`` opens the lids throughout, ``--iris`` paints
smaller irises: both show more of them, and tell whether it is the lids that mislead the detector.
"""

from __future__ import annotations

import argparse
import dataclasses
from pathlib import Path
from types import SimpleNamespace

import numpy as np

from adaptiveface.geometry.frame import MEDIAPIPE_INDICES, Features2D
from adaptiveface.geometry.mesh import transform_points
from adaptiveface.insides import make_insides
from adaptiveface.insides.gaze import GazeEstimator
from adaptiveface.landmarks import FeatureDetector
from adaptiveface.livelink import ARKIT_NAMES
from adaptiveface.model.face_model import embedded_face_model
from adaptiveface.synthetic import paint
from adaptiveface.synthetic.sensor import SyntheticSensor
from adaptiveface.synthetic.take import Take, read_take

FRAMES = 48
_LIDS = ("eyeBlink", "eyeSquint", "cheekSquint")


def widened(take: Take) -> Take:
    """The take with lids that stay wide open."""
    curves = take.curves.copy()
    for column, name in enumerate(ARKIT_NAMES):
        curves[:, column] = 0.0 if name.startswith(_LIDS) else 1.0 if name.startswith("eyeWide") else curves[:, column]
    return dataclasses.replace(take, curves=curves)


def chosen(sensor: SyntheticSensor) -> np.ndarray:
    """Frames with open eyes that look evenly up and down."""
    level = dict(zip(sensor.performer.expression_names, np.transpose([a for a, _ in _activations(sensor)]), strict=True))
    up = level["eyeLookUpLeft"] - level["eyeLookDownLeft"]
    awake = np.flatnonzero(np.maximum(level["eyeBlinkLeft"], level["eyeBlinkRight"]) < 0.35)
    ordered = awake[np.argsort(up[awake])]
    return sensor.neutral_frames + np.unique(ordered[np.linspace(0, len(ordered) - 1, FRAMES).astype(int)])


def _activations(sensor: SyntheticSensor) -> list:
    return [sensor._activations(k) for k in range(sensor.neutral_frames, len(sensor))]


def measured(sensor: SyntheticSensor, detector: FeatureDetector) -> tuple[np.ndarray, np.ndarray]:
    """Measured and true gaze (K, 2): yaw and pitch, degrees, mean of both eyes."""
    model = embedded_face_model()
    names = ("triangles", "feature_triangles", "feature_weights")
    actor = SimpleNamespace(neutral=sensor.performer.neutral, **{name: getattr(model, name) for name in names})
    estimator = GazeEstimator(actor)
    found, true = [], []
    for index in chosen(sensor):
        frame, truth = sensor.read(int(index)), sensor.ground_truth(int(index))
        for face in detector.detect_faces(frame.colour)[:1]:
            features = Features2D(face.mesh[MEDIAPIPE_INDICES, :2], np.full(len(MEDIAPIPE_INDICES), 0.3), face)
            skin = transform_points(np.linalg.inv(truth.head_pose), truth.vertices)
            found.append(estimator.measure(skin, truth.head_pose, frame.camera, features).mean(axis=0))
            ahead = np.mean([turn[:, 2] for turn in sensor._gaze(truth.activations)], axis=0)
            true.append([np.arctan2(ahead[0], ahead[2]), np.arcsin(ahead[1] / np.linalg.norm(ahead))])
    known = np.isfinite(found).all(axis=1)
    return np.degrees(found)[known], np.degrees(true)[known]


def eyeballs_off(sensor: SyntheticSensor) -> np.ndarray:
    """(2, 3) mm: where the eyeballs that are fitted to the performer's skin stand, less where they are."""
    performer = sensor.performer
    return make_insides(performer.neutral, embedded_face_model().triangles).eye_centres - performer.eye_centres


def main() -> None:
    """Print a table: per performer and direction correlation, gain, value at a gaze straight ahead, and error."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("take", type=Path)
    parser.add_argument("seeds", nargs="*", type=int, default=list(range(1007, 1013)))
    parser.add_argument("--wide", action="store_true")
    parser.add_argument("--iris", type=float, metavar="DEGREES")
    args = parser.parse_args()
    if args.iris:
        paint._PUPIL, paint._IRIS = 0.39 * args.iris, args.iris
    take = widened(read_take(args.take)) if args.wide else read_take(args.take)
    detector = FeatureDetector()
    print("performer, frames, direction: correlation, gain, measured when straight ahead, root mean square error")
    for seed in args.seeds:
        sensor = SyntheticSensor(seed, noise="none", take=take)
        found, true = measured(sensor, detector)
        for axis, name in enumerate(("yaw", "pitch")):
            gain, ahead = np.polyfit(true[:, axis], found[:, axis], 1)
            error = np.sqrt(((found - true)[:, axis] ** 2).mean())
            correlation = np.corrcoef(true[:, axis], found[:, axis])[0, 1]
            print(f"{seed} {len(found)} {name}: {correlation:.2f}, {gain:.2f}, {ahead:+.1f} degrees, {error:.1f} degrees")
        left, right = eyeballs_off(sensor)[:, 1]
        print(f"{seed} eyeballs stand {left:+.1f} and {right:+.1f} mm too high", flush=True)
    detector.close()


if __name__ == "__main__":
    main()
