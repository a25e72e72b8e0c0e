"""Run section 3 in one call: build the personal rig from depth frames of a neutral face."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..errors import TrackingError
from ..geometry.frame import RgbdFrame
from ..geometry.mesh import transform_points
from ..model.actor import Actor
from ..model.blendshapes import deformation_transfer
from ..model.face_model import FaceModel, embedded_face_model
from ..parameters import FitParameters, Parameters
from .appearance import gather_appearance
from .detail import fit_detail
from .expression import without_expression
from .features import FeatureConstraints, calibrated_features, calibrated_landmarks, constraints_on
from .fit import IdentityFit, fit_identity
from .fuse import FusedScan, Progress, fuse_frames, in_head_frame
from .hair import without_hair
from .plausible import ImplausibleFaceError, check_fit, say_doubtful_size
from .shrink_wrap import ShrinkWrap, shrink_wrap
from .skin import gather_skin

DEFAULTS = Parameters()
#: Number of searches for hair. A head that was fitted without hair reveals more of it.
HAIR_ROUNDS = 2


@dataclass(frozen=True)
class NeutralCapture:
    """The result of every step of the capture, in the actor's head frame.

    The fit and the wrap have the expression that the scan shows. The actor's neutral has none.
    """

    scan: FusedScan
    fit: IdentityFit
    wrap: ShrinkWrap
    features: FeatureConstraints
    actor: Actor


def capture_actor(
    frames: Sequence[RgbdFrame],
    model: FaceModel | None = None,
    parameters: Parameters = DEFAULTS,
    progress: Progress | None = None,
    source: Any = None,
) -> Actor:
    """Capture the neutral face of one person and build the personal blendshapes (section 3).

    Parameters
    ----------
    frames : sequence of RgbdFrame
        Frames of the neutral face, at least one of them with 2D features.
    model : FaceModel, optional
        The embedded one by default.
    parameters : Parameters
        Of the stages ``fusion``, ``fit``, ``shrink_wrap`` and ``refinement``.
    progress : callable, optional
        Called with the name of a step and the share of it that is done, 0 to 1.
    source : optional
        Where the frames come from. Messages about a doubtful head mention its name and its unit of depth.

    Returns
    -------
    Actor
        The personal rig.

    Raises
    ------
    TrackingError
        No face was found. The subclass :class:`~adaptiveface.neutral.plausible.ImplausibleFaceError` says that the head
        cannot be a person's.
    """
    return capture_neutral(frames, model, parameters, progress, source).actor


def capture_neutral(
    frames: Sequence[RgbdFrame],
    model: FaceModel | None = None,
    parameters: Parameters = DEFAULTS,
    progress: Progress | None = None,
    source: Any = None,
) -> NeutralCapture:
    """Do what :func:`capture_actor` does, and return every intermediate result."""
    model = embedded_face_model() if model is None else model
    if len(frames) == 0:
        raise TrackingError("no neutral frames were given: at least one RGB-D frame with a face is needed")
    report = progress or (lambda step, share: None)
    try:
        scan = fuse_frames(frames, model, parameters.fusion, report)
        report("fit", 0.0)
        scan, fit, hair = fit_to_skin(scan, model, parameters.fit)
        check_fit(fit, model)
    except ImplausibleFaceError as error:
        raise error.of(source) from None
    say_doubtful_size(source, model, fit.vertices)
    report("shrink_wrap", 0.0)
    scan = in_head_frame(scan, np.linalg.inv(fit.scan_from_head))
    wrap = shrink_wrap(scan, model, fit.vertices, parameters.shrink_wrap, hair)
    report("blendshapes", 0.0)
    neutral = without_expression(model, fit.identity, fit.expression, wrap.vertices)
    actor = build_actor(model, neutral, scan, fit.identity)
    actor = replace(actor, depth_valid=actor.depth_valid & ~hair)
    constraints = constraints_on(scan, model, wrap.vertices)
    places = calibrated_features(constraints, model, wrap.vertices, parameters.shrink_wrap.feature_shift)
    landmarks = calibrated_landmarks(scan, model, wrap.vertices)
    actor = replace(actor, feature_triangles=places[0], feature_weights=places[1], landmarks=landmarks)
    if constraints.trust < 1.0:  # the features are detected, so they have errors
        actor = _looked_at(actor, wrap.vertices, frames, scan, parameters)
    report("blendshapes", 1.0)
    return NeutralCapture(scan, fit, wrap, constraints, actor)


def _looked_at(
    actor: Actor, scanned: np.ndarray, frames: Sequence[RgbdFrame], scan: FusedScan, parameters: Parameters
) -> Actor:
    """The actor with how its skin looks in the frames of the scan, which are read again: their colour was not kept.

    ``scanned`` (V, 3): the head as these frames show it, with its expression.
    """

    def views() -> Iterator[tuple[RgbdFrame, np.ndarray]]:
        return ((frames[number], pose) for number, pose in zip(scan.frames, scan.poses, strict=True))

    seen = replace(actor, neutral=scanned)
    appearance = gather_appearance(seen, views(), parameters.refinement)
    return replace(actor, appearance=appearance, skin=gather_skin(seen, views(), parameters.skin))


def fit_to_skin(scan: FusedScan, model: FaceModel, parameters: FitParameters) -> tuple[FusedScan, IdentityFit, np.ndarray]:
    """The scan without the hair that hangs into the face, the head fitted to what is left, and the vertices under hair."""
    fit, hair = fit_identity(scan, model, parameters), np.zeros(len(model.mean), bool)
    for _ in range(HAIR_ROUNDS):
        head = transform_points(fit.scan_from_head, fit.vertices)
        skin, under = without_hair(scan, model, head, parameters.hair)
        if skin is scan:
            break
        scan, fit, hair = skin, fit_identity(skin, model, parameters), hair | under
    return scan, fit_detail(scan, model, fit, parameters), hair


def build_actor(
    model: FaceModel, neutral: np.ndarray, scan: FusedScan | None = None, identity: np.ndarray | None = None
) -> Actor:
    """The rig of a head whose neutral (V, 3) is known: the generic expressions transferred to it."""
    blendshapes = deformation_transfer(model.mean, neutral, model.triangles, model.generic_expressions)
    empty = np.zeros((0, 3))
    return Actor(
        neutral=neutral,
        blendshapes=blendshapes,
        triangles=model.triangles,
        frontal=model.frontal,
        expression_names=model.generic_names,
        feature_triangles=model.feature_triangles,
        feature_weights=model.feature_weights,
        depth_valid=model.depth_valid,
        scan_points=empty if scan is None else scan.points,
        scan_normals=empty if scan is None else scan.normals,
        identity=np.zeros(0) if identity is None else np.asarray(identity, float),
        landmarks=model.landmarks,
    )


__all__ = ["NeutralCapture", "build_actor", "capture_actor", "capture_neutral"]
