"""Which errors MediaPipe's landmarks share as a face moves: writes assets/shared_errors.npz.

    python data_synth/measure_shared_errors.py --take take.csv [--cache errors.npz]    # after measure_detector.py; 4 minutes

Development performers are rendered with known heads, poses and real expressions: frames of a Live Link Face take without its
seconds 68 to 84, on which reports are made. What a performer's landmarks are off in resting frames is taken off, because a
capture calibrates it. The rest of all performers has a covariance, whose first eigenvectors are the shared errors. Chin and jaw
have none: people's chins differ in how far the detector follows them, and the rest of the face would then be believed about a
mouth that opens.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from observe import gather

from adaptiveface.geometry.frame import DetectedFace, RgbdFrame
from adaptiveface.geometry.mesh import transform_points
from adaptiveface.model.feature_set import FeatureSet, landmark_set
from adaptiveface.synthetic.script import HeadMotion
from adaptiveface.synthetic.sensor import SyntheticSensor
from adaptiveface.synthetic.take import Take, read_take

OUT = Path(__file__).parents[1] / "adaptiveface" / "assets" / "shared_errors.npz"
#: Development performers: nothing is reported on them. Parts of the take, s.
SEEDS, PARTS = tuple(range(2030, 2060)), ((0, 68), (84, 134))
#: Frames of a performer, of which the first are at rest; largest yaw, pitch and roll, degrees.
FRAMES, REST, TURNS = 20, 4, (25.0, 13.0, 8.0)
#: Frames that are left out, since the head begins to move slowly.
BEGINNING = 60
#: Errors beyond this count no more, mm.
LARGEST = 8.0
#: Number of shared errors, and the share of their size that is taken, which depends on the region. Chosen on performers 2020 to
#: 2027 and two real videos: with more, the held-out noses and chins of these videos were off more.
MODES, TAKEN = 20, 0.5
REGIONS = {"chin": 0.0, "jaw": 0.0, "nose": 0.7}


def performer(seed: int, take: Take, landmarks: FeatureSet) -> dict[str, np.ndarray]:
    """Landmarks of a performer's K frames: ``number`` (K,), ``error`` (K, L, 2) mm across the view in the head's directions."""
    sensor = SyntheticSensor(seed, "none", 0, BEGINNING + FRAMES, 1, feature_noise=0.0)
    names = sensor.performer.expression_names
    rng = np.random.default_rng([seed, 91])
    real = np.concatenate([take.part(*part).activations(names, 30.0) for part in PARTS])
    script = real[rng.permutation(len(real))[:FRAMES]]
    script[:REST] = 0.0
    turns = rng.uniform(-1, 1, (FRAMES, 3)) * TURNS
    sensor.script = np.concatenate([np.zeros((BEGINNING, script.shape[1])), script])
    sensor._motion = HeadMotion(seed, 0, sensor.fps, 600.0, turns=np.concatenate([np.zeros((BEGINNING, 3)), turns]))
    jaw = names.index("jawOpen")

    def values(frame: RgbdFrame, face: DetectedFace) -> tuple:
        truth = sensor.ground_truth(frame.index)
        points = landmarks.points(truth.vertices)
        head = transform_points(np.linalg.inv(truth.head_pose), points)
        slides = landmarks.slides(truth.head_pose, frame.camera, head, float(truth.activations[jaw]))
        off = face.mesh[landmarks.ids, :2] - slides - frame.camera.project(points)
        across = truth.head_pose[:2, 0] / np.linalg.norm(truth.head_pose[:2, 0])
        axes = np.array([across, [-across[1], across[0]]])
        return frame.index - BEGINNING, off * points[:, 2:] / frame.camera.fx @ axes.T

    return gather(lambda: sensor, range(BEGINNING, BEGINNING + FRAMES), ("number", "error"), values, None)


def shared(errors: np.ndarray, modes: int) -> np.ndarray:
    """(L, 2, K) the first eigenvectors of the covariance of errors (F, L, 2), with their standard deviations as lengths, mm."""
    flat = np.clip(errors, -LARGEST, LARGEST).reshape(len(errors), -1)
    variances, vectors = np.linalg.eigh(flat.T @ flat / len(flat))
    found: np.ndarray = vectors[:, ::-1][:, :modes] * np.sqrt(variances[::-1][:modes])
    return found.reshape(*errors.shape[1:], modes)


def measured(take: Take, landmarks: FeatureSet, cache: Path | None) -> np.ndarray:
    """(F, L, 2) mm: the errors of all performers' moving frames beyond those of their resting ones."""
    if cache is not None and cache.exists():
        return np.load(cache)["error"]
    out = []
    for seed in SEEDS:
        data = performer(seed, take, landmarks)
        rest = data["number"] < REST
        out.append(data["error"][~rest] - data["error"][rest if rest.any() else ~rest].mean(axis=0))
    errors = np.concatenate(out)
    if cache is not None:
        np.savez(cache, error=errors)
    return errors


def main() -> None:
    """Write the shared errors, and print how much of the landmarks' errors they are."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--take", type=Path, required=True, help="a Live Link Face CSV of a person doing every expression")
    parser.add_argument("--cache", type=Path, help="file that keeps the errors of all performers")
    args = parser.parse_args()
    landmarks = landmark_set().fitted
    errors = measured(read_take(args.take), landmarks, args.cache)
    modes = shared(errors, MODES)
    total, part = np.square(np.clip(errors, -LARGEST, LARGEST)).sum(axis=(1, 2)).mean(), np.square(modes).sum()
    print(f"{MODES} shared errors are {100 * part / total:.0f} % of the variance of {len(errors)} frames")
    share = TAKEN * np.array([REGIONS.get(str(region), 1.0) for region in landmarks.regions])
    np.savez_compressed(OUT, ids=landmarks.ids, modes=np.float32(share[:, None, None] * modes))


if __name__ == "__main__":
    main()
