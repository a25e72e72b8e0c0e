"""Estimate the neutral without depth, from the 2D features of some frames.

With the detector's landmarks, identity, poses and expressions of all frames are solved together (``neutral/bundle.py``), so
that no frame must be neutral. With the 40 features alone, poses and identity of neutral frames are solved. Pictures do not show
the size of the head, because a larger head farther away looks the same. It remains that of the average head.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..errors import TrackingError
from ..geometry.frame import RgbdFrame
from ..geometry.mesh import surface_points, transform_points
from ..model.actor import Actor
from ..model.face_model import FaceModel, embedded_face_model
from ..model.feature_set import FeatureSet
from ..parameters import Parameters
from ..registration.step import apply_rigid_update
from ..tracking.detection import pose_from_features
from ..tracking.feature_rows import feature_rows, turns
from .bundle import Bundle, View, solve_bundle
from .capture import build_actor
from .expression import scored_coefficients
from .features import calibrated_features, constraints_on
from .fuse import FusedScan
from .plausible import check_identity

DEFAULTS = Parameters()
#: Deviation of the rays from the points of features with full confidence (detected: 0.3), mm; Gauss-Newton rounds.
FEATURE_SIGMA, ROUNDS = 1.1, 8
#: Largest number of independent frames that all frames count as, because a detector's errors persist from frame to frame.
INDEPENDENT_FRAMES = 4.0
#: Largest number of frames that are solved together. More take time and add little.
MAX_VIEWS = 36
#: Smallest distance at which a person sits, and the distance to assume if a guessed focal length gives a smaller one, mm.
NEAREST, USUAL = 260.0, 450.0


@dataclass(frozen=True)
class ColourCapture:
    """The ``actor``, and the factor ``focal`` for the focal length of the frames' camera; it is 1 for a known camera."""

    actor: Actor
    focal: float = 1.0


def capture_colour_actor(
    frames: Sequence[RgbdFrame], model: FaceModel | None = None, parameters: Parameters = DEFAULTS
) -> Actor:
    """Return the actor of :func:`capture_colour` for frames of a calibrated camera."""
    return capture_colour(frames, model, parameters).actor


def capture_colour(
    frames: Sequence[RgbdFrame],
    model: FaceModel | None = None,
    parameters: Parameters = DEFAULTS,
    guessed_focal: bool = False,
) -> ColourCapture:
    """Fit the average head to a person's proportions, as far as 2D features show them.

    Parameters
    ----------
    frames : sequence of RgbdFrame
        Of one person. With the detector's landmarks any expressions are allowed, and different ones are better. With the 40
        features alone, the frames must be neutral.
    guessed_focal : bool
        Whether the camera is not calibrated. If its focal length would place the head nearer than a person sits, the pictures
        were cropped, and the focal length is increased.

    Returns
    -------
    ColourCapture
        The actor, and the factor for the focal length.

    Raises
    ------
    TrackingError
        No frame shows a face.
    """
    model = embedded_face_model() if model is None else model
    if model.landmarks is not None and any(frame.features is not None and frame.features.face for frame in frames):
        return _from_landmarks(frames, model, model.landmarks, parameters, guessed_focal)
    return ColourCapture(_from_features(frames, model, parameters))


def _from_features(frames: Sequence[RgbdFrame], model: FaceModel, parameters: Parameters) -> Actor:
    """Solve from the 40 features of neutral frames."""
    identity, seen, poses = fit_identity_to_features(frames, model, parameters.fit.modes)
    check_identity(identity)
    neutral = model.neutral(identity)
    actor = build_actor(model, neutral, identity=identity)
    empty, count = np.zeros((0, 3)), len(seen)
    rays = FusedScan(
        empty,
        empty,
        np.zeros(0),
        np.arange(count),
        poses,
        np.zeros(count),
        tuple(f.features for f in seen),
        tuple(f.camera for f in seen),
    )
    constraints = constraints_on(rays, model, neutral)
    places = calibrated_features(constraints, model, neutral, parameters.shrink_wrap.feature_shift)
    return replace(actor, feature_triangles=places[0], feature_weights=places[1])


def _from_landmarks(
    frames: Sequence[RgbdFrame], model: FaceModel, landmarks: FeatureSet, parameters: Parameters, guessed_focal: bool
) -> ColourCapture:
    """Solve from the detector's landmarks of frames with any expression."""
    focal = focal_factor(frames, model) if guessed_focal else 1.0
    frames = [replace(frame, camera=frame.camera.zoomed(focal)) for frame in frames]
    solved = solve_frames(frames, model, parameters.fit.modes)
    neutral = model.neutral(solved.identity)
    offset = landmarks.offset.copy()
    offset[~landmarks.held_out] += solved.offsets
    actor = replace(build_actor(model, neutral, identity=solved.identity), landmarks=replace(landmarks, offset=offset))
    return ColourCapture(actor, focal)


def focal_factor(frames: Sequence[RgbdFrame], model: FaceModel) -> float:
    """Factor for a guessed focal length: 1, or more if the head would be nearer than ``NEAREST``.

    Solving for it from the face's perspective was tried and rejected, because a video without a turn of the head halved it.
    """
    points = surface_points(model.mean, model.feature_triangles, model.feature_weights)
    poses = [pose_from_features(_without_depth(frame), points) for frame in frames if frame.features is not None]
    distance = np.median([pose[2, 3] for pose in poses if pose is not None] or [USUAL])
    return USUAL / float(distance) if distance < NEAREST else 1.0


