"""What MediaPipe's landmarks do as a jaw opens and as a head turns: adds ``opened`` to assets/landmarks.npz, prints gains.

    python data_synth/measure_detector.py --take take.csv [--cache /tmp/opened]    # after place_landmarks.py; a minute

Development performers are rendered with known heads, poses and expressions: real ones (the first half of a Live Link Face
take) with the jaw opened by a known amount besides. As a jaw opens, the detector leaves the landmarks of the chin behind:
what is proportional to the opening is ``opened``. With that taken out, poses are found from the true surface and the
detected landmarks. By how much more or less they turn than the truth does is what ``TURN`` and ``NOD`` in
``adaptiveface/model/feature_set.py`` say.
"""

from __future__ import annotations

import argparse
import copy
from dataclasses import replace
from pathlib import Path

import numpy as np
from observe import observe

from adaptiveface.files.records import arrays
from adaptiveface.geometry.mesh import transform_points
from adaptiveface.model.face_model import FaceModel, embedded_face_model
from adaptiveface.model.feature_set import FeatureSet, landmark_set, pitch_of, yaw_of
from adaptiveface.registration.step import apply_rigid_update
from adaptiveface.synthetic.script import HeadMotion
from adaptiveface.synthetic.sensor import SyntheticSensor
from adaptiveface.synthetic.take import Take, read_take
from adaptiveface.tracking.feature_rows import turns

#: Development performers: nothing is reported on them.
SEEDS = tuple(range(2003, 2013))
OUT = Path(__file__).parents[1] / "adaptiveface" / "assets" / "landmarks.npz"
TAKE_SECONDS = 66.0
#: Frames of a performer, of which the first are at rest; largest yaw, pitch and roll, degrees.
FRAMES, REST, TURNS = 24, 4, (25.0, 15.0, 8.0)
#: Frames that are left out, since the head begins to move slowly.
BEGINNING = 60
#: So much of it is taken: people differ. With all of it the heads of performers 12 and 2000 tipped back as they opened the
#: jaw: 4.3 degrees off at 95 % on the latter, 3.6 with a half, 3.5 with none, but then their chins were off more.
TAKEN = 0.5
#: Errors beyond this count no more, mm.
OUTLIER = 8.0


def performer(seed: int, take: Take, model: FaceModel, cache: Path | None):
    """What :func:`observe` returns of a performer; the jaw's opening (K,) of its frames; the camera."""
    sensor = SyntheticSensor(seed, "none", 0, BEGINNING + FRAMES, 1, feature_noise=0.0, model=model)
    rng = np.random.default_rng([seed, 78])
    jaw = sensor.performer.expression_names.index("jawOpen")
    real = take.activations(sensor.performer.expression_names, sensor.fps)
    script = real[rng.permutation(len(real))[:FRAMES]]
    script[:, jaw] = rng.uniform(0, 1, FRAMES)
    script[:REST] = 0.0
    turns = rng.uniform(-1, 1, (FRAMES, 3)) * TURNS
    sensor.script = np.concatenate([np.zeros((BEGINNING, script.shape[1])), script])
    sensor._motion = HeadMotion(seed, 0, sensor.fps, 600.0, turns=np.concatenate([np.zeros((BEGINNING, 3)), turns]))
    frames = range(BEGINNING, BEGINNING + FRAMES)
    data = observe(sensor, frames, None if cache is None else cache / f"{seed}.npz")
    return data, script[data["index"] - BEGINNING, jaw], sensor.camera


class Frames:
    """All performers: ``detected`` (K, L, 2) px of the landmarks, ``pose`` (K, 4, 4), ``points`` (K, L, 3) head frame,
    ``opening`` (K,), ``who`` (K,), ``camera``."""

    def __init__(self, landmarks: FeatureSet, take: Take, model: FaceModel, cache: Path | None) -> None:
        parts = []
        for number, seed in enumerate(SEEDS):
            data, opening, self.camera = performer(seed, take, model, cache)
            back = np.linalg.inv(data["rigid"])
            points = [
                landmarks.points(transform_points(b, v.astype(float))) for b, v in zip(back, data["vertices"], strict=True)
            ]
            who = np.full(len(opening), number)
            parts.append((data["mesh"][:, landmarks.ids, :2], data["rigid"], np.array(points), opening, who))
        columns = (np.concatenate(part) for part in zip(*parts, strict=True))
        self.detected, self.pose, self.points, self.opening, self.who = columns

    def select(self, chosen: np.ndarray) -> Frames:
        """The same of the landmarks ``chosen`` (L,) only."""
        out = copy.copy(self)
        out.detected, out.points = self.detected[:, chosen], self.points[:, chosen]
        return out

    def across(self, k: int) -> np.ndarray:
        """(2, 3): a shift in the head frame as it is seen across the view of frame k, mm."""
        ray = self.pose[k, :2, 3] / self.pose[k, 2, 3]
        return self.pose[k, :2, :3] - ray[:, None] * self.pose[k, 2, :3]


