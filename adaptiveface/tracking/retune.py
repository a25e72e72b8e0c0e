"""Other parameters for a running tracker: it keeps the pose, the expression and what it learned."""

from __future__ import annotations

import copy

from ..parameters import Parameters
from .adaptive_pca import AdaptiveModel
from .expression import BlendshapeFit
from .kalman import CoefficientFilter
from .tracker import FaceTracker


def snapshot(tracker: FaceTracker) -> FaceTracker:
    """The tracker as it is between two frames, without copying arrays: tracking on replaces them.

    Only the sample buffer of the adaptive model is shared and goes on changing: of the two, one may learn.
    """
    saved = copy.copy(tracker)
    saved.kalman, saved.model = copy.copy(tracker.kalman), copy.copy(tracker.model)
    return saved


def retuned(tracker: FaceTracker, parameters: Parameters, relearn: bool = True) -> FaceTracker:
    """A tracker with other ``parameters`` that goes on where ``tracker`` is; only stages that changed are made anew.

    It takes over the adaptive model, so that ``tracker`` must not learn on. Where the number of expressions, of
    correctives or of samples changes, the model learns anew from the samples in its buffer; ``relearn=False`` leaves it
    as it is, except for a changed number of expressions.
    """
    old = tracker.parameters
    if old.blendshapes.A == parameters.blendshapes.A:
        out = snapshot(tracker)
        out.parameters = parameters
        _retune_stages(out, old, parameters)
    else:
        out = _with_expressions(tracker, parameters)
    if relearn and _sizes(old) != _sizes(parameters):
        out.model = _taught(out, tracker.model, parameters)
    elif relearn:
        out.model.parameters = parameters.adaptive_pca
    return out


def put_where(tracker: FaceTracker, other: FaceTracker) -> FaceTracker:
    """A tracker with the stages and the adaptive model of ``tracker``, and the pose and the expression of ``other``.

    Both need the same number of expressions. Costs nothing, unlike :func:`retuned`, which may factorise matrices.
    """
    out = snapshot(tracker)
    out.pose, out._x, out._v1, out._v4 = other.pose, other._x, other._v1, other._v4
    out._deformation = other._deformation
    if tracker.parameters.kalman == other.parameters.kalman:
        out.kalman = copy.copy(other.kalman)
    return out


def _sizes(parameters: Parameters) -> tuple[int, int, int]:
    return parameters.blendshapes.A, parameters.adaptive_pca.K, parameters.adaptive_pca.S


def _retune_stages(out: FaceTracker, old: Parameters, new: Parameters) -> None:
    actor = out.actor
    if old.laplacian.energies != new.laplacian.energies:
        out.deformation = out.deformation.reweighted(*new.laplacian.energies)
    if old.laplacian.final_energies != new.laplacian.final_energies:
        out.final_deformation = out.final_deformation.reweighted(*new.laplacian.final_energies)
    if old.blendshapes != new.blendshapes:
        out.fit_with(BlendshapeFit(actor, new.blendshapes))
    elif old.rigid != new.rigid:
        out.fit_with(out.blendshapes)
    if old.refinement != new.refinement:
        out.refine_with(new)
    if old.kalman != new.kalman:
        out.kalman = CoefficientFilter(new.kalman)


def _with_expressions(tracker: FaceTracker, parameters: Parameters) -> FaceTracker:
    """Another number of expressions changes the anchor space: a new tracker, put where the old one is."""
    out = type(tracker)(tracker.given, parameters)
    count = min(len(tracker._x), len(out._x))
    out._x[:count] = tracker._x[:count]
    out.pose, out._v1, out._deformation = tracker.pose, out.blendshapes.shape(out._x), tracker._deformation
    out._v4 = tracker._v4
    return out


def _taught(out: FaceTracker, model: AdaptiveModel, parameters: Parameters) -> AdaptiveModel:
    taught = AdaptiveModel(out.actor, out.blendshapes.basis, parameters.adaptive_pca)
    taught.learn_all(model.samples())
    taught.updates = model.updates
    return taught