def solve_frames(frames: Sequence[RgbdFrame], model: FaceModel, modes: int) -> Bundle:
    """Run :func:`solve_bundle` on at most ``MAX_VIEWS`` of the frames that show a face, spread evenly.

    Raises :class:`TrackingError` if no frame shows a face.
    """
    if model.landmarks is None:
        raise ValueError("the face model has no landmarks")
    landmarks = model.landmarks.fitted
    feature_points = surface_points(model.mean, model.feature_triangles, model.feature_weights)
    detected = [frame for frame in frames if frame.features is not None and frame.features.face is not None]
    picked = np.unique(np.linspace(0, len(detected) - 1, min(len(detected), MAX_VIEWS)).round().astype(int))
    views, poses = [], []
    for frame in (detected[k] for k in picked):
        pose = pose_from_features(_without_depth(frame), feature_points)
        face, pixels = frame.seen.face, landmarks.pixels(frame.seen)
        if pose is not None and face is not None and pixels is not None:
            poses.append(pose)
            views.append(View(pixels, frame.camera, scored_coefficients(face, model), float(pose[2, 3])))
    if not views:
        raise TrackingError(f"no face found in any of {len(frames)} frames")
    return solve_bundle(model, landmarks, views, np.array(poses), modes)


def fit_identity_to_features(
    frames: Sequence[RgbdFrame], model: FaceModel, modes: int
) -> tuple[np.ndarray, list[RgbdFrame], np.ndarray]:
    """Solve for identity coefficients (M,) and the pose (K, 4, 4) head to camera of each frame that shows a face.

    This is Gauss-Newton on all poses and coefficients. Each frame's pose is eliminated (Schur complement), so that the system
    has the size of the coefficients. Raises :class:`TrackingError` if no frame shows a face.
    """
    modes = min(modes, len(model.identity_modes))
    basis = np.einsum("fk,mfkd->fdm", model.feature_weights, model.identity_modes[:modes, model.feature_triangles])
    mean = surface_points(model.mean, model.feature_triangles, model.feature_weights)
    found = [(frame, pose_from_features(_without_depth(frame), mean)) for frame in frames]
    seen, poses = [f for f, pose in found if pose is not None], [pose for _, pose in found if pose is not None]
    if not seen:
        raise TrackingError(f"no face found in any of {len(frames)} neutral frames")
    weight = min(1.0, INDEPENDENT_FRAMES / len(seen)) / FEATURE_SIGMA**2
    identity: np.ndarray = np.zeros(modes)
    for _ in range(ROUNDS):
        parts = [_linearise(f, p, mean, basis, identity, weight) for f, p in zip(seen, poses, strict=True)]
        h, g = np.eye(modes), np.zeros(modes)  # the prior, because coefficients are in standard deviations
        for lhs, rhs, _ in parts:
            eliminated = np.linalg.solve(lhs[:6, :6], np.column_stack([lhs[:6, 6:], rhs[:6]]))
            h += lhs[6:, 6:] - lhs[6:, :6] @ eliminated[:, :-1]
            g += rhs[6:] - lhs[6:, :6] @ eliminated[:, -1]
        identity = np.linalg.solve(h, g)
        poses = [
            apply_rigid_update(pose, np.linalg.solve(lhs[:6, :6], rhs[:6] - lhs[:6, 6:] @ identity), centre)
            for pose, (lhs, rhs, centre) in zip(poses, parts, strict=True)
        ]
    return identity, seen, np.array(poses)


def _linearise(
    frame: RgbdFrame, pose: np.ndarray, mean: np.ndarray, basis: np.ndarray, identity: np.ndarray, weight: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Normal equations (6 + M) of one frame's features in (pose update, coefficients), and the centre of rotation."""
    rows = feature_rows(frame.features, frame.camera, pose)
    points = mean[rows.index] + basis[rows.index] @ identity
    in_camera = rows.rows @ pose[:3, :3].T
    moved = transform_points(pose, points)
    centre = moved.mean(axis=0)
    turn = turns(moved - centre, in_camera)
    jacobian = np.concatenate([turn, in_camera, rows.rows @ basis[rows.index]], axis=2) / frame.camera.fx
    jacobian = jacobian.reshape(-1, jacobian.shape[2])
    # The rows are linear in the coefficients, so their values are solved for; of the pose, the change is solved for.
    value = (np.einsum("fij,fj->fi", rows.rows, mean[rows.index]) + rows.offsets).ravel() / frame.camera.fx
    weights = np.repeat(weight * rows.weights, 2)[:, None]
    lhs = jacobian.T @ (weights * jacobian)
    lhs[np.arange(6), np.arange(6)] += 1e-9 * np.trace(lhs[:6, :6])
    return lhs, -(weights * jacobian).T @ value, centre


def _without_depth(frame: RgbdFrame) -> RgbdFrame:
    return replace(frame, depth=np.zeros((1, 1), np.float32))
