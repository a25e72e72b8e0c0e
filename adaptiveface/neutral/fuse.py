"""Section 3, first step: depth frames of the neutral face, registered and merged into one scan."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from ..errors import FrameError, TrackingError
from ..face_model import FaceModel
from ..frame import Features2D, RgbdFrame
from ..mesh import surface_points, transform_points
from ..parameters import FusionParameters
from .registration import DepthView, Registration, align, depth_view, evaluate, feature_pose
from .volume import TsdfVolume

Progress = Callable[[str, float], None]


@dataclass(frozen=True)
class FusedScan:
    """The merged neutral scan, in a frame close to the model's head frame, mm.

    points, normals (P, 3); weights (P,): accumulated view weight, about the number of frames that saw the point; frames
    (K,) int: numbers of the frames used (positions in the sequence), poses (K, 4, 4): scan to camera of each; residuals
    (K,): median point-to-plane distance of each to the merged surface, mm; features: (K,) the 2D features of each, or
    None; cameras (K,).
    """

    points: np.ndarray
    normals: np.ndarray
    weights: np.ndarray
    frames: np.ndarray
    poses: np.ndarray
    residuals: np.ndarray
    features: tuple[Features2D | None, ...]
    cameras: tuple


def head_box(model: FaceModel, margin: float) -> np.ndarray:
    """(2, 3) corners of the model's frontal region, widened by ``margin`` mm: what belongs to the head."""
    face = model.mean[model.frontal]
    return np.stack([face.min(axis=0) - margin, face.max(axis=0) + margin])


def most_frontal(frames: Sequence[RgbdFrame], feature_points: np.ndarray) -> tuple[int, np.ndarray]:
    """The frame whose features show the face most from the front, and its pose (4, 4).

    Raises :class:`TrackingError` when no frame has usable features.
    """
    best = None
    for number, frame in _readable(frames):
        pose = feature_pose(frame, feature_points)
        if pose is None:
            continue
        turned = -(pose[:3, 2] @ pose[:3, 3]) / np.linalg.norm(pose[:3, 3])
        if best is None or turned > best[0]:
            best = (turned, number, pose)
    if best is None:
        raise TrackingError(
            "no face was found in the neutral frames: none has 2D features; record the face from the front, "
            "well lit, or supply features.csv"
        )
    return best[1], best[2]


def fuse_frames(
    frames: Sequence[RgbdFrame],
    model: FaceModel,
    parameters: FusionParameters = FusionParameters(),
    progress: Progress | None = None,
) -> FusedScan:
    """Register the frames to the growing model surface and merge them in a volume (paper, section 3).

    Starts at the most frontal frame, whose 2D features give the first pose, and walks forwards and backwards from
    there, each frame starting at its neighbour's pose. Aligning to the merged surface instead of the neighbour avoids
    drift; a second pass aligns every frame to the whole surface. Frames that cannot be registered are left out.
    Raises :class:`TrackingError` when no face is found.
    """
    feature_points = surface_points(model.mean, model.feature_triangles, model.feature_weights)
    first, pose = most_frontal(frames, feature_points)
    box = head_box(model, parameters.margin)
    poses = _first_pass(frames, first, pose, box, feature_points, parameters, progress)
    for number in range(1, parameters.passes):
        poses = _next_pass(frames, poses, box, parameters, progress, number)
    return _merged(frames, poses, box, parameters)


def _first_pass(frames, first, pose, box, feature_points, parameters, progress) -> dict[int, np.ndarray]:
    volume = _volume(box, parameters)
    start = depth_view(frames[first], pose, box)
    if start is None:
        raise TrackingError(f"frame {first} has 2D features but no depth at the face: check that colour and depth agree")
    volume.integrate(start, pose, parameters.min_cosine)
    poses = {first: pose}
    walk = [*range(first + 1, len(frames)), *range(first - 1, -1, -1)]
    last = pose
    for done, number in enumerate(walk):
        if number == first - 1:
            last = pose
        result = _register(frames, number, last, volume, box, parameters, feature_points)
        if result is not None:
            view, registration = result
            last = poses[number] = registration.pose
            volume.integrate(view, last, parameters.min_cosine)
        if progress is not None:
            progress("fuse", (done + 1) / len(walk) / parameters.passes)
    return poses


