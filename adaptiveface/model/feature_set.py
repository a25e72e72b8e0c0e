"""Define feature sets: points on the model's surface that a detector finds in pictures, and how reliable each of them is.

The package has one set, some 180 of MediaPipe's landmarks (:func:`landmark_set`), which ``data_synth/place_landmarks.py``
placed and measured on rendered performers. A set is data: its size appears nowhere in the code. The paper's 40 features are
not a set. Every face model and actor places them for itself.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from importlib.resources import as_file, files

import numpy as np

from ..errors import FileFormatError
from ..files.records import array, read, record
from ..geometry.camera import Camera
from ..geometry.frame import LANDMARKS, Features2D
from ..geometry.mesh import surface_points

#: MediaPipe's meshes turn aside by this share more than the head, and nod by this share more (less: it is negative). Measured
#: by ``data_synth/measure_detector.py``: 0.035 and -0.18 on rendered performers; on three real people 0.11 and -0.17. Two
#: thirds of the nod are taken: what is taken out makes every other error of the pose larger.
TURN, NOD = 0.05, -0.12
#: Beyond this angle the excess grows no more, degrees; and the point about which it turns, the middle of the landmarks, mm.
LARGEST, MIDDLE = 35.0, np.array([0.0, -9.0, 7.0])
#: The expression whose coefficient tells how far the mouth is open.
JAW = "jawOpen"


@record
@dataclass(frozen=True)
class FeatureSet:
    """L features on a mesh, and the reliability of each at Y yaws of the head."""

    ids: np.ndarray = array("L", "i4", "MediaPipe's numbers of the landmarks")
    regions: np.ndarray = array("L", "U", "name of the region of each")
    triangles: np.ndarray = array("L 3", "i4", "corners of the triangle that it sits on", below="N")
    weights: np.ndarray = array("L 3", doc="barycentric weights of its place there")
    offset: np.ndarray = array(
        "L 3", doc="where the detector sees it from there when the head turns (`slides`), head frame", unit="mm"
    )
    held_out: np.ndarray = array("L", "b", "left out of every fit, to measure the fit by")
    personal: np.ndarray = array("L", doc="standard deviation of its place between persons", unit="mm")
    yaw: np.ndarray = array("Y", doc="angles of the head for `deviation`, ascending", unit="degrees")
    deviation: np.ndarray = array(
        "L Y", doc="standard deviation from frame to frame, per coordinate across the view", unit="mm"
    )
    opened: np.ndarray = array(
        "L 3", doc="by how much the detector leaves it behind as the jaw opens fully, head frame", unit="mm", optional=True
    )

    def __len__(self) -> int:
        return len(self.ids)

    def points(self, vertices: np.ndarray) -> np.ndarray:
        """(L, 3) where the features lie on a mesh (V, 3)."""
        return surface_points(vertices, self.triangles, self.weights)

    def deviations(self, yaw: float) -> np.ndarray:
        """(L,) deviation at a head's yaw (degrees), mm. Beyond the ends of the table it is constant."""
        place = np.interp(yaw, self.yaw, np.arange(len(self.yaw)))
        low = min(int(place), len(self.yaw) - 1)
        high = min(low + 1, len(self.yaw) - 1)
        return self.deviation[:, low] + (place - low) * (self.deviation[:, high] - self.deviation[:, low])

    def select(self, chosen: np.ndarray) -> FeatureSet:
        """The features that ``chosen`` selects: (L,) bool, or numbers."""
        per_feature = ("ids", "regions", "triangles", "weights", "offset", "held_out", "personal", "deviation", "opened")
        return replace(self, **{name: getattr(self, name)[chosen] for name in per_feature})

    @property
    def fitted(self) -> FeatureSet:
        """The features that fits may use."""
        return self.select(~self.held_out)

    def slides(self, pose: np.ndarray, camera: Camera, points: np.ndarray, opening: float = 0.0) -> np.ndarray:
        """(L, 2) px by which the detector's landmarks lie off their points, for a head at ``pose`` (4, 4) head to camera.

        Seen from the front, with a closed mouth, they hardly do. As the head turns, a detector that takes the nose for longer
        moves its tip aside. The mesh that it returns turns more or less than the head (``TURN``, ``NOD``), and follows an
        opening chin only part of the way. ``points`` (L, 3) are the features, head frame, mm. ``opening`` is that of the jaw,
        0 to 1.
        """
        yaw, pitch = np.radians(np.clip([yaw_of(pose), pitch_of(pose)], -LARGEST, LARGEST))
        x, y = NOD * pitch, TURN * yaw
        turned = np.array([[0.0, 0.0, -y], [0.0, 0.0, x], [y, -x, 0.0]])  # p @ turned = (x, y, 0) x p
        excess = (points - MIDDLE) @ turned
        moved = (self.offset + opening * self.opened + excess) @ pose[:3, :3].T
        ray = pose[:2, 3] / pose[2, 3]
        return (moved[:, :2] - ray * moved[:, 2:]) * [camera.fx, camera.fy] / pose[2, 3]

    def trust(self, pose: np.ndarray) -> np.ndarray:
        """(L,) 1/mm^2: the inverse variance of each landmark on a head at ``pose`` (4, 4) head to camera.

        Beyond the yaws of the table, all count less. The detector's error grew from 1.0 px to 6 px when a real head turned to
        the profile.
        """
        cosine = -float(pose[:3, 2] @ pose[:3, 3]) / float(np.linalg.norm(pose[:3, 3]))
        return (np.clip((cosine - 0.3) / 0.5, 0.1, 1.0) / self.deviations(yaw_of(pose))) ** 2

    def pixels(self, features: Features2D) -> np.ndarray | None:
        """(L, 2) px: where the detector saw them, or None where ``features`` did not come from it."""
        return None if features.face is None else features.face.mesh[self.ids, :2]


