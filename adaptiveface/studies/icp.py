"""Run rigid ICP on one frame and keep every iterate, and measure head poses against the truth (section 4.1)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..evaluation import neutral_alignment, pose_error
from ..geometry.frame import RgbdFrame
from ..geometry.mesh import transform_points
from ..parameters import DepthParameters, Parameters
from ..registration.association import Correspondences, find_correspondences
from ..registration.icp import icp
from ..registration.step import apply_rigid_update, motion_of, point_to_plane_step
from ..registration.surface import crop_window, depth_surface
from ..tracking.rigid import StepSolver
from .session import Session


@dataclass(frozen=True)
class IcpRun:
    """The iterates of rigid ICP.

    Attributes
    ----------
    poses : (I + 1, 4, 4)
        Before the first step and after every one, head frame to camera frame, mm.
    residuals : (I + 1,)
        Mean distance of the matches at each pose, mm.
    matches : (I + 1,)
        Their number.
    """

    poses: np.ndarray
    residuals: np.ndarray
    matches: np.ndarray


def displaced(pose: np.ndarray, centre: np.ndarray, shift: float, turn: float) -> np.ndarray:
    """Move a pose (4, 4) by ``shift`` mm sideways and forwards, and turn it by ``turn`` degrees about the vertical."""
    update = np.concatenate([np.radians(turn) * np.array([0.0, 1.0, 0.0]), shift * np.array([0.8, 0.0, -0.6])])
    return apply_rigid_update(pose, update, transform_points(pose, centre))


def run_icp(
    frame: RgbdFrame,
    shape: np.ndarray,
    normals: np.ndarray,
    start: np.ndarray,
    max_distance: float,
    iterations: int = 12,
    step: StepSolver = point_to_plane_step,
) -> IcpRun:
    """Run rigid ICP on one frame and keep every iterate.

    Parameters
    ----------
    frame : RgbdFrame
        With depth.
    shape, normals : (n, 3)
        Points in the head frame, mm, and their unit normals.
    start : (4, 4)
        The first pose, head frame to camera frame, mm.
    max_distance : float
        Matches that are farther apart are dropped, mm.
    iterations : int
        Largest number of steps.
    step : callable
        ``step(points, correspondences, centre, vertex_weights)`` -> (6,), the update of the pose.

    Returns
    -------
    IcpRun
        Every pose, with the number of its matches and their mean distance.
    """
    pixels = frame.camera.project(transform_points(start, shape))
    surface = depth_surface(frame.depth, frame.camera, crop_window(frame.camera, pixels, 40.0), DepthParameters())
    weights, middle = np.ones(len(shape)), shape.mean(axis=0)

    def associate(pose: np.ndarray) -> Correspondences:
        return find_correspondences(surface, shape, normals, max_distance, pose)

    def advance(pose: np.ndarray, matches: Correspondences) -> tuple[np.ndarray, float]:
        centre = transform_points(pose, middle)
        update = step(matches.points, matches, centre, weights)
        return apply_rigid_update(pose, update, centre), motion_of(update)

    run = list(icp(start, associate, advance, lambda matches: matches.count, 6, iterations))
    residuals, counts = [i.matches.mean_distance for i in run], [i.matches.count for i in run]
    return IcpRun(np.array([i.pose for i in run]), np.array(residuals), np.array(counts))


def depth_points(frame: RgbdFrame, pose: np.ndarray, centre: np.ndarray, radius: float = 130.0, stride: int = 3) -> np.ndarray:
    """Back-project the depth around the head.

    Parameters
    ----------
    frame : RgbdFrame
        With depth.
    pose : (4, 4)
        Head frame to camera frame, mm.
    centre : (3,)
        Of the head, in the head frame, mm.
    radius : float
        Largest distance of points from the centre, mm.
    stride : int
        Every so many-th pixel of every so many-th row is used.

    Returns
    -------
    (p, 3)
        Measured points in the head frame, mm.
    """
    v, u = np.mgrid[0 : frame.depth.shape[0] : stride, 0 : frame.depth.shape[1] : stride]
    depth = frame.depth[::stride, ::stride]
    pixels = np.stack([u[depth > 0], v[depth > 0]], axis=1).astype(float)
    points = transform_points(np.linalg.inv(pose), frame.camera.back_project(pixels, depth[depth > 0]))
    return points[np.linalg.norm(points - centre, axis=1) < radius]


def rotation_angle(a: np.ndarray, b: np.ndarray) -> float:
    """Angle between two poses (4, 4), degrees."""
    return float(np.degrees(np.arccos(np.clip((np.trace(a[:3, :3].T @ b[:3, :3]) - 1) / 2, -1, 1))))


def pose_errors(session: Session, **changes) -> np.ndarray:
    """Track a session whose truth is known, and measure the head pose.

    Parameters
    ----------
    session : Session
        With ``truth``.
    **changes
        Parameters that differ from our defaults, as ``stage__name=value``.

    Returns
    -------
    (F, 2)
        Error of every tracked frame, mm and degrees.
    """
    truth, actor = session.truth, session.actor
    assert truth is not None
    alignment = neutral_alignment(actor.neutral, truth.neutral, actor.frontal)
    centre = truth.neutral[actor.frontal].mean(axis=0)
    return np.array(
        [
            pose_error(result.head_pose, truth[frame.index].head_pose, alignment, centre)
            for result, frame in zip(session.tracked(Parameters().replace(**changes)), session.frames, strict=True)
            if result.tracked
        ]
    )
