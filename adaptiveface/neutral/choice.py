"""Which frames show the neutral face: seen from the front, with a closed mouth, and looking as most others do.

People start a recording while they still turn to the camera, talk or smile. Frames are judged by their features, against the
model's neutral face seen under the same pose (:mod:`~adaptiveface.neutral.face_quality`); what differs from person to person
(how wide a mouth is, how open eyes are) against the median of the same take. What is an expression from the first frame on is
told by the detector's scores (:mod:`~adaptiveface.neutral.expression`).
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

#: Degrees between the face's direction and the camera: seen from the front, and from too far aside.
FRONTAL, ASIDE = 25.0, 45.0
#: Mean confidence of the features, as a share of the most confident one, below which a face is hardly seen.
SEEN = 0.25
#: Opening of the mouth that is none of a neutral face; largest deviations of width, eyes and brows from the take's median. In
#: the tolerances of face_quality. Measured at rest: openings up to 0.45 (a beard); talking and laughing: from 0.8.
OPEN, UNLIKE = 0.6, np.array([0.8, 0.6, 0.5])
#: Share of calm frames from which on they are taken as they come.
ENOUGH = 0.8
#: Frames with a face among which the neutral is sought where the leading ones do not show it.
LOOK = 150
#: What is wrong with a frame, in the words of a note.
WORDS = ("turned away", "hardly seen", "with an open mouth", "moving", "smiling or the like")


@dataclass(frozen=True)
class Judged:
    """One frame: ``angle`` degrees from the front; ``seen`` 0..1; ``mouth``: opening, in its tolerance; ``rest``: (width,
    eyes, brows), likewise; ``expression``: what the detector's scores tell of one, as a share of what is none."""

    angle: float
    seen: float
    mouth: float
    rest: tuple[float, float, float]
    expression: float = 0.0


@dataclass(frozen=True)
class Choice:
    """``picked``: positions of the chosen frames; ``note``: what is doubtful about them, or why it is not the first ones.

    ``doubtful``: the former.
    """

    picked: list[int]
    note: str = ""
    doubtful: bool = False


def judge(frame: RgbdFrame, points: np.ndarray) -> Judged | None:
    """Judge a frame by its features, which the model has at ``points`` (40, 3); None where no pose explains them."""
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
    """(F, 5) what speaks against each frame, in the order of ``WORDS``: calm below 1."""
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
    """The ``count`` frames to take of all that were judged, in order: the leading ones where they are calm.

    Otherwise the ``count`` calmest ones; where fewer are calm, those; where there are hardly any, the leading ones, with a
    note.
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
    # Not those that follow one another: between two expressions a face is at rest for a few frames only. How far they are
    # turned does not matter: the sides are wanted as well.
    expressive = cost[calm, 2:].max(axis=1)
    picked = sorted(int(k) for k in calm[np.argsort(expressive, kind="stable")[:count]])
    return Choice(picked, f"of the first {len(lead)} frames with a face, {trouble}")


def leading_is_calm(cost: np.ndarray, judged: Sequence[Judged | None]) -> bool:
    """Whether enough of the frames are calm and some of them show the face from the front."""
    calm = cost.max(axis=1) < 1
    frontal = sum(bool(ok) and face is not None and face.angle < FRONTAL for ok, face in zip(calm, judged, strict=True))
    return bool(calm.mean() >= ENOUGH and frontal >= min(3, max(1, len(judged) // 8)))


def doubts(judged: Sequence[Judged | None], turned: bool = True) -> str:
    """What speaks against these frames as a neutral, or ""; ``turned``: also that the face is seen from aside."""
    cost = costs(judged)
    if not turned:
        cost[:, :2] = 0.0
        aside = np.array([face is None or face.angle >= ASIDE for face in judged], bool)
        cost[aside, 2:] = 0.0  # the detector guesses there
    calm = cost.max(axis=1, initial=0.0) < 1
    return "" if not len(judged) or calm.mean() >= ENOUGH else _trouble(cost)


def _trouble(cost: np.ndarray) -> str:
    """Such as "the face is turned away in 28, moving in 3": every frame by the worst that speaks against it."""
    worst = Counter(int(k) for k, value in zip(cost.argmax(axis=1), cost.max(axis=1), strict=True) if value >= 1)
    counts = ", ".join(f"{WORDS[k]} in {count}" for k, count in worst.most_common())
    return f"the face is {counts}" if counts else "none is seen from the front"
