"""Register depth frames of the neutral face and merge them into one scan (section 3, first step)."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ..errors import FrameError, TrackingError
from ..geometry.camera import Camera
from ..geometry.frame import Features2D, RgbdFrame
from ..geometry.mesh import surface_points, transform_points
from ..geometry.polydata import cloud
from ..model.face_model import FaceModel
from ..parameters import FusionParameters
from .plausible import check_features
from .registration import DepthView, Registration, align, depth_view, evaluate, feature_pose
from .volume import TsdfVolume

if TYPE_CHECKING:
    from ..geometry.polydata import PolyData

DEFAULTS = FusionParameters()
_MIN_POINTS = 1000
Progress = Callable[[str, float], None]


class Placed(NamedTuple):
    """A registered frame: its depth view and its pose (4, 4), scan to camera."""

    view: DepthView
    pose: np.ndarray


@dataclass(frozen=True)
class FusedScan:
    """The merged neutral scan, in a frame close to the model's head frame.

    Attributes
    ----------
    points, normals : (P, 3)
        Points, mm, and their unit normals.
    weights : (P,)
        Accumulated view weight, about the number of frames that saw the point.
    frames : (K,) int
        Numbers of the used frames in the sequence.
    poses : (K, 4, 4)
        Scan frame to camera frame of each, mm.
    residuals : (K,)
        Median point-to-plane distance of each to the merged surface, mm.
    features : sequence of Features2D or None
        The 2D features of each.
    cameras : sequence of Camera
        The calibration of each.
    noise : float
        Noise that remains in the points, mm; 0 if it is not known.
    """

    points: np.ndarray
    normals: np.ndarray
    weights: np.ndarray
    frames: np.ndarray
    poses: np.ndarray
    residuals: np.ndarray
    features: tuple[Features2D | None, ...]
    cameras: tuple[Camera, ...]
    noise: float = 0.0

    def mesh(self) -> PolyData:
        """Return the points for pyvista.

        Returns
        -------
        pyvista.PolyData
            Points in mm: x points out of the face, y to the subject's left, z up. The arrays are ``normals`` (P, 3) and
            ``views`` (P,), about the number of frames that saw the point.

        Raises
        ------
        MissingExtraError
            pyvista is not installed.
        """
        return cloud(self.points, self.normals, views=self.weights)


def head_box(model: FaceModel, margin: float) -> np.ndarray:
    """Corners (2, 3) of the box that belongs to the head: the model's frontal region, widened by ``margin`` mm."""
    face = model.mean[model.frontal]
    return np.stack([face.min(axis=0) - margin, face.max(axis=0) + margin])


def most_frontal(frames: Mapping[int, RgbdFrame], feature_points: np.ndarray) -> tuple[int, np.ndarray]:
    """Number of the most frontal frame, by its features, and its pose (4, 4).

    Raises :class:`TrackingError` if no frame has usable features.
    """
    best = None
    for number, frame in frames.items():
        pose = feature_pose(frame, feature_points)
        if pose is None:
            continue
        turned = -(pose[:3, 2] @ pose[:3, 3]) / np.linalg.norm(pose[:3, 3])
        if best is None or turned > best[0]:
            best = (turned, number, pose)
    if best is None:
        raise TrackingError(
            f"no face was found in the {len(frames)} readable neutral frames: none has 2D features; record the face "
            "from the front, well lit, or supply features.csv"
        )
    return best[1], best[2]


def fuse_frames(
    frames: Sequence[RgbdFrame],
    model: FaceModel,
    parameters: FusionParameters = DEFAULTS,
    progress: Progress | None = None,
) -> FusedScan:
    """Register the frames to the growing model surface, and merge them in a volume (section 3).

    The walk starts at the most frontal frame, whose 2D features give the first pose. From there it goes forwards and
    backwards, and each frame starts at its neighbour's pose. Aligning a frame to the merged surface instead of to its
    neighbour avoids drift. A second pass aligns every frame to the whole surface. Frames that cannot be read or registered
    are left out.

    Parameters
    ----------
    frames : sequence of RgbdFrame
        Of the neutral face, some of them with 2D features.
    model : FaceModel
        Its mean head and features give the first pose and the volume's place.
    parameters : FusionParameters
        Of the volume and of ICP.
    progress : callable, optional
        Called with the name of the step and the share done, 0 to 1.

    Returns
    -------
    FusedScan
        The merged points with the frames that made them.

    Raises
    ------
    TrackingError
        No face was found.
    """
    report = progress or (lambda step, share: None)
    readable = _readable(frames)
    check_features(list(readable.values()), model)
    feature_points = surface_points(model.mean, model.feature_triangles, model.feature_weights)
    box = head_box(model, parameters.margin)
    placed = _first_pass(readable, feature_points, box, parameters, report)
    for number in range(1, parameters.passes):
        placed = _next_pass(placed, box, parameters)
        report("fuse", (number + 1) / parameters.passes)
    return _merged(readable, placed, box, parameters)


def _readable(frames: Sequence[RgbdFrame]) -> dict[int, RgbdFrame]:
    """The readable frames by number, without their colour, which would only fill the memory."""
    out = {}
    for number in range(len(frames)):
        try:
            out[number] = replace(frames[number], colour=None)
        except FrameError:
            continue
    return out


