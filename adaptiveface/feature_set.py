"""Feature sets: named points on the model's surface that a detector finds in pictures, with how far each can be trusted.

Two sets come with the package: the paper's 40 features, which every face model and actor places for itself
(:func:`paper_features`), and some 180 of MediaPipe's landmarks (:func:`landmark_set`), placed and measured on rendered
performers by ``data_synth/place_landmarks.py``. A set is data: its size appears nowhere in the code.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from importlib.resources import as_file, files

import numpy as np

from .camera import Camera
from .frame import FEATURE_IDS, FEATURE_REGIONS, MEDIAPIPE_INDICES, Features2D
from .mesh import surface_points
from .npz import Field, load_checked

#: Arrays of a set, as they are stored.
FIELDS = {
    "ids": Field(("L",), "iu"),
    "regions": Field(("L",), "U"),
    "triangles": Field(("L", 3), "iu"),
    "weights": Field(("L", 3)),
    "offset": Field(("L", 3)),
    "held_out": Field(("L",), "b"),
    "personal": Field(("L",)),
    "yaw": Field(("Y",)),
    "deviation": Field(("L", "Y")),
}
#: Deviation of the 40 features where nothing else is known, mm: between persons and from frame to frame.
PAPER_PERSONAL, PAPER_DEVIATION = 0.7, 1.0


@dataclass(frozen=True)
class FeatureSet:
    """L features: ids (L,) numbers of MediaPipe's landmarks; regions (L,) names; the rest in millimetres.

    triangles (L, 3) vertex numbers and weights (L, 3) barycentric: where they sit on the surface. offset (L, 3), head frame:
    where the detector seems to see them from there when the head turns (:meth:`slides`). held_out (L,) bool: left out of
    every fit, to measure it by. personal (L,): standard deviation of each feature's place between persons;
    deviation (L, Y): of a person's frames, per coordinate across the view, at the head's ``yaw`` (Y,) degrees, ascending.
    """

    ids: np.ndarray
    regions: np.ndarray
    triangles: np.ndarray
    weights: np.ndarray
    offset: np.ndarray
    held_out: np.ndarray
    personal: np.ndarray
    yaw: np.ndarray
    deviation: np.ndarray

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
        per_feature = ("ids", "regions", "triangles", "weights", "offset", "held_out", "personal", "deviation")
        return replace(self, **{name: getattr(self, name)[chosen] for name in per_feature})

    @property
    def fitted(self) -> FeatureSet:
        """Those that fits may use."""
        return self.select(~self.held_out)

    def slides(self, pose: np.ndarray, camera: Camera) -> np.ndarray:
        """(L, 2) px by which the detector's landmarks lie off their points, for a head at ``pose`` (4, 4) head to camera.

        From the front next to nothing; a detector that sees the nose too long moves its tip aside as the head turns.
        """
        moved = self.offset @ pose[:3, :3].T
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


def paper_features(rig) -> FeatureSet:
    """The 40 features of the paper as a set, where a face model or an actor has them."""
    triangles, weights = rig.feature_triangles, rig.feature_weights
    count = len(FEATURE_IDS)
    deviation, personal = np.full((count, 1), PAPER_DEVIATION), np.full(count, PAPER_PERSONAL)
    offset, held_out = np.zeros((count, 3)), np.zeros(count, bool)
    return FeatureSet(
        MEDIAPIPE_INDICES, FEATURE_REGIONS, triangles, weights, offset, held_out, personal, np.zeros(1), deviation
    )


@lru_cache(maxsize=1)
def landmark_set() -> FeatureSet:
    """MediaPipe's landmarks on the embedded face model."""
    with as_file(files("adaptiveface") / "assets" / "landmarks.npz") as path:
        return from_arrays(load_checked(path, FIELDS))


def from_arrays(arrays: dict[str, np.ndarray]) -> FeatureSet:
    """A set of checked arrays by the names of :data:`FIELDS`; weights stored in float32 sum to one again."""
    data = {name: array.astype(float) if array.dtype.kind == "f" else array for name, array in arrays.items()}
    data["weights"] = data["weights"] / data["weights"].sum(axis=1, keepdims=True)
    return FeatureSet(**data | {"ids": data["ids"].astype(np.int32), "triangles": data["triangles"].astype(np.int32)})
