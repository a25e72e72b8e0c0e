"""Write a performance as a CSV file of Live Link Face, and read one. :mod:`adaptiveface.livelink` holds the conventions."""

from __future__ import annotations

import os

import numpy as np

from ..livelink import LiveLinkTake, read_take, write_take
from ..livelink.convention import angles, eye_angles, rotations
from ..livelink.take import HEADER
from ..livelink.timecode import timecode
from ..retargeting.retarget import Performance
from ..runtime.timing import increasing
from .animation import CAMERA_TO_VIEW, view_motion

__all__ = ["HEADER", "eye_angles", "head_angles", "read_arkit_csv", "take_performance", "timecode", "write_arkit_csv"]


def head_angles(rigid: np.ndarray) -> np.ndarray:
    """(F, 3) yaw, pitch and roll of poses (F, 4, 4) from head to camera, radians. They are zero if the head faces the camera.

    Yaw is positive to the subject's right, pitch downwards, roll towards the subject's left shoulder.
    """
    return angles(view_motion(rigid)[:, :3, :3])


def write_arkit_csv(path: str | os.PathLike, performance: Performance) -> None:
    """Write one row per frame, whole or not at all."""
    times = performance.start + increasing(performance.timestamps)
    head, eyes = head_angles(performance.head_pose), performance.eye_angles
    write_take(path, LiveLinkTake(times, performance.curves, head, eyes, np.ones(len(performance), bool)))


def read_arkit_csv(path: str | os.PathLike) -> Performance:
    """Read a file of :func:`write_arkit_csv` or Live Link Face. Poses hold the head's rotation only, at the origin.

    Raises :class:`FileFormatError` naming the file, the line and the reason.
    """
    return take_performance(read_take(path))


def take_performance(take: LiveLinkTake) -> Performance:
    """A take as a performance, which drives characters."""
    rigid = np.tile(np.eye(4), (len(take), 1, 1))
    rigid[:, :3, :3] = CAMERA_TO_VIEW @ rotations(take.head)
    return Performance(take.curves, increasing(take.timestamps), rigid, eyes=take.eyes, start=float(take.timestamps[0]))