def yaw_of(pose: np.ndarray) -> float:
    """Degrees by which a head of pose (4, 4) head to camera is turned away from the camera, to the subject's left."""
    towards = -pose[:3, :3].T @ pose[:3, 3]
    return -float(np.degrees(np.arctan2(towards[0], towards[2])))


def pitch_of(pose: np.ndarray) -> float:
    """Degrees by which a head of pose (4, 4) head to camera is bent down, away from the camera."""
    towards = -pose[:3, :3].T @ pose[:3, 3]
    return float(np.degrees(np.arctan2(towards[1], towards[2])))


def opening_of(expressions: Sequence[str], coefficients: np.ndarray) -> float:
    """How far the jaw is open, 0 to 1, by the coefficients (A,) of ``expressions``; 0 if none of them opens it."""
    return float(dict(zip(expressions, coefficients, strict=False)).get(JAW, 0.0))


@lru_cache(maxsize=1)
def landmark_set() -> FeatureSet:
    """MediaPipe's landmarks on the embedded face model."""
    with as_file(files("adaptiveface") / "assets" / "landmarks.npz") as path:
        return FeatureSet(**_normalised(read(FeatureSet, path, double=True)))


def _normalised(data: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Normalise barycentric weights that were stored in float32, make numbers int32, and set what older files lack to zero."""
    weights = data["weights"] / data["weights"].sum(axis=1, keepdims=True)
    data = {"opened": np.zeros_like(data["offset"])} | data
    return data | {"weights": weights, "ids": data["ids"].astype(np.int32)}


def checked_set(path: str | os.PathLike, data: dict[str, np.ndarray], prefix: str) -> FeatureSet:
    """The set whose arrays a file holds under ``prefix``. Raises :class:`FileFormatError` for invalid ones."""
    weights, deviation, yaw, ids = data["weights"], data["deviation"], data["yaw"], data["ids"]
    if len(weights) and (weights.min() < -0.01 or np.abs(weights.sum(axis=1) - 1).max() > 0.01):
        raise FileFormatError(f"{path}: rows of '{prefix}weights' are not barycentric (0 to 1, sum 1)")
    if min(deviation.min(initial=1.0), data["personal"].min(initial=1.0)) <= 0:
        raise FileFormatError(f"{path}: '{prefix}deviation' or '{prefix}personal' holds a value that is not positive")
    if not yaw.size or (np.diff(yaw) <= 0).any() or np.abs(yaw).max() > 180:
        raise FileFormatError(f"{path}: '{prefix}yaw' does not rise from -180 to 180 degrees")
    if len(ids) and not 0 <= ids.min() <= ids.max() < LANDMARKS:
        raise FileFormatError(f"{path}: '{prefix}ids' are not numbers of landmarks, 0 to {LANDMARKS - 1}")
    return FeatureSet(**_normalised(data))