def measured_opening(frames: Frames, landmarks: FeatureSet) -> np.ndarray:
    """(L, 3) mm per opening: what of the errors grows with it, beside a constant of each person."""
    count, people, camera = len(landmarks), frames.who.max() + 1, frames.camera
    error = np.array(
        [
            (found - landmarks.slides(pose, camera, points) - camera.project(transform_points(pose, points))) / camera.fx
            for found, pose, points in zip(frames.detected, frames.pose, frames.points, strict=True)
        ]
    )
    error *= np.einsum("ki,kli->kl", frames.pose[:, 2, :3], frames.points)[..., None] + frames.pose[:, None, 2, 3, None]
    rows = np.zeros((len(frames.who), 2, 3 + 3 * people))
    for k, person in enumerate(frames.who):
        seen = frames.across(k)
        rows[k, :, :3] = frames.opening[k] * seen
        rows[k, :, 3 * (person + 1) : 3 * (person + 2)] = seen
    out = np.zeros((count, 3))
    for landmark in range(count):
        values = error[:, landmark]
        solution = np.zeros(rows.shape[2])
        for _ in range(5):  # robust; a ridge of a few frames, since what the views do not tell is zero
            off = ((values - rows @ solution) ** 2).sum(axis=1)
            weighted = rows / (1.0 + off / OUTLIER**2)[:, None, None]
            h = np.einsum("kia,kib->ab", weighted, rows) + 5.0 * np.eye(rows.shape[2])
            solution = np.linalg.solve(h, np.einsum("kia,ki->a", weighted, values))
        out[landmark] = solution[:3]
    return out


def pose_from(landmarks: FeatureSet, frames: Frames, k: int) -> np.ndarray:
    """(4, 4) the pose at which the true points of frame k explain the detected ones best."""
    pose, camera, points = frames.pose[k], frames.camera, frames.points[k]
    for _ in range(5):
        seen = frames.detected[k] - landmarks.slides(frames.pose[k], camera, points, float(frames.opening[k]))
        moved = transform_points(pose, points)
        shown = moved[:, :2] / moved[:, 2:]
        error = (shown - (seen - [camera.cx, camera.cy]) / [camera.fx, camera.fy]) * moved[:, 2:]
        across = np.zeros((len(points), 2, 3))
        across[:, 0, 0] = across[:, 1, 1] = 1.0
        across[:, :, 2] = -shown
        turn = turns(moved - moved.mean(axis=0), across)
        jacobian = np.concatenate([turn, across], axis=2)
        weight = landmarks.trust(pose)
        weighted = jacobian * (weight / (1.0 + (error**2).sum(axis=1) * weight / 9.0))[:, None, None]
        h, g = np.einsum("fri,frj->ij", weighted, jacobian), -np.einsum("fri,fr->i", weighted, error)
        pose = apply_rigid_update(pose, np.linalg.solve(h, g), moved.mean(axis=0))
    return pose


def gains(landmarks: FeatureSet, frames: Frames) -> np.ndarray:
    """(P, 2) of every person: what the found yaw and pitch have in excess of the true ones, per degree."""
    found = [pose_from(landmarks, frames, k) for k in range(len(frames.who))]
    angles = [np.array([[yaw_of(pose), pitch_of(pose)] for pose in poses]) for poses in (found, frames.pose)]
    excess, true = angles[0] - angles[1], angles[1]
    people = [frames.who == person for person in np.unique(frames.who)]
    return np.array([[np.polyfit(true[mine, i], excess[mine, i], 1)[0] for i in range(2)] for mine in people])


def main() -> None:
    """Write ``opened``, and print what it is and the gains with it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--take", type=Path, required=True, help="a Live Link Face CSV of a person doing every expression")
    parser.add_argument("--cache", type=Path, help="folder that keeps the landmarks of every performer")
    args = parser.parse_args()
    landmarks, take = landmark_set(), read_take(args.take).part(0.0, TAKE_SECONDS)
    frames = Frames(landmarks, take, embedded_face_model(), args.cache)
    landmarks = replace(landmarks, opened=TAKEN * measured_opening(frames, landmarks))
    np.savez_compressed(OUT, **arrays(landmarks))
    for region in dict.fromkeys(landmarks.regions.tolist()):
        x, y, z = landmarks.opened[landmarks.regions == region].mean(axis=0)
        print(f"{region:9} left behind by an open jaw: {x:+.1f} {y:+.1f} {z:+.1f} mm")
    left = gains(landmarks.fitted, frames.select(~landmarks.held_out))
    print("excess of yaw and of pitch beyond TURN and NOD, per person:")
    print(np.array2string(left.T, precision=2))
    print(f"mean {np.round(left.mean(axis=0), 3)}, deviation {np.round(left.std(axis=0), 3)}")


if __name__ == "__main__":
    main()
