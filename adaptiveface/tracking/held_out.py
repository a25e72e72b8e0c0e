"""Measure how well a tracked face fits the picture, by landmarks that no fit has used, in percent of the eyes' distance.

The held-out landmarks have the same places on every face. They reveal a wrong head, a wrong pose and a wrong expression.
"""

from __future__ import annotations

import numpy as np

from ..geometry.camera import Camera
from ..geometry.frame import DetectedFace
from ..geometry.mesh import transform_points
from ..model.actor import Actor
from ..model.feature_set import opening_of

#: MediaPipe's numbers of the corners of the right and the left eye.
EYES = ((33, 133), (362, 263))
#: Above this error, %, the tracked face is not the visible one; it is reported after this number of frames.
BAD, MANY = 10.0, 0.05


class HeldOut:
    """Measures an actor's faces. ``regions`` names the R regions; it is empty for an actor without landmarks."""

    def __init__(self, actor: Actor) -> None:
        landmarks = actor.landmarks
        known = landmarks is not None and landmarks.held_out.any() and set(np.ravel(EYES)) <= set(landmarks.ids)
        self._landmarks = held = landmarks.select(landmarks.held_out) if landmarks is not None and known else None
        self.regions: tuple[str, ...] = ()
        self._expressions = actor.expression_names
        if landmarks is not None and held is not None:
            self.regions = tuple(dict.fromkeys(str(region) for region in held.regions))
            members = np.array([held.regions == region for region in self.regions])
            self._means = members / members.sum(axis=1, keepdims=True)
            points = dict(zip(landmarks.ids.tolist(), landmarks.points(actor.neutral), strict=True))
            right, left = (np.mean([points[number] for number in eye], axis=0) for eye in EYES)
            self._eyes = float(np.linalg.norm(left - right))

    def measure(
        self, face: DetectedFace | None, camera: Camera, pose: np.ndarray, vertices: np.ndarray, coefficients: np.ndarray
    ) -> np.ndarray:
        """Measure one frame.

        Parameters
        ----------
        face : DetectedFace or None
            The detected landmarks.
        camera : Camera
            Of the frame.
        pose : (4, 4)
            Head frame to camera frame, mm.
        vertices : (N, 3)
            The tracked face in the head frame, mm.
        coefficients : (A,)
            Of the actor's expressions.

        Returns
        -------
        (R,)
            Mean error of every region across the view, % of the eyes' distance; empty if nothing was detected.
        """
        landmarks = self._landmarks
        if landmarks is None or face is None:
            return np.zeros(0)
        places = landmarks.points(vertices)
        slides = landmarks.slides(pose, camera, places, opening_of(self._expressions, coefficients))
        points = transform_points(pose, places)
        off = face.mesh[landmarks.ids, :2] - slides - camera.project(points)
        error = np.linalg.norm(off / [camera.fx, camera.fy], axis=1) * points[:, 2] / self._eyes * 100.0
        means: np.ndarray = self._means @ error
        return means


def describe(errors: np.ndarray, regions: tuple[str, ...]) -> str:
    """Describe the errors (F, R) of tracked frames, % (0: not measured), on one line; "" if nothing was measured."""
    measured = errors[(errors > 0).any(axis=1)]
    if not len(measured):
        return ""
    frames = measured.mean(axis=1)
    worst = int(np.argmax(np.median(measured, axis=0)))
    return (
        f"held-out landmarks: off by {np.median(frames):.1f} % of the eyes' distance (median), "
        f"{np.percentile(frames, 95):.1f} % at 95 %; worst: {regions[worst]}, {np.median(measured[:, worst]):.1f} and "
        f"{np.percentile(measured[:, worst], 95):.1f} %"
    )


def warn(errors: np.ndarray, regions: tuple[str, ...]) -> str:
    """Warn, from errors (F, R), that the tracked face is not the visible one, and name the region; "" if it is."""
    measured = errors[(errors > 0).any(axis=1)]
    if not len(measured):
        return ""
    share = (measured > BAD).mean(axis=0)
    bad = [f"{region} in {100 * part:.0f} %" for region, part in zip(regions, share, strict=True) if part > MANY]
    if not bad:
        return ""
    where = f"{', '.join(bad)} of the frames"
    limit = f"{BAD:g} % of the eyes' distance"
    return f"the face does not fit what is seen: held-out landmarks are off by more than {limit} ({where})"
