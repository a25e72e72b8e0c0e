"""What MediaPipe sees of rendered performers, kept with the truth: rendering takes ten times as long as anything after it."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from adaptiveface.landmarks import FeatureDetector
from adaptiveface.synthetic.sensor import SyntheticSensor


def observe(sensor: SyntheticSensor, indices, cache: Path | None = None) -> dict[str, np.ndarray]:
    """Frames ``indices`` of a sensor in which one face is found, K of them.

    index (K,); mesh (K, 478, 3) px; scores (K, 52) MediaPipe's expression scores; vertices (K, V, 3) mm camera frame and
    rigid (K, 4, 4), the truth. ``cache`` names a file that keeps them.
    """
    if cache is not None and cache.exists():
        return dict(np.load(cache, allow_pickle=False))
    rows: dict[str, list] = {name: [] for name in ("index", "mesh", "scores", "vertices", "rigid")}
    detector = FeatureDetector()
    for index in indices:
        colour, truth = sensor.read(index).colour, sensor.ground_truth(index)
        for face in detector.detect_faces(colour)[:1]:
            values = index, face.mesh, face.scores, np.float32(truth.vertices), truth.head_pose
            for name, value in zip(rows, values, strict=True):
                rows[name].append(value)
    detector.close()
    data = {name: np.array(values) for name, values in rows.items()}
    if cache is not None:
        cache.parent.mkdir(parents=True, exist_ok=True)
        np.savez(cache, **data)
    return data
