"""Choose the frames that show the neutral face: from the front, with a closed mouth, and similar to most others.

People start a recording while they still turn to the camera, talk or smile. Frames are judged by their features. These are
compared with the model's neutral face in the same pose (:mod:`~adaptiveface.neutral.face_quality`). What differs between
people, such as the width of the mouth and the opening of the eyes, is compared with the median of the take. An expression that
lasts from the first frame on is found by the detector's scores (:mod:`~adaptiveface.neutral.expression`).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..geometry.frame import RgbdFrame
from ..geometry.mesh import transform_points
from ..tracking.detection import pose_from_features
from .expression import expressiveness
from .face_quality import expression

#: Largest angles between the face's direction and the camera for a frontal view, and for a usable one, degrees.
FRONTAL, ASIDE = 25.0, 45.0
#: Mean confidence of the features, as a share of the highest one, below which a face is hardly visible.
SEEN = 0.25
#: Largest opening of a neutral mouth, and largest deviations of width, eyes and brows from the take's median, in the
#: tolerances of face_quality. Openings at rest are at most 0.45 (with a beard); those of talking and laughing begin at 0.8.
OPEN, UNLIKE = 0.6, np.array([0.8, 0.6, 0.5])
#: Share of calm frames that suffices for taking the frames in their order.
ENOUGH = 0.8
#: Number of frames with a face in which the neutral is sought if the leading ones do not show it.
LOOK = 150
#: Faults of a frame, in the words of a note.
WORDS = ("turned away", "hardly seen", "with an open mouth", "moving", "smiling or the like")


@dataclass(frozen=True)
class Judged:
    """The judgement of one frame.

    Attributes
    ----------
    angle : float
        From the frontal view, degrees.
    seen : float
        How well the face is visible, 0 to 1.
    mouth : float
        Opening of the mouth, in its tolerance.
    rest : (3,)
        Width of the mouth, opening of the eyes and height of the brows, in their tolerances.
    expression : float
        Strength of an expression in the detector's scores, as a share of what a face at rest reaches.
    """

    angle: float
    seen: float
    mouth: float
    rest: tuple[float, float, float]
    expression: float = 0.0


@dataclass(frozen=True)
class Choice:
    """The chosen frames.

    Attributes
    ----------
    picked : list of int
        Their positions.
    note : str
        What is doubtful about them, or why the first ones were not taken.
    doubtful : bool
        Whether the note is about a doubt.
    """

    picked: list[int]
    note: str = ""
    doubtful: bool = False


def judge(frame: RgbdFrame, points: np.ndarray) -> Judged | None:
    """Judge a frame by its features, which the model has at ``points`` (40, 3) mm; None if no pose explains them."""
    pose = pose_from_features(frame, points)
    if pose is None:
        return None
    face = expression(frame.seen, frame.camera.project(transform_points(pose, points)))
    towards = -(pose[:3, 2] @ pose[:3, 3]) / max(np.linalg.norm(pose[:3, 3]), 1e-9)
    confidence = frame.seen.confidence
    seen = float(confidence.mean() / max(confidence.max(), 1e-9)) if confidence.max() > 0.05 else 0.0
    angle = float(np.degrees(np.arccos(np.clip(towards, -1, 1))))
    told = expressiveness(frame.seen.face)
    return Judged(angle, seen, face.mouth_open, (face.mouth_width, face.eyes, face.brows), told)


def costs(judged: Sequence[Judged | None]) -> np.ndarray:
    """Faults (F, 5) of each frame, in the order of ``WORDS``. A frame is calm if all of them are below 1."""
    out = np.full((len(judged), len(WORDS)), 9.0)
    faces = [(k, face) for k, face in enumerate(judged) if face is not None]
    if not faces:
        return out
    known = [k for k, _ in faces]
    names = "angle", "seen", "mouth", "expression"
    angle, seen, mouth, told = (np.array([getattr(face, name) for _, face in faces]) for name in names)
    rest = np.array([face.rest for _, face in faces])
    quiet = (angle < ASIDE) & (mouth < OPEN) & (told < 1)
    usual = np.median(rest[quiet] if quiet.sum() >= 3 else rest, axis=0)
    unlike = (np.abs(rest - usual) / UNLIKE).max(axis=1)
    out[known] = np.stack([angle / ASIDE, SEEN / np.maximum(seen, 1e-3), mouth / OPEN, unlike, told], axis=1)
    return out


def choose(judged: Sequence[Judged | None], count: int) -> Choice:
    """Choose ``count`` of the judged frames, in order.

    The leading frames are chosen if they are calm. Otherwise the ``count`` calmest frames are chosen, or all calm ones if there
    are fewer. If hardly any are calm, the leading frames are chosen, with a note.
    """
    if not judged:
        return Choice([])
    cost = costs(judged)
    lead = list(range(min(count, len(judged))))
    if leading_is_calm(cost[lead], judged[: len(lead)]):
        return Choice(lead)
    trouble = _trouble(cost[lead])
    calm = np.flatnonzero(cost.max(axis=1) < 1)
    frontal = [face for face in (judged[int(k)] for k in calm) if face is not None and face.angle < FRONTAL]
    if len(calm) < max(3, count // 8) or not frontal:
        return Choice(lead, f"the neutral frames are doubtful: of {len(lead)}, {trouble}", True)
    # The chosen frames need not follow one another, because a face rests only for a few frames between two expressions. Their
    # angle does not matter, because the sides are needed as well.
    expressive = cost[calm, 2:].max(axis=1)
    picked = sorted(int(k) for k in calm[np.argsort(expressive, kind="stable")[:count]])
    return Choice(picked, f"of the first {len(lead)} frames with a face, {trouble}")


def leading_is_calm(cost: np.ndarray, judged: Sequence[Judged | None]) -> bool:
    """Whether enough of the frames are calm and some of them show the face from the front."""
    calm = cost.max(axis=1) < 1
    frontal = sum(bool(ok) and face is not None and face.angle < FRONTAL for ok, face in zip(calm, judged, strict=True))
    return bool(calm.mean() >= ENOUGH and frontal >= min(3, max(1, len(judged) // 8)))


def doubts(judged: Sequence[Judged | None], turned: bool = True) -> str:
    """Say what speaks against these frames as a neutral, or "". With ``turned``, a face that is seen from aside counts."""
    cost = costs(judged)
    if not turned:
        cost[:, :2] = 0.0
        aside = np.array([face is None or face.angle >= ASIDE for face in judged], bool)
        cost[aside, 2:] = 0.0  # the detector guesses in such frames
    calm = cost.max(axis=1, initial=0.0) < 1
    return "" if not len(judged) or calm.mean() >= ENOUGH else _trouble(cost)


def _trouble(cost: np.ndarray) -> str:
    """Count the frames by their worst fault, such as "the face is turned away in 28, moving in 3"."""
    worst = Counter(int(k) for k, value in zip(cost.argmax(axis=1), cost.max(axis=1), strict=True) if value >= 1)
    counts = ", ".join(f"{WORDS[k]} in {count}" for k, count in worst.most_common())
    return f"the face is {counts}" if counts else "none is seen from the front"
