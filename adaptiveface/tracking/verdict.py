"""Say what went wrong in a run. Everything that shows a result says this first."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable

import numpy as np

from ..geometry.frame import RgbdFrame
from .detection import MIN_LIFTED, lift_features, measured_size
from .types import TrackedFrame

#: Share of the frames with a face that a good run tracks at least.
EXPECTED = 0.8
#: Mean confidence of detected features, which is at most 0.3, below which the face is turned far away.
ASIDE = 0.05
#: Reasons for a frame without a known face; the third one occurs in results of earlier versions.
NO_FACE, NO_DEPTH, UNKNOWN = "no face in the picture", "the depth map is empty", "the head was not found"
#: Reasons why the head was not found although there is a face.
TURNED, BARE, WRONG_SIZE, MISFIT = (
    "the face is turned far away",
    "there is no depth at the face",
    "the face in the depth map has another size than the head",
    "the head does not fit the depth at the face",
)
#: The likely cause of each reason, and the remedy.
LIKELY = {
    TURNED: "perhaps the neutral was not seen from the front: --neutral-frames FIRST:LAST takes others",
    BARE: "perhaps colour and depth are not aligned, or the face is out of the sensor's range",
    WRONG_SIZE: "perhaps the unit of depth (depth_scale) is not that of the neutral, or it is another person's",
    MISFIT: "perhaps the neutral was not a calm face seen from the front (--neutral-frames FIRST:LAST takes others), or it "
    "is another person's",
}


def why_lost(frame: RgbdFrame, feature_points: np.ndarray) -> str:
    """Say why the head with ``feature_points`` (40, 3) mm was not found in a frame."""
    features = frame.features
    if not frame.depth.any():
        return NO_DEPTH
    if features is None or features.valid.sum() < 6:
        return NO_FACE
    if features.confidence.mean() < ASIDE:
        return TURNED
    if len(lift_features(frame)[0]) < MIN_LIFTED:
        return BARE
    size = measured_size(frame, feature_points)
    if not 0.8 < size < 1.25:
        return WRONG_SIZE
    return MISFIT


def face_seen(reason: str) -> bool:
    """Whether a frame that is not tracked for this reason is known to show a face."""
    return reason not in ("", NO_FACE, NO_DEPTH, UNKNOWN)


def verdict(tracked: Iterable[bool], skipped: Iterable[bool], reasons: Iterable[str]) -> str:
    """Say on one line that fewer than ``EXPECTED`` of the frames with a face are tracked, with the likely cause; "" if not."""
    tracked = list(tracked)
    lost = Counter(
        reason
        for reason, kept, broken in zip(reasons, tracked, skipped, strict=True)
        if not kept and not broken and face_seen(reason)
    )
    found, missed = sum(map(bool, tracked)), sum(lost.values())
    if found >= EXPECTED * (found + missed):
        return ""
    (reason, count), *_ = lost.most_common(1)
    share = f"only {found} of the {found + missed} frames with a face are tracked ({found / (found + missed):.0%})"
    return "; ".join(filter(None, (f"{share}: in {count}, {reason}", LIKELY.get(reason))))


def verdict_of(frames: Iterable[TrackedFrame]) -> str:
    """Return the :func:`verdict` on a tracker's frames."""
    frames = list(frames)
    return verdict([f.tracked for f in frames], [False] * len(frames), [f.reason for f in frames])