def _first_pass(
    frames: dict[int, RgbdFrame], feature_points: np.ndarray, box: np.ndarray, parameters: FusionParameters, report: Progress
) -> dict[int, Placed]:
    """Grow the surface from the most frontal frame, and return the registered frames by number."""
    first, pose = most_frontal(frames, feature_points)
    view = depth_view(frames[first], pose, box)
    if view is None:
        raise TrackingError(f"frame {first} has 2D features but no depth at the face: do colour and depth agree?")
    volume = _volume(box, parameters)
    volume.integrate(view, pose, parameters.min_cosine)
    placed = {first: Placed(view, pose)}
    numbers = sorted(frames)
    start = numbers.index(first)
    for walk in (numbers[start + 1 :], numbers[:start][::-1]):
        last = pose
        for number in walk:
            found = _register(frames[number], last, volume, box, parameters, feature_points)
            if found is not None:
                placed[number], last = found, found.pose
                volume.integrate(found.view, last, parameters.min_cosine)
            report("fuse", len(placed) / len(numbers) / parameters.passes)
    return placed


def _register(
    frame: RgbdFrame,
    last: np.ndarray,
    volume: TsdfVolume,
    box: np.ndarray,
    parameters: FusionParameters,
    feature_points: np.ndarray,
) -> Placed | None:
    """Register one frame from its neighbour's pose, and once more from its own 2D features if that fails."""
    model = _model_points(volume, parameters)
    for again in (False, True):
        pose = feature_pose(frame, feature_points) if again else last
        view = None if pose is None else depth_view(frame, pose, box)
        if pose is None or view is None:
            continue
        registration = align(view, *model, pose, parameters)
        if _accepted(registration, parameters):
            return Placed(view, registration.pose)
    return None


def _next_pass(placed: dict[int, Placed], box: np.ndarray, parameters: FusionParameters) -> dict[int, Placed]:
    """Align every frame to the surface merged from all of them."""
    model = _model_points(_integrated(placed, box, parameters), parameters)
    refined = {}
    for number, (view, pose) in placed.items():
        registration = align(view, *model, pose, parameters)
        if _accepted(registration, parameters):
            refined[number] = Placed(view, registration.pose)
    return refined or placed


def _accepted(registration: Registration, parameters: FusionParameters) -> bool:
    return registration.residual < parameters.max_residual and registration.overlap > parameters.min_overlap


def _merged(
    frames: dict[int, RgbdFrame], placed: dict[int, Placed], box: np.ndarray, parameters: FusionParameters
) -> FusedScan:
    volume = _integrated(placed, box, parameters)
    points, normals, weights = volume.surface(min_weight=min(parameters.min_views, 0.5 * len(placed)))
    if len(points) < _MIN_POINTS:
        raise TrackingError(f"the merged scan holds only {len(points)} points: the depth frames do not show a face")
    sample = slice(None, None, max(1, len(points) // parameters.icp_points))
    used = sorted(placed)
    fits = [evaluate(*placed[k], points[sample], normals[sample], parameters) for k in used]
    residuals = np.array([fit.residual for fit in fits])
    return FusedScan(
        points,
        normals,
        weights,
        np.array(used),
        np.stack([placed[k].pose for k in used]),
        residuals,
        tuple(frames[k].features for k in used),
        tuple(frames[k].camera for k in used),
        _noise_left(residuals, [placed[k].view.noise for k in used], weights),
    )


def _noise_left(residuals: np.ndarray, pixels: Sequence[float], weights: np.ndarray) -> float:
    """Noise of the merged points, mm: that of one frame divided by the root of the number of frames that saw a point.

    The noise of a frame is its distance from the merged surface (K residuals), of which the frame is a part. The distance of a
    pixel from its neighbours (K) is less than that, but is also known for a single frame.
    """
    count = len(residuals)
    apart = float(np.median(residuals)) * np.sqrt(count / max(count - 1, 1))
    return float(max(apart, np.median(pixels)) / np.sqrt(max(float(np.median(weights)), 1.0)))


def _integrated(placed: dict[int, Placed], box: np.ndarray, parameters: FusionParameters) -> TsdfVolume:
    volume = _volume(box, parameters)
    for number in sorted(placed):
        volume.integrate(*placed[number], parameters.min_cosine)
    return volume


def _volume(box: np.ndarray, parameters: FusionParameters) -> TsdfVolume:
    return TsdfVolume(box, parameters.voxel, parameters.truncation * parameters.voxel)


def _model_points(volume: TsdfVolume, parameters: FusionParameters) -> tuple[np.ndarray, np.ndarray]:
    points, normals, _ = volume.surface()
    sample = slice(None, None, max(1, len(points) // parameters.icp_points))
    return points[sample], normals[sample]


def in_head_frame(scan: FusedScan, head_from_scan: np.ndarray) -> FusedScan:
    """Return the same scan in another frame; the pose (4, 4) is scan to head."""
    scan_from_head = np.linalg.inv(head_from_scan)
    return replace(
        scan,
        points=transform_points(head_from_scan, scan.points),
        normals=scan.normals @ head_from_scan[:3, :3].T,
        poses=scan.poses @ scan_from_head,
    )
