"""Trackers compared: this one and others, by the same measures, with the uncertainty of few performers.

Another tracker's output is an ``npz`` of

    vertices   (F, M, 3)  its mesh in the camera frame, mm, one entry per frame of the recording
    triangles  (T, 3)     its triangles
    tracked    (F,) bool  optional: frames in which it found the face; all by default

and, or instead,

    landmarks     (F, L, 3)  points on the face in the camera frame, mm
    landmark_ids  (L,)       their iBUG-68 numbers

Its mesh may have any topology. So the true surface is asked how far the other tracker's surface lies from it, at the
true vertices that :class:`ErrorCollector` scores too. Landmarks are compared with the true points of the same number.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ..errors import AdaptiveFaceError, FileFormatError
from ..files.npz import Field, check_indices, load_checked
from ..model.actor import Actor
from ..model.face_model import FaceModel, embedded_face_model
from ..result import Result
from .metrics import TrueSurface
from .run import ErrorCollector, Evaluation
from .truth import NEUTRAL, GroundTruth

_OTHER = {
    "vertices": Field(("F", "M", 3), optional=True),
    "triangles": Field(("T", 3), "iu", optional=True),
    "tracked": Field(("F",), "b", optional=True),
    "landmarks": Field(("F", "L", 3), optional=True),
    "landmark_ids": Field(("L",), "iu", optional=True),
}


def score_result(result: Result, truth: GroundTruth, actor: Actor, step: int = 1) -> Evaluation:
    """Errors of a saved result against the truth, for v4 and for the other stages that were kept.

    Parameters
    ----------
    result : Result
        Frame k of it is frame k of the truth.
    truth : GroundTruth
        See :meth:`GroundTruth.of`.
    actor : Actor
        The rig that was tracked with.
    step : int
        Every how many frames are scored.

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
    """Errors of another tracker's meshes or landmarks, mm; the module's docstring describes the file.

    Parameters
    ----------
    path : path-like
        The other tracker's ``npz``.
    truth : GroundTruth
        Its meshes are those of ``model``.
    model : FaceModel
        The one that the performers are made of, by default the embedded one. It says which vertices are scored.
    step : int
        Every how many frames are scored.

    Returns
    -------
    dict
        ``surface_median`` and ``surface_p95`` over all pairs of frame and true vertex, ``landmark_mean`` and
        ``landmark_p95`` over all pairs of frame and landmark, ``lost``: the share of frames without a face.

    Raises
    ------
    FileFormatError
        The file is not as described, or has another number of frames than the truth.
    """
    path, model = Path(path), model or embedded_face_model()
    data = load_checked(path, _OTHER)
    if len(truth.neutral) != len(model.mean):
        raise AdaptiveFaceError(f"the truth has {len(truth.neutral)} vertices, the face model {len(model.mean)}")
    frames = [len(data[name]) for name in ("vertices", "landmarks") if name in data]
    if not frames or len({*frames, len(truth)}) > 1:
        raise FileFormatError(f"{path}: vertices or landmarks for {len(truth)} frames are expected, it has {frames or 'none'}")
    if ("vertices" in data) != ("triangles" in data) or ("landmarks" in data) != ("landmark_ids" in data):
        raise FileFormatError(f"{path}: vertices need triangles, and landmarks need landmark_ids")
    tracked = data.get("tracked", np.ones(len(truth), bool))
    chosen = [k for k in range(0, len(truth), step) if truth[k].performance != NEUTRAL]
    scored = [k for k in chosen if tracked[k]]
    if not scored:
        raise FileFormatError(f"{path}: no frame of the performance is tracked")
    out = {"lost": 1.0 - len(scored) / len(chosen)}
    if "vertices" in data:
        check_indices(path, "triangles", data["triangles"], data["vertices"].shape[1])
        inside = model.frontal & model.depth_valid
        gaps = [TrueSurface(data["vertices"][k], data["triangles"]).distance(truth[k].vertices[inside]) for k in scored]
        out |= {"surface_median": float(np.median(gaps)), "surface_p95": float(np.percentile(gaps, 95))}
    if "landmarks" in data:
        apart = _landmark_gaps(path, data, truth, model, scored)
        out |= {"landmark_mean": float(apart.mean()), "landmark_p95": float(np.percentile(apart, 95))}
    return out


def _landmark_gaps(path: Path, data: dict, truth: GroundTruth, model: FaceModel, frames: Sequence[int]) -> np.ndarray:
    known = {int(number): slot for slot, number in enumerate(model.feature_ids)}
    pairs = [(column, known[int(number)]) for column, number in enumerate(data["landmark_ids"]) if int(number) in known]
    if not pairs:
        raise FileFormatError(f"{path}: none of its landmark_ids is one of {', '.join(map(str, known))}")
    columns, slots = map(list, zip(*pairs, strict=True))
    corners, weights = model.feature_triangles[slots], model.feature_weights[slots]
    gaps = []
    for k in frames:
        points = np.einsum("fk,fkd->fd", weights, truth[k].vertices[corners])
        gaps.append(np.linalg.norm(data["landmarks"][k, columns] - points, axis=1))
    return np.array(gaps)


def is_result(path: str | os.PathLike) -> bool:
    """Whether a file is a ``result.npz`` of this package, and not another tracker's meshes."""
    return "coefficients" in load_checked(path, {"coefficients": Field(("F", "A"), optional=True)})


def bootstrap_interval(values: Sequence[float], confidence: float = 0.95, seed: int = 0) -> tuple[float, float]:
    """Confidence interval of the mean over performers (bias-corrected bootstrap, Efron 1987).

    Parameters
    ----------
    values : (n,) array-like
        One figure per performer.

    Returns
    -------
    low, high : float
        Both NaN for a single value: one performer says nothing about others.
    """
    from scipy.stats import bootstrap

    sample = np.asarray(values, float)
    if len(sample) < 2:
        return float("nan"), float("nan")
    if np.ptp(sample) == 0.0:
        return float(sample[0]), float(sample[0])
    result = bootstrap((sample,), np.mean, confidence_level=confidence, rng=np.random.default_rng(seed))
    return float(result.confidence_interval.low), float(result.confidence_interval.high)
