"""What MediaPipe sees of rendered performers, kept with the truth: rendering takes ten times as long as anything after it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from adaptiveface.geometry.frame import DetectedFace, RgbdFrame
from adaptiveface.landmarks import FeatureDetector
from adaptiveface.synthetic.sensor import SyntheticSensor


def observe(sensor: SyntheticSensor, indices, cache: Path | None = None) -> dict[str, np.ndarray]:
    """Frames ``indices`` of a sensor in which one face is found, K of them.

    index (K,); mesh (K, 478, 3) px; scores (K, 52) MediaPipe's expression scores; vertices (K, V, 3) mm camera frame and
    rigid (K, 4, 4), the truth. ``cache`` names a file that keeps them.
    """

    def values(frame: RgbdFrame, face: DetectedFace) -> tuple:
        truth = sensor.ground_truth(frame.index)
        return frame.index, face.mesh, face.scores, np.float32(truth.vertices), truth.head_pose

    return gather(lambda: sensor, indices, ("index", "mesh", "scores", "vertices", "rigid"), values, cache)


def gather(
    make_sensor: Callable[[], SyntheticSensor],
    indices: Iterable[int],
    names: Sequence[str],
    values: Callable[[RgbdFrame, DetectedFace], Sequence[Any]],
    cache: Path | None,
) -> dict[str, np.ndarray]:
    """Arrays (K, ...) by name: ``values`` of the K frames in which a face is found. The file ``cache`` keeps them."""
    if cache is not None and cache.exists():
        return dict(np.load(cache, allow_pickle=False))
    sensor, detector = make_sensor(), FeatureDetector()
    rows: dict[str, list] = {name: [] for name in names}
    for index in indices:
        frame = sensor.read(index)
        for face in detector.detect_faces(frame.colour)[:1]:
            for name, value in zip(rows, values(frame, face), strict=True):
                rows[name].append(value)
    detector.close()
    data = {name: np.array(column) for name, column in rows.items()}
    if cache is not None:
        cache.parent.mkdir(parents=True, exist_ok=True)
        np.savez(cache, **data)
    return data
