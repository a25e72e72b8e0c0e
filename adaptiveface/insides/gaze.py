"""Measure where the eyes look, from the irises in the picture and the actor's own eyeballs.

A ray from the camera through the centre of an iris meets the eyeball, whose place in the head frame is known. The gaze is
the direction from the ball's centre to that point. Tracking neither uses the gaze nor knows of any detector.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..geometry.camera import Camera
from ..geometry.frame import FEATURE_IDS, Features2D
from ..geometry.mesh import surface_points, transform_points
from ..model.actor import Actor
from .head import Insides, make_insides
from .parts import CORNEA

#: iBUG numbers of each eye's corners, and of its pairs of upper and lower lid points.
_CORNERS = ((42, 45), (36, 39))
_LIDS = (((43, 47), (44, 46)), ((37, 41), (38, 40)))
#: The iris counts as hidden when the gap between the lids is less than this share of the eye's width.
CLOSED = 0.13
#: An eye counts as turned away when the mean confidence of its corners is below this.
_TURNED_AWAY = 0.02
#: Largest yaw and pitch of an eye, rad. Larger values are measurement errors.
LARGEST = (0.8, 0.7)
#: Smoothing: each frame moves the gaze by the share ``_CALM`` towards a new measurement, and all the way for jumps of ``_JUMP``
#: rad or more.
_CALM, _JUMP = 0.4, 0.12


def _row(number: int) -> int:
    return int(np.flatnonzero(np.asarray(FEATURE_IDS) == number)[0])


_CORNER_ROWS = np.array([[_row(n) for n in pair] for pair in _CORNERS])
_LID_ROWS = np.array([[[_row(n) for n in pair] for pair in eye] for eye in _LIDS])


class GazeEstimator:
    """Measures the gaze of one actor frame by frame; ``available`` is False if the actor's mesh has no known eyeballs."""

    def __init__(self, actor: Actor) -> None:
        self._actor = actor
        self._insides = make_insides(actor.neutral, actor.triangles)

    @property
    def available(self) -> bool:
        """Whether there are eyeballs to measure on."""
        return self._insides is not None

    def measure(self, skin: np.ndarray, pose: np.ndarray, camera: Camera, features: Features2D | None) -> np.ndarray:
        """Measure the gaze of both eyes in one frame.

        Each iris is shifted so that the detected corners of its eye meet those of the tracked face.

        Parameters
        ----------
        skin : (N, 3) array
            Vertices of the face in the head frame, mm.
        pose : (4, 4) array
            Head to camera.
        camera : Camera
            The camera of the colour image.
        features : Features2D or None
            The detected features with the irises.

        Returns
        -------
        (2, 2) array
            Yaw to the subject's left and pitch upwards, rad, of the left and the right eye. NaN for an eye that is closed,
            is turned away, or has no detected iris.
        """
        gaze = np.full((2, 2), np.nan)
        irises = None if features is None else features.iris_centres
        if self._insides is None or features is None or irises is None:
            return gaze
        marks = surface_points(skin, self._actor.feature_triangles, self._actor.feature_weights)
        shown = camera.project(transform_points(pose, marks))
        for side in range(2):
            corners = _CORNER_ROWS[side]
            if not self._open(features, side):
                continue
            shift = (shown[corners] - features.pixels[corners]).mean(axis=0)
            if np.isfinite(irises[side] + shift).all():
                gaze[side] = _direction(self._insides, irises[side] + shift, pose, camera, side)
        if np.isfinite(gaze).all():  # eyes move up and down together
            gaze[:, 1] = gaze[:, 1].mean()
        return gaze

    def see(self, tracked, frame) -> np.ndarray | None:
        """Call :meth:`measure` for a tracked frame and the :class:`~adaptiveface.geometry.frame.RgbdFrame` it came from.

        Returns None if the frame shows no face.
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


def _direction(insides: Insides, pixel: np.ndarray, pose: np.ndarray, camera: Camera, side: int) -> np.ndarray:
    """Find yaw and pitch (2,) of an eye with its iris at ``pixel``, rad. They are NaN for a missed ball or too large a turn."""
    ray = np.array([(pixel[0] - camera.cx) / camera.fx, (pixel[1] - camera.cy) / camera.fy, 1.0])
    ray = pose[:3, :3].T @ (ray / np.linalg.norm(ray))
    start = -pose[:3, :3].T @ pose[:3, 3] - insides.eye_centres[side]
    radius = insides.eye_radii[side] * (1 + CORNEA)
    along = -float(start @ ray)
    inside = radius**2 - float(start @ start) + along**2
    if inside <= 0:
        return np.full(2, np.nan)
    x, y, z = (start + (along - np.sqrt(inside)) * ray) / radius
    found = np.array([np.arctan2(x, z), np.arcsin(np.clip(y, -1, 1))])
    return found if (np.abs(found) <= LARGEST).all() else np.full(2, np.nan)


class GazeTrack:
    """The gaze over a take, frame by frame.

    Unknown gaze keeps its last value. Jitter is smoothed, and jumps of the eyes are not.

    Parameters
    ----------
    actor : Actor
        The tracked actor.
    keep : bool
        Whether to keep every frame for :meth:`arrays`.
    """

    def __init__(self, actor: Actor, keep: bool = True) -> None:
        self._estimator = GazeEstimator(actor)
        self._now = np.zeros((2, 2))
        self._begun = np.zeros(2, bool)
        self._kept: list | None = [] if keep else None

    def add(self, measured: np.ndarray | None) -> np.ndarray:
        """Add the measurement of one frame and return the smoothed gaze.

        Parameters
        ----------
        measured : (2, 2) array or None
            As :meth:`GazeEstimator.measure` returns it. None for a frame without a face.

        Returns
        -------
        (2, 2) array
            Yaw and pitch of the left and the right eye, rad.
        """
        measured = np.full((2, 2), np.nan) if measured is None else measured
        known = np.isfinite(measured).all(axis=1)
        if known.any():  # an eye that is not seen is assumed to look where the other one does
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
        """Measure, add and return the gaze (2, 2) of a tracked frame, given the input frame that it came from."""
        return self.add(self._estimator.see(tracked, frame))

    @property
    def begun(self) -> bool:
        """Whether an iris has been seen so far."""
        return bool(self._begun.any())

    def arrays(self) -> dict[str, np.ndarray]:
        """Return ``gaze`` (F, 2, 2) float32, rad, and ``gaze_known`` (F, 2) bool for a result, or {} if no iris was seen."""
        if not self.begun or not self._kept:
            return {}
        gaze, known = zip(*self._kept, strict=True)
        return {"gaze": np.array(gaze, np.float32), "gaze_known": np.array(known)}

    def onto(self, result):
        """Return the :class:`~adaptiveface.result.Result` with the gaze of its frames, or unchanged if no iris was seen.

        A run that was interrupted may have tracked a frame without measuring its gaze. Such frames repeat the last gaze.
        """
        arrays, count = self.arrays(), len(result)
        if not arrays or not count:
            return result
        last = np.minimum(np.arange(count), len(arrays["gaze"]) - 1)
        return replace(result, **{name: array[last] for name, array in arrays.items()})
