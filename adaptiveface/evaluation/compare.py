"""Compare trackers, this one and others, by the same measures, with the uncertainty of few performers.

Another tracker writes an ``npz`` as :class:`OtherResult` describes it. Its mesh may have any topology. Therefore, the
distance of its surface is measured from the true vertices that :class:`ErrorCollector` scores, too. Landmarks are compared with
the true points of the same number.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..errors import AdaptiveFaceError, FileFormatError
from ..files.npz import Field, load_checked
from ..files.records import array, read, record
from ..model.actor import Actor
from ..model.face_model import FaceModel, embedded_face_model
from ..result import Result
from .metrics import TrueSurface
from .run import ErrorCollector, Evaluation
from .truth import NEUTRAL, GroundTruth


@record
@dataclass(frozen=True)
class OtherResult:
    """Output of another tracker, for F frames: a mesh of M vertices, L landmarks, or both."""

    vertices: np.ndarray | None = array("F M 3", doc="mesh in the camera frame", unit="mm", optional=True, default=None)
    triangles: np.ndarray | None = array("T 3", "i4", "of the mesh", below="M", optional=True, default=None)
    tracked: np.ndarray | None = array("F", "b", "frames with a face; all by default", optional=True, default=None)
    landmarks: np.ndarray | None = array(
        "F L 3", doc="points on the face in the camera frame", unit="mm", optional=True, default=None
    )
    landmark_ids: np.ndarray | None = array("L", "i4", "iBUG-68 numbers of the landmarks", optional=True, default=None)

    @classmethod
    def load(cls, path: Path, n_frames: int) -> OtherResult:
        """Read a file. Raises :class:`FileFormatError` unless it has meshes or landmarks for ``n_frames`` frames."""
        other = cls(**read(cls, path))
        frames = [len(points) for points in (other.vertices, other.landmarks) if points is not None]
        if not frames or len({*frames, n_frames}) > 1:
            found = frames or "none"
            raise FileFormatError(f"{path}: vertices or landmarks for {n_frames} frames are expected, it has {found}")
        meshes, landmarks = (other.vertices, other.triangles), (other.landmarks, other.landmark_ids)
        if any((points is None) != (names is None) for points, names in (meshes, landmarks)):
            raise FileFormatError(f"{path}: vertices need triangles, and landmarks need landmark_ids")
        return other


def score_result(result: Result, truth: GroundTruth, actor: Actor, step: int = 1) -> Evaluation:
    """Score a saved result against the truth: v4, and the other stages if they were kept.

    Parameters
    ----------
    result : Result
        The result. Its frames have the numbers of the truth's frames.
    truth : GroundTruth
        The truth.
    actor : Actor
        The rig that was tracked.
    step : int
        Every ``step``-th frame is scored.

    Returns
    -------
    Evaluation
        The errors by stage, frame and vertex.

    Raises
    ------
    AdaptiveFaceError
        The numbers of frames or of vertices differ, or no frame was tracked.
    """
    if len(result) != len(truth):
        raise AdaptiveFaceError(f"the result has {len(result)} frames, the truth {len(truth)}: another recording")
    stages = tuple(name for name in ("v1", "v2", "v3") if getattr(result, name) is not None) + ("v4",)
    collector = ErrorCollector(truth, actor, stages)
    for k in range(0, len(result), step):
        if not result.tracked[k]:
            collector.lose(k)
            continue
        meshes = {name: np.asarray(getattr(result, "vertices" if name == "v4" else name)[k], float) for name in stages}
        collector.score(k, result.head_pose[k].astype(float), meshes, result.anchor_distance[k], result.adaptive_distance[k])
    return collector.finish()


def score_other(path: str | os.PathLike, truth: GroundTruth, model: FaceModel | None = None, step: int = 1) -> dict[str, float]:
    """Score the meshes or landmarks of another tracker.

    Parameters
    ----------
    path : path-like
        The other tracker's file, as :class:`OtherResult` describes it.
    truth : GroundTruth
        The truth. Its meshes have the vertices of ``model``.
    model : FaceModel, optional
        The face model from which the performers are made. It determines the vertices that are scored. The default is the
        embedded model.
    step : int
        Every ``step``-th frame is scored.

    Returns
    -------
    dict
        ``surface_median`` and ``surface_p95`` over all pairs of a frame and a true vertex, mm; ``landmark_mean`` and
        ``landmark_p95`` over all pairs of a frame and a landmark, mm; and ``lost``, the share of frames without a face.

    Raises
    ------
    FileFormatError
        The file is not as described, or its number of frames differs from the truth's.
    AdaptiveFaceError
        The truth and the model have different numbers of vertices.
    """
    path, model = Path(path), model or embedded_face_model()
    if len(truth.neutral) != len(model.mean):
        raise AdaptiveFaceError(f"the truth has {len(truth.neutral)} vertices, the face model {len(model.mean)}")
    other = OtherResult.load(path, len(truth))
    tracked = np.ones(len(truth), bool) if other.tracked is None else other.tracked
    chosen = [k for k in range(0, len(truth), step) if truth[k].performance != NEUTRAL]
    scored = [k for k in chosen if tracked[k]]
    if not scored:
        raise FileFormatError(f"{path}: no frame of the performance is tracked")
    out = {"lost": 1.0 - len(scored) / len(chosen)}
    if other.vertices is not None and other.triangles is not None:
        inside = model.frontal & model.depth_valid
        gaps = [TrueSurface(other.vertices[k], other.triangles).distance(truth[k].vertices[inside]) for k in scored]
        out |= {"surface_median": float(np.median(gaps)), "surface_p95": float(np.percentile(gaps, 95))}
    if other.landmarks is not None and other.landmark_ids is not None:
        apart = _landmark_gaps(path, other.landmarks, other.landmark_ids, truth, model, scored)
        out |= {"landmark_mean": float(apart.mean()), "landmark_p95": float(np.percentile(apart, 95))}
    return out


def _landmark_gaps(
    path: Path, landmarks: np.ndarray, ids: np.ndarray, truth: GroundTruth, model: FaceModel, frames: Sequence[int]
) -> np.ndarray:
    """Return the distances (F, L) of the landmarks (F, L, 3) that the face model knows from their true places, mm."""
    known = {int(number): slot for slot, number in enumerate(model.feature_ids)}
    pairs = [(column, known[int(number)]) for column, number in enumerate(ids) if int(number) in known]
    if not pairs:
        raise FileFormatError(f"{path}: none of its landmark_ids is one of {', '.join(map(str, known))}")
    columns, slots = map(list, zip(*pairs, strict=True))
    corners, weights = model.feature_triangles[slots], model.feature_weights[slots]
    gaps = []
    for k in frames:
        points = np.einsum("fk,fkd->fd", weights, truth[k].vertices[corners])
        gaps.append(np.linalg.norm(landmarks[k, columns] - points, axis=1))
    return np.array(gaps)


def is_result(path: str | os.PathLike) -> bool:
    """Return whether a file is a ``result.npz`` of this package, and not the output of another tracker."""
    return "coefficients" in load_checked(path, {"coefficients": Field(("F", "A"), optional=True)})


def bootstrap_interval(values: Sequence[float], confidence: float = 0.95, seed: int = 0) -> tuple[float, float]:
    """Estimate a confidence interval of the mean over performers (bias-corrected bootstrap, Efron 1987).

    Parameters
    ----------
    values : (n,) array-like
        One value per performer.
    confidence : float
        Probability with which the interval contains the mean of all performers.
    seed : int
        Seed of the bootstrap samples.

    Returns
    -------
    low, high : float
        The interval. Both are NaN for a single value, because one performer tells nothing about others.
    """
    from scipy.stats import bootstrap

    sample = np.asarray(values, float)
    if len(sample) < 2:
        return float("nan"), float("nan")
    if np.ptp(sample) == 0.0:
        return float(sample[0]), float(sample[0])
    result = bootstrap((sample,), np.mean, confidence_level=confidence, rng=np.random.default_rng(seed))
    return float(result.confidence_interval.low), float(result.confidence_interval.high)
