"""ARKit curves as CSV in the layout of Live Link Face: Timecode, BlendShapeCount, 52 shapes, head and eye rotations."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from ..errors import FileFormatError
from ..retargeting.arkit import ARKIT_NAMES
from ..retargeting.retarget import Performance, increasing
from .animation import CAMERA_TO_VIEW, view_motion

#: Live Link Face counts 60 frames a second in its timecodes.
TIMECODE_FPS = 60
#: Radians that an eye turns at a full eyeLook shape.
GAZE = np.radians(30.0)
ROTATIONS = ("HeadYaw", "HeadPitch", "HeadRoll", "LeftEyeYaw", "LeftEyePitch", "LeftEyeRoll", "RightEyeYaw",
             "RightEyePitch", "RightEyeRoll")  # fmt: skip
HEADER = ("Timecode", "BlendShapeCount", *(name[0].upper() + name[1:] for name in ARKIT_NAMES), *ROTATIONS)
MAX_BYTES = 512 << 20


def timecode(seconds: float) -> str:
    """``HH:MM:SS:FF.mmm``, frames of 1/60 s and thousandths of a frame."""
    thousandths = round(seconds * TIMECODE_FPS * 1000)
    frames, thousandth = divmod(thousandths, 1000)
    total, frame = divmod(frames, TIMECODE_FPS)
    return f"{total // 3600:02d}:{total // 60 % 60:02d}:{total % 60:02d}:{frame:02d}.{thousandth:03d}"


def head_angles(rigid: np.ndarray) -> np.ndarray:
    """(F, 3) yaw, pitch, roll in radians of poses (F, 4, 4) head to camera.

    Rotations about y (up), x (to the subject's left) and z (out of the face), applied as yaw * pitch * roll; all zero
    when the head faces the camera.
    """
    return Rotation.from_matrix(view_motion(rigid)[:, :3, :3]).as_euler("YXZ")


def eye_angles(curves: np.ndarray) -> np.ndarray:
    """(F, 6) yaw, pitch, roll of the left and the right eye in radians, from the eyeLook curves (F, 52)."""
    level = dict(zip(ARKIT_NAMES, curves.T, strict=True))
    out = []
    for side, away in (("Left", 1.0), ("Right", -1.0)):
        out.append(GAZE * away * (level[f"eyeLookOut{side}"] - level[f"eyeLookIn{side}"]))
        out.append(GAZE * (level[f"eyeLookDown{side}"] - level[f"eyeLookUp{side}"]))
        out.append(np.zeros(len(curves)))
    return np.stack(out, axis=1)


def write_arkit_csv(path: str | os.PathLike, performance: Performance) -> None:
    """Write one row per frame, whole or not at all."""
    rows = np.hstack([performance.curves, head_angles(performance.rigid), eye_angles(performance.curves)])
    times = increasing(performance.timestamps)
    count = len(ARKIT_NAMES) + len(ROTATIONS)
    lines = [",".join(HEADER)]
    lines += [f"{timecode(t)},{count}," + ",".join(f"{v:.9g}" for v in row) for t, row in zip(times, rows, strict=True)]
    temporary = f"{os.fspath(path)}.part"
    Path(temporary).write_text("\n".join(lines) + "\n", encoding="utf-8")
    os.replace(temporary, path)


def read_arkit_csv(path: str | os.PathLike) -> Performance:
    """Read a file of :func:`write_arkit_csv` or Live Link Face; poses hold the head's rotation, at the origin.

    Raises :class:`FileFormatError` naming the file, the line and the reason.
    """
    path = Path(path)
    if not path.is_file():
        raise FileFormatError(f"{path}: no such file")
    if path.stat().st_size > MAX_BYTES:
        raise FileFormatError(f"{path}: larger than {MAX_BYTES >> 20} MiB")
    lines = path.read_text(encoding="utf-8-sig", errors="replace").splitlines()
    if not lines or [word.strip().lower() for word in lines[0].split(",")] != [name.lower() for name in HEADER]:
        raise FileFormatError(f"{path}: the first line is not Live Link Face's: Timecode,BlendShapeCount,...")
    times, rows = [], []
    for number, line in enumerate(lines[1:], start=2):
        if not line.strip():
            continue
        words = line.split(",")
        try:
            times.append(_seconds(words[0]))
            rows.append([float(word) for word in words[2:]])
        except ValueError:
            raise FileFormatError(f"{path}, line {number}: a timecode and numbers are expected") from None
        if len(rows[-1]) != len(HEADER) - 2:
            raise FileFormatError(f"{path}, line {number}: {len(words)} columns instead of {len(HEADER)}")
    values = np.array(rows, float).reshape(-1, len(HEADER) - 2)
    if not len(values) or not np.isfinite(values).all():
        raise FileFormatError(f"{path}: {'values that are not finite' if len(values) else 'no rows'}")
    count = len(ARKIT_NAMES)
    rigid = np.tile(np.eye(4), (len(values), 1, 1))
    rigid[:, :3, :3] = CAMERA_TO_VIEW @ Rotation.from_euler("YXZ", values[:, count : count + 3]).as_matrix()
    return Performance(np.clip(values[:, :count], 0, 1), increasing(np.array(times)), rigid)


def _seconds(text: str) -> float:
    hours, minutes, seconds, frames = text.strip().split(":")
    return int(hours) * 3600 + int(minutes) * 60 + int(seconds) + float(frames) / TIMECODE_FPS
