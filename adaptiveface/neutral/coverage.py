"""Choose the frames of a take for the neutral scan: calm frames that show the face from as many sides as possible."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..geometry.frame import RgbdFrame
from ..tracking.detection import pose_from_features
from .choice import Choice, choose, costs, judge

#: Two viewing directions that differ by at least this angle show different parts of the face, degrees.
SPREAD = 12.0


def choose_by_coverage(frames: Sequence[RgbdFrame], points: np.ndarray, count: int) -> Choice:
    """Choose at most ``count`` of the frames that show a face.

    :func:`.choice.choose` finds the leading or the calmest frames; those that are not calm are left out. Up to half of them
    are then replaced by calm frames that show the face from other sides, the most different side first.

    Parameters
    ----------
    frames : sequence of RgbdFrame
        With 2D features.
    points : (40, 3)
        The model's features, mm.
    count : int
        Largest number of frames.

    Returns
    -------
    Choice
        Positions in ``frames``, ascending, and what is doubtful about them.
    """
    judged = [judge(frame, points) for frame in frames]
    choice = choose(judged, count)
    calm = [int(k) for k in np.flatnonzero(costs(judged).max(axis=1, initial=0.0) < 1)]
    core = [k for k in choice.picked if k in calm]
    if not core:
        return choice
    directions = {k: _direction(frames[k], points) for k in calm}
    nearest = {k: min(_angle(directions[k], directions[other]) for other in core) for k in calm}
    views: list[int] = []
    while len(views) < count // 2:
        farthest = max(nearest, key=nearest.__getitem__)
        if nearest[farthest] < SPREAD:
            break
        views.append(farthest)
        nearest = {k: min(angle, _angle(directions[k], directions[farthest])) for k, angle in nearest.items()}
    kept = np.linspace(0, len(core) - 1, min(len(core), count - len(views))).round().astype(int)
    return Choice(sorted([*views, *(core[k] for k in kept)]), choice.note, choice.doubtful)


def _direction(frame: RgbdFrame, points: np.ndarray) -> np.ndarray:
    """Unit vector (3,) from the head to the camera, head frame."""
    pose = pose_from_features(frame, points)
    assert pose is not None  # only frames that were judged have a pose
    towards: np.ndarray = -pose[:3, :3].T @ pose[:3, 3]
    return towards / max(float(np.linalg.norm(towards)), 1e-9)


def _angle(one: np.ndarray, other: np.ndarray) -> float:
    """Angle between two unit vectors, degrees."""
    return float(np.degrees(np.arccos(np.clip(one @ other, -1.0, 1.0))))
