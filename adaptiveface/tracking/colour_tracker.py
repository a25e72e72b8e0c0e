"""Track without depth: the 2D features alone drive pose, expression and deformation. The result is marked as degraded.

If the frames bring the detector's landmarks, those of the actor's set replace the 40 features. Each is weighed by its measured
reliability. Nose and jaw distinguish a mouth that opens from a head that tips back, which the 40 features cannot. Errors that
many landmarks share do not turn the head (``shared_errors``).

A colour camera cannot tell the size of the head and therefore its distance (those of the rig are used), motion along the
viewing direction, and anything between the features. Nothing is learned, because a corrective needs depth.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..geometry.camera import Camera
from ..geometry.frame import Features2D, RgbdFrame
from ..geometry.mesh import transform_points
from ..model.actor import Actor
from ..model.feature_set import opening_of
from ..parameters import Parameters
from .base import Tracker, timed
from .detection import pose_from_features
from .expression import HeldPose
from .feature_rows import reprojection_errors
from .shared_errors import SharedErrors, errors_of
from .stages import Stages
from .tracker import FaceTracker
from .types import STAGE_NAMES, TrackedFrame
from .verdict import NO_FACE

#: The parameters' pixels are those of a depth camera with about this focal length, px. Frames are scaled to it.
REFERENCE_FOCAL = 525.0
#: Factor for the confidence of detected features, which is low because it is meant for frames with depth.
ALONE = 1.0 / 0.3
#: Factor that weakens all features against the penalties. With errors of a pixel, they would bend the face.
TRUST = 0.15
#: Penalties on the head's motion from frame to frame, per rad^2 and per mm^2, in the units of equation (1).
TURN, SHIFT = 300.0, 0.005
#: Smallest number of features that make a visible face.
MIN_FEATURES = 6
#: Rounds of the joint fit after the pose was found again, because the fit starts farther away.
FIRST_ROUNDS = 3
#: Weight of the landmarks relative to independent ones, because errors of neighbours are similar beyond ``shared_errors``.
SHARE = 0.6
#: A landmark counts half if its error exceeds the common one by this many deviations.
OUTLIER = 3.0
#: Weight of a confidence of 1 at the reference focal length, 1/mm^2.
CERTAIN = 5e-5 * REFERENCE_FOCAL**2


class ColourTracker(Tracker):
    """Section 4 on frames without depth: equation (1)'s feature rows only, and w1 = 0. It learns no correctives."""

    def __init__(self, actor: Actor, parameters: Parameters | None = None, stages: Stages | None = None) -> None:
        given, self.landmarks = actor, None if actor.landmarks is None else actor.landmarks.fitted
        if self.landmarks is not None:
            # The 40 features serve recorded and synthetic frames, which have no landmarks.
            triangles = np.concatenate([actor.feature_triangles, self.landmarks.triangles])
            weights = np.concatenate([actor.feature_weights, self.landmarks.weights])
            actor = replace(actor, feature_triangles=triangles, feature_weights=weights)
            forty = len(given.feature_triangles)
            self._errors = np.pad(errors_of(self.landmarks.ids), ((forty, 0), (0, 0), (0, 0))) * REFERENCE_FOCAL
        super().__init__(actor, parameters, stages)
        self.given = given

    def track(self, frame: RgbdFrame) -> TrackedFrame:
        """Track one frame. A bad frame raises nothing: ``tracked`` is then False, and ``reason`` says why."""
        last, ms = self.state, dict.fromkeys(STAGE_NAMES, 0.0)
        if frame.features is None or frame.features.valid.sum() < MIN_FEATURES:
            return self._lose(frame, ms, NO_FACE)
        face, camera, frame = frame.features.face, frame.camera, self._observed(frame)
        with timed(ms, "rigid"):
            pose, rounds = self._find_pose(frame)
        if pose is None:
            return self._lose(frame, ms, "no pose of the head explains the features")
        with timed(ms, "blendshapes"):  # equations (1) and (2) without the depth term
            x = last.coefficients
            held = None if self.state.pose is None else HeldPose(self.state.pose, TURN, SHIFT)
            shared = self._shared_errors()
            for _ in range(rounds):
                pose, x = self.blendshapes.fit(None, frame.features, frame.camera, pose, x, None, held, shared=shared)
            x = self._filtered(x)  # after the pose, because features alone move it too far for coefficients that lag
            v1 = self.blendshapes.shape(x)
        if not in_front(pose) or self._error(frame, pose, x) > 2.0 * self.parameters.rigid.max_reprojection_error:
            return self._lose(frame, ms, "the face in the picture does not fit the head")
        with timed(ms, "laplacian"):  # section 4.3 with w1 = 0 is the step of section 4.4
            v2 = self._deform_to_features(frame, pose, v1)
        with timed(ms, "projection"):
            v3, parts = self._project(v1, v2)
        with timed(ms, "final_deformation"):
            v4 = self._deform_to_features(frame, pose, v3)
        with timed(ms, "resolve"):  # section 6
            coefficients = self.blendshapes.resolve(v4, x)
        self.state = replace(self.state, pose=pose, coefficients=x, v1=v1, v4=v4)
        meshes, held_out = (v1, v2, v3, v4), self.held_out.measure(face, camera, pose, v4, x)
        return self._tracked(frame, pose, meshes, (x, coefficients), parts.distances(), ms, held_out)

    def _observed(self, frame: RgbdFrame) -> RgbdFrame:
        """The frame at the reference focal length. Its features are the landmarks if it has them, and otherwise the 40."""
        frame = at_reference_focal(frame)
        if self.landmarks is None:
            return frame
        features, landmarks = frame.seen, self.landmarks
        forty = len(features.confidence)
        pixels, trust, own = np.full((len(landmarks), 2), np.nan), np.zeros(len(landmarks)), features.confidence
        if features.face is not None:
            x = self.state.coefficients
            points = self.blendshapes.feature_points(x)
            pose = self.pose if self.pose is not None else pose_from_features(frame, points[:forty])
            if pose is not None:
                opening = opening_of(self.actor.expression_names, x)
                slides = landmarks.slides(pose, frame.camera, points[forty:], opening)
                pixels, own = landmarks.pixels(features) - slides, np.zeros(forty)
                trust = landmarks.trust(pose)
                trust = np.minimum(SHARE / CERTAIN * trust * _believed(pixels, points[forty:], trust, pose, frame.camera), 1.0)
        joined = Features2D(np.concatenate([features.pixels, pixels]), np.concatenate([own, trust]))
        return replace(frame, features=joined)

    def _shared_errors(self) -> SharedErrors | None:
        """What the detector's landmarks have in common; None for an actor without landmarks."""
        if self.landmarks is None:
            return None
        return SharedErrors(self._errors, SHARE * self.parameters.blendshapes.w * REFERENCE_FOCAL**2 / CERTAIN)

    def _find_pose(self, frame: RgbdFrame) -> tuple[np.ndarray | None, int]:
        """The last pose if it still fits roughly, or one from the features (perspective-n-point), and the rounds to fit."""
        pose, x = self.state.pose, self.state.coefficients
        if pose is not None and self._error(frame, pose, x) < 5.0 * self.parameters.rigid.max_reprojection_error:
            return pose, 1
        self.state = replace(self.state, pose=None)  # a wrong pose must not be held
        return pose_from_features(frame, self.blendshapes.feature_points(x)), FIRST_ROUNDS

    def _error(self, frame: RgbdFrame, pose: np.ndarray, x: np.ndarray) -> float:
        """Median distance of the features in the picture from the model's, px at the reference focal length."""
        points = transform_points(pose, self.blendshapes.feature_points(x))
        if (points[:, 2] < 1.0).any():
            return np.inf
        return float(np.median(reprojection_errors(frame.seen, frame.camera, points)))

    def _lose(self, frame: RgbdFrame, ms: dict[str, float], reason: str) -> TrackedFrame:
        self.forget()
        return self.untracked(frame, reason, ms)