def _next_pass(frames, poses, box, parameters, progress, number) -> dict[int, np.ndarray]:
    volume = _volume(box, parameters)
    for k in sorted(poses):
        view = depth_view(frames[k], poses[k], box)
        if view is not None:
            volume.integrate(view, poses[k], parameters.min_cosine)
    model = _model_points(volume, parameters)
    refined = {}
    for done, k in enumerate(sorted(poses)):
        view = depth_view(frames[k], poses[k], box)
        if view is not None:
            registration = align(view, *model, poses[k], parameters)
            if _accepted(registration, parameters):
                refined[k] = registration.pose
        if progress is not None:
            progress("fuse", (number + (done + 1) / len(poses)) / parameters.passes)
    return refined or poses


def _register(frames, number, last, volume, box, parameters, feature_points) -> tuple[DepthView, Registration] | None:
    """Register one frame from its neighbour's pose, and once more from its own 2D features if that fails."""
    try:
        frame = frames[number]
    except FrameError:
        return None
    model = _model_points(volume, parameters)
    for start in (lambda: last, lambda: feature_pose(frame, feature_points)):
        pose = start()
        view = None if pose is None else depth_view(frame, pose, box)
        if view is None:
            continue
        registration = align(view, *model, pose, parameters)
        if _accepted(registration, parameters):
            return view, registration
    return None


def _accepted(registration: Registration, parameters: FusionParameters) -> bool:
    return registration.residual < parameters.max_residual and registration.overlap > parameters.min_overlap


def _merged(frames, poses, box, parameters) -> FusedScan:
    volume = _volume(box, parameters)
    views = {}
    for k in sorted(poses):
        views[k] = depth_view(frames[k], poses[k], box)
        volume.integrate(views[k], poses[k], parameters.min_cosine)
    points, normals, weights = volume.surface(min_weight=min(parameters.min_views, 0.5 * len(poses)))
    if len(points) < 1000:
        raise TrackingError(f"the merged scan holds only {len(points)} points: the depth frames do not show a face")
    sample = slice(None, None, max(1, len(points) // parameters.icp_points))
    residuals = [evaluate(views[k], points[sample], normals[sample], poses[k], parameters).residual for k in views]
    used = np.array(sorted(poses))
    return FusedScan(
        points, normals, weights, used, np.stack([poses[k] for k in used]), np.array(residuals),
        tuple(frames[k].features for k in used), tuple(frames[k].camera for k in used),
    )


def _volume(box: np.ndarray, parameters: FusionParameters) -> TsdfVolume:
    return TsdfVolume(box, parameters.voxel, parameters.truncation * parameters.voxel)


def _model_points(volume: TsdfVolume, parameters: FusionParameters) -> tuple[np.ndarray, np.ndarray]:
    points, normals, _ = volume.surface()
    sample = slice(None, None, max(1, len(points) // parameters.icp_points))
    return points[sample], normals[sample]


def _readable(frames: Sequence[RgbdFrame]) -> Iterator[tuple[int, RgbdFrame]]:
    for number in range(len(frames)):
        try:
            yield number, frames[number]
        except FrameError:
            continue


def in_head_frame(scan: FusedScan, head_from_scan: np.ndarray) -> FusedScan:
    """The same scan in another frame: (4, 4) scan to head."""
    scan_from_head = np.linalg.inv(head_from_scan)
    return FusedScan(
        transform_points(head_from_scan, scan.points), scan.normals @ head_from_scan[:3, :3].T, scan.weights,
        scan.frames, scan.poses @ scan_from_head, scan.residuals, scan.features, scan.cameras,
    )
