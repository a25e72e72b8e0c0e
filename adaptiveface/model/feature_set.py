"""Feature sets: named points on the model's surface that a detector finds in pictures, with how far each can be trusted.

Two sets come with the package: the paper's 40 features, which every face model and actor places for itself
(:func:`paper_features`), and some 180 of MediaPipe's landmarks (:func:`landmark_set`), placed and measured on rendered
performers by ``data_synth/place_landmarks.py``. A set is data: its size appears nowhere in the code.
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
from ..geometry.frame import FEATURE_IDS, FEATURE_REGIONS, LANDMARKS, MEDIAPIPE_INDICES, Features2D
from ..geometry.mesh import surface_points

#: Deviation of the 40 features where nothing else is known, mm: between persons and from frame to frame.
PAPER_PERSONAL, PAPER_DEVIATION = 0.7, 1.0
#: MediaPipe's meshes turn aside by this share more than the head, and nod by this share more (less: it is negative). Measured
#: by ``data_synth/measure_detector.py``: 0.035 and -0.18 on rendered performers; on three real people 0.11 and -0.17. Two
#: thirds of the nod are taken: what is taken out makes every other error of the pose larger.
TURN, NOD = 0.05, -0.12
#: Beyond this angle the excess grows no more, degrees; and the point about which it turns, the middle of the landmarks, mm.
LARGEST, MIDDLE = 35.0, np.array([0.0, -9.0, 7.0])
#: The expression whose coefficient says how far the mouth is open.
JAW = "jawOpen"


@record
@dataclass(frozen=True)
class FeatureSet:
    """L features on a mesh, with how far each can be trusted at Y yaws of the head."""

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
        """(L,) mm: the deviation at a head's yaw, degrees; beyond the table's ends it stays that of the end."""
        place = np.interp(yaw, self.yaw, np.arange(len(self.yaw)))
        low = min(int(place), len(self.yaw) - 1)
        high = min(low + 1, len(self.yaw) - 1)
        return self.deviation[:, low] + (place - low) * (self.deviation[:, high] - self.deviation[:, low])

    def select(self, chosen: np.ndarray) -> FeatureSet:
        """The features ``chosen`` (L,) bool, or their numbers."""
        per_feature = ("ids", "regions", "triangles", "weights", "offset", "held_out", "personal", "deviation", "opened")
        return replace(self, **{name: getattr(self, name)[chosen] for name in per_feature})

    @property
    def fitted(self) -> FeatureSet:
        """Those that fits may use."""
        return self.select(~self.held_out)

    def slides(self, pose: np.ndarray, camera: Camera, points: np.ndarray, opening: float = 0.0) -> np.ndarray:
        """(L, 2) px by which the detector's landmarks lie off their points, for a head at ``pose`` (4, 4) head to camera.

        From the front, with a closed mouth, next to nothing. A detector that sees the nose too long moves its tip aside as
        the head turns; the mesh that it returns turns more or less than the head (``TURN``, ``NOD``); and it follows a chin
        only part of the way down. ``points`` (L, 3) mm, head frame: where they lie; ``opening`` of the jaw, 0 to 1.
        """
        yaw, pitch = np.radians(np.clip([yaw_of(pose), pitch_of(pose)], -LARGEST, LARGEST))
        excess = np.cross([NOD * pitch, TURN * yaw, 0.0], points - MIDDLE)
        moved = (self.offset + opening * self.opened + excess) @ pose[:3, :3].T
        ray = pose[:2, 3] / pose[2, 3]
        return (moved[:, :2] - ray * moved[:, 2:]) * [camera.fx, camera.fy] / pose[2, 3]

    def trust(self, pose: np.ndarray) -> np.ndarray:
        """(L,) 1/mm^2: the inverse variance of each landmark on a head at ``pose`` (4, 4) head to camera.

        Beyond the yaws of the table all count less: as a real head turned to the profile, the detector's error grew from
        1.0 px to 6 px.
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
    """How far the jaw is open, 0 to 1, by the coefficients (A,) of ``expressions``; 0 where none of them opens it."""
    return float(dict(zip(expressions, coefficients, strict=False)).get(JAW, 0.0))


def paper_features(rig) -> FeatureSet:
    """The 40 features of the paper as a set, where a face model or an actor has them."""
    triangles, weights = rig.feature_triangles, rig.feature_weights
    count = len(FEATURE_IDS)
    deviation, personal = np.full((count, 1), PAPER_DEVIATION), np.full(count, PAPER_PERSONAL)
    nothing, held_out = np.zeros((count, 3)), np.zeros(count, bool)
    places = MEDIAPIPE_INDICES, FEATURE_REGIONS, triangles, weights
    return FeatureSet(*places, nothing, held_out, personal, np.zeros(1), deviation, nothing)


@lru_cache(maxsize=1)
def landmark_set() -> FeatureSet:
    """MediaPipe's landmarks on the embedded face model."""
    with as_file(files("adaptiveface") / "assets" / "landmarks.npz") as path:
        return FeatureSet(**_normalised(read(FeatureSet, path, double=True)))


def _normalised(data: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Barycentric weights that were stored in float32 sum to one again; numbers are int32; what older files lack is zero."""
    weights = data["weights"] / data["weights"].sum(axis=1, keepdims=True)
    data = {"opened": np.zeros_like(data["offset"])} | data
    return data | {"weights": weights, "ids": data["ids"].astype(np.int32)}


def checked_set(path: str | os.PathLike, data: dict[str, np.ndarray], prefix: str) -> FeatureSet:
    """A set of the arrays that a file holds under ``prefix``; raises :class:`FileFormatError` where they are none."""
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