def _believed(pixels: np.ndarray, points: np.ndarray, trust: np.ndarray, pose: np.ndarray, camera: Camera) -> np.ndarray:
    """Weights (L,) in (0, 1] of landmarks at ``pixels`` (L, 2), which the last frame's face has at ``points`` (L, 3).

    Expressions that the rig lacks move some landmarks far, and would turn the head. The motion of the whole head since that
    frame, which is the landmarks' median, is not an error. ``trust`` (L,) is in 1/mm^2.
    """
    expected = transform_points(pose, points)
    if (expected[:, 2] < 1.0).any():
        return np.ones(len(points))
    off = (pixels - camera.project(expected)) * expected[:, 2:] / camera.fx
    square: np.ndarray = ((off - np.median(off, axis=0)) ** 2).sum(axis=1) * trust
    return 1.0 / (1.0 + square / OUTLIER**2)


def in_front(pose: np.ndarray) -> bool:
    """Whether a pose (4, 4) places the face in front of the camera and turned towards it."""
    return bool(np.isfinite(pose).all() and 100.0 < pose[2, 3] < 5000.0 and pose[2, 2] < 0.0)


def at_reference_focal(frame: RgbdFrame) -> RgbdFrame:
    """Scale a frame's features and camera to :data:`REFERENCE_FOCAL`, so that every threshold keeps its meaning.

    Depth is left out, so that the tracker cannot use it.
    """
    camera = frame.camera
    scale = REFERENCE_FOCAL / camera.fx
    size = max(1, round(camera.width * scale)), max(1, round(camera.height * scale))
    scaled = Camera(*size, camera.fx * scale, camera.fy * scale, camera.cx * scale, camera.cy * scale)
    seen = frame.seen
    alone, face = np.minimum(ALONE * seen.confidence, 1.0), seen.face
    if face is not None:
        face = replace(face, mesh=face.mesh * scale)
    features = Features2D(seen.pixels * scale, TRUST * alone, face)
    return replace(frame, depth=np.zeros((1, 1), np.float32), camera=scaled, features=features)


def make_tracker(actor: Actor, parameters: Parameters | None = None, colour_only: bool = False) -> Tracker:
    """Make the tracker for a source.

    Parameters
    ----------
    actor : Actor
        The rig of the person.
    parameters : Parameters, optional
        Our defaults without.
    colour_only : bool
        Whether the source has no depth.

    Returns
    -------
    Tracker
        A :class:`FaceTracker`, or without depth a :class:`ColourTracker`.
    """
    return ColourTracker(actor, parameters) if colour_only else FaceTracker(actor, parameters)
