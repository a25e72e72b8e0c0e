"""Where the eyes look: irises in the picture, on the actor's own eyeballs.

The ray from the camera through the centre of an iris meets the eyeball, which is known in the head's frame, and the
direction from the ball's centre to that point is the gaze. Tracking has no part in it, and knows of no detector.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..geometry.camera import Camera
from ..geometry.frame import FEATURE_IDS, Features2D
from ..geometry.mesh import surface_points, transform_points
from ..model.actor import Actor
from . import make_insides
from .parts import CORNEA

#: iBUG numbers of the corners, and pairs of upper and lower lid, by eye.
_CORNERS = ((42, 45), (36, 39))
_LIDS = (((43, 47), (44, 46)), ((37, 41), (38, 40)))
#: A lid gap of less than this share of the eye's width hides the iris.
CLOSED = 0.13
#: The mean confidence of an eye's corners below which it is turned away.
_TURNED_AWAY = 0.02
#: Largest turn of an eye, rad. Farther ones are mistakes.
LARGEST = (0.8, 0.7)
#: Smoothing: share of the way to a new measurement, at rest and from a jump of ``_JUMP`` rad on.
_CALM, _JUMP = 0.4, 0.12


def _row(number: int) -> int:
    return int(np.flatnonzero(np.asarray(FEATURE_IDS) == number)[0])


_CORNER_ROWS = np.array([[_row(n) for n in pair] for pair in _CORNERS])
_LID_ROWS = np.array([[[_row(n) for n in pair] for pair in eye] for eye in _LIDS])


class GazeEstimator:
    """Gaze of one actor, frame by frame; ``available`` is False where its mesh has no known eyeballs."""

    def __init__(self, actor: Actor) -> None:
        self._actor = actor
        self._insides = make_insides(actor.neutral, actor.triangles)

    @property
    def available(self) -> bool:
        """Whether there are eyeballs to measure on."""
        return self._insides is not None

    def measure(self, skin: np.ndarray, pose: np.ndarray, camera: Camera, features: Features2D | None) -> np.ndarray:
        """(2, 2) yaw to the subject's left and pitch upwards, rad, of the left and the right eye; NaN where unknown.

        skin (N, 3) mm, head frame; pose (4, 4) head to camera. Pixels are moved so that the detected corners of an eye
        meet those of the tracked face. An eye is unknown where its lids are closed, where it is turned away, and where no
        iris was detected.
        """
        gaze = np.full((2, 2), np.nan)
        irises = None if features is None else features.iris_centres
        if not self.available or irises is None:
            return gaze
        marks = surface_points(skin, self._actor.feature_triangles, self._actor.feature_weights)
        shown = camera.project(transform_points(pose, marks))
        for side in range(2):
            corners = _CORNER_ROWS[side]
            if not self._open(features, side):
                continue
            shift = (shown[corners] - features.pixels[corners]).mean(axis=0)
            if np.isfinite(irises[side] + shift).all():
                gaze[side] = self._direction(irises[side] + shift, pose, camera, side)
        if np.isfinite(gaze).all():  # eyes move up and down together
            gaze[:, 1] = gaze[:, 1].mean()
        return gaze

    def see(self, tracked, frame) -> np.ndarray | None:
        """:meth:`measure` in a tracked frame and the :class:`~adaptiveface.geometry.frame.RgbdFrame` that it came from.

        None without a face.
        """
        if not tracked.tracked or frame is None:
            return None
        return self.measure(tracked.v4, tracked.head_pose, frame.camera, frame.features)

    def _open(self, features: Features2D, side: int) -> bool:
        corners, pixels = _CORNER_ROWS[side], features.pixels
        if features.confidence[corners].mean() < _TURNED_AWAY:
            return False
        width = np.linalg.norm(pixels[corners[0]] - pixels[corners[1]])
        gap = np.linalg.norm(pixels[_LID_ROWS[side][:, 0]] - pixels[_LID_ROWS[side][:, 1]], axis=1).mean()
        return bool(gap > CLOSED * width)  # False for NaN

    def _direction(self, pixel: np.ndarray, pose: np.ndarray, camera: Camera, side: int) -> np.ndarray:
        """(2,) yaw and pitch of the eye whose iris is seen at ``pixel``, or NaN."""
        ray = np.array([(pixel[0] - camera.cx) / camera.fx, (pixel[1] - camera.cy) / camera.fy, 1.0])
        ray = pose[:3, :3].T @ (ray / np.linalg.norm(ray))
        start = -pose[:3, :3].T @ pose[:3, 3] - self._insides.eye_centres[side]
        radius = self._insides.eye_radii[side] * (1 + CORNEA)
        along = -float(start @ ray)
        inside = radius**2 - float(start @ start) + along**2
        if inside <= 0:
            return np.full(2, np.nan)
        x, y, z = (start + (along - np.sqrt(inside)) * ray) / radius
        found = np.array([np.arctan2(x, z), np.arcsin(np.clip(y, -1, 1))])
        return found if (np.abs(found) <= LARGEST).all() else np.full(2, np.nan)


class GazeTrack:
    """The gaze over a take: what is unknown is held, what jitters is calmed, jumps of the eyes pass.

    It takes frames one by one. ``keep``: :meth:`arrays` gives all of them at the end.
    """

    def __init__(self, actor: Actor, keep: bool = True) -> None:
        self._estimator = GazeEstimator(actor)
        self._now = np.zeros((2, 2))
        self._begun = np.zeros(2, bool)
        self._kept: list | None = [] if keep else None

    def add(self, measured: np.ndarray | None) -> np.ndarray:
        """Take (2, 2) rad, NaN where unknown, or None for a frame without a face; the smoothed gaze (2, 2)."""
        measured = np.full((2, 2), np.nan) if measured is None else measured
        known = np.isfinite(measured).all(axis=1)
        if known.any():  # an eye that is not seen looks where the other one does
            measured = np.where(known[:, None], measured, measured[known].mean(axis=0))
            step = measured - self._now
            share = np.clip(np.abs(step).max(axis=1) / _JUMP, _CALM, 1.0)
            share[~self._begun] = 1.0
            self._now = self._now + share[:, None] * step
            self._begun[:] = True
        if self._kept is not None:
            self._kept.append((self._now, known))
        return self._now

    def see(self, tracked, frame) -> np.ndarray:
        """The gaze (2, 2) in a tracked frame and the :class:`~adaptiveface.geometry.frame.RgbdFrame` that it came from."""
        return self.add(self._estimator.see(tracked, frame))

    @property
    def begun(self) -> bool:
        """Whether an iris was seen so far."""
        return bool(self._begun.any())

    def arrays(self) -> dict[str, np.ndarray]:
        """``gaze`` (F, 2, 2) float32 and ``gaze_known`` (F, 2) for a result; nothing where no iris was ever seen."""
        if not self.begun or not self._kept:
            return {}
        gaze, known = zip(*self._kept, strict=True)
        return {"gaze": np.array(gaze, np.float32), "gaze_known": np.array(known)}

    def onto(self, result):
        """The :class:`~adaptiveface.result.Result` with the gaze of its frames; as it is where no iris was seen.

        An interruption may have come between a frame of the result and its gaze: then the last gaze is held.
        """
        arrays, count = self.arrays(), len(result)
        if not arrays or not count:
            return result
        last = np.minimum(np.arange(count), len(arrays["gaze"]) - 1)
        return replace(result, **{name: array[last] for name, array in arrays.items()})
