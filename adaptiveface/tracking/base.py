"""What the trackers with and without depth have in common: the state between frames, and the stages that both use."""

from __future__ import annotations

import copy
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from operator import attrgetter
from typing import Self

import numpy as np

from ..geometry.frame import RgbdFrame
from ..model.actor import Actor
from ..parameters import Parameters
from .adaptive_pca import AdaptiveModel, Parts
from .feature_rows import feature_rows
from .held_out import HeldOut
from .laplacian import FeatureTerm, feature_term
from .personal_blendshapes import PersonalBlendshapes
from .printed import printed_term
from .region import FrontalRegion
from .stages import Stages
from .state import TrackerState
from .types import STAGE_NAMES, SampleState, TrackedFrame


class Tracker(ABC):
    """Tracks one actor. ``track(frame)`` for every frame in order; ``reset()`` starts over, ``forget()`` drops the face only.

    Attributes
    ----------
    given, actor : Actor
        The actor that the tracker was made for; the same with the features that the tracker works with.
    stages : Stages
        How the stages are made. The stages themselves are attributes of the same names.
    state : TrackerState
        Where the last frame left the face.
    model : AdaptiveModel
        What was learned so far (section 5).
    """

    def __init__(self, actor: Actor, parameters: Parameters | None = None, stages: Stages | None = None) -> None:
        self.given = self.actor = actor
        self.parameters, self.stages = parameters or Parameters(), stages or Stages()
        self.region, self.held_out = FrontalRegion(actor), HeldOut(actor)
        self._make_stages(None)
        self.model = self._new_model()
        self.reset()

    #: What is learned about the expressions' meshes; None without.
    personal: PersonalBlendshapes | None = None

    # ---- the state between frames ----------------------------------------------------------------------------------
    @property
    def pose(self) -> np.ndarray | None:
        """(4, 4) the head's last pose, head to camera, mm; None where it is not known."""
        return self.state.pose

    @property
    def detect_every(self) -> int:
        """The detector need not look at more than every so-many-th frame from now on: 1 where nothing else finds features."""
        return 1

    @property
    def expressions(self) -> np.ndarray | None:
        """(A, N, 3) the expressions as they are known now, mm; None while they are those of the actor."""
        return None if self.blendshapes is self.transferred else self.blendshapes.basis

    def wear_personal(self) -> None:
        """Fit with the expressions as they are known now; the anchors stay those of the transferred ones."""
        self.blendshapes = self.transferred
        if self.personal is not None and self.personal.updates:
            basis = self.transferred.basis.astype(np.float32)
            basis[:, self.region.vertices] += self.personal.change
            self.blendshapes = self.transferred.with_basis(basis)

    def personal_actor(self) -> Actor:
        """The actor with the expressions as they are known now, to be saved; another tracker goes on from there."""
        blendshapes = self.given.blendshapes.copy()
        blendshapes[: len(self.blendshapes.basis)] = self.blendshapes.basis
        return replace(self.given, blendshapes=blendshapes)

    def forget_learned(self) -> None:
        """Forget everything learned, but not where the head is and what the face does."""
        self.model.reset()

    def reset(self) -> None:
        """Start over: forget the pose, the expression and everything learned."""
        self.forget_learned()
        self.forget()

    def forget(self) -> None:
        """Forget where the head was and what the face did; the next frame is searched by its 2D features."""
        neutral = self.actor.neutral
        self.state = TrackerState(
            pose=None,
            coefficients=np.zeros(len(self.blendshapes.basis)),
            v1=neutral,
            v4=neutral,
            deformation=np.zeros((len(self.region), 3)),
        )

    def copy(self) -> Self:
        """The tracker as it is between two frames, without copying arrays: tracking on replaces them."""
        out = copy.copy(self)
        out.model = self.model.copy()
        return out

    def with_state(self, state: TrackerState) -> Self:
        """A copy that goes on from ``state``, of a tracker with the same number of expressions. Nothing is factorised."""
        out = self.copy()
        out.state = state
        return out

    def with_parameters(self, parameters: Parameters, relearn: bool = True) -> Self:
        """A tracker with other ``parameters`` that goes on from this one; only the stages that changed are made anew.

        Parameters
        ----------
        relearn
            Where the number of expressions, of correctives or of samples changes, the model learns anew from the samples
            in its buffer. False leaves it as it is, except for a changed number of expressions, which starts it over.
        """
        old, out = self.parameters, self.copy()
        out.parameters = parameters
        out._make_stages(old)
        expressions = differ(old, parameters, "blendshapes.A")
        if expressions:
            out.state, out.model = out._with_my_expressions(self.state), out._new_model()
        elif differ(old, parameters, "kalman"):
            out.state = replace(self.state, filter=None)
        if relearn and (expressions or differ(old, parameters, "adaptive_pca.K", "adaptive_pca.S")):
            out.model = out._new_model()
            out.model.learn_all(self.model.samples())
            out.model.updates = self.model.updates
        elif relearn:
            out.model.parameters = parameters.adaptive_pca
        return out

    def _with_my_expressions(self, state: TrackerState) -> TrackerState:
        """``state`` of a tracker with another number of expressions: those that this tracker lacks are dropped."""
        x = np.zeros(len(self.blendshapes.basis))
        count = min(len(x), len(state.coefficients))
        x[:count] = state.coefficients[:count]
        return replace(state, coefficients=x, v1=self.blendshapes.shape(x), filter=None)

    # ---- the stages ------------------------------------------------------------------------------------------------
    def _make_stages(self, old: Parameters | None) -> None:
        """Make the stages whose parameters differ from ``old``; all of them where that is None."""
        p, make = self.parameters, self.stages
        if differ(old, p, "blendshapes"):
            self.blendshapes = self.transferred = make.blendshapes(self.actor, p.blendshapes)
        if differ(old, p, "kalman"):
            self.kalman = make.kalman(p.kalman)
        if old is None:
            self.final_deformation = make.final_deformation(self.actor, *p.laplacian.final_energies)
        elif differ(old, p, "laplacian.final_energies"):
            self.final_deformation = self.final_deformation.reweighted(*p.laplacian.final_energies)

    def _new_model(self) -> AdaptiveModel:
        return self.stages.adaptive_pca(self.actor, self.transferred.basis, self.parameters.adaptive_pca)

    @abstractmethod
    def track(self, frame: RgbdFrame) -> TrackedFrame:
        """One frame. Never raises on a bad frame: the result says ``tracked`` False and why."""

    def _filtered(self, measured: np.ndarray) -> np.ndarray:
        """The coefficients (A,) of this frame: filtered over time, within their bounds (section 4.2)."""
        limits = self.parameters.blendshapes
        filtered = self.kalman.step(self.state.filter, measured)
        self.state = replace(self.state, filter=filtered)
        coefficients: np.ndarray = np.clip(filtered.coefficients, limits.lower, limits.upper)
        return coefficients

    def _deform_to_features(self, frame: RgbdFrame, pose: np.ndarray, mesh: np.ndarray) -> np.ndarray:
        """``mesh`` (N, 3) deformed to the features alone (section 4.4), head frame, mm."""
        p = self.parameters.laplacian
        if p.feature_rows == "soft":
            term = self._feature_term(frame, pose, mesh, p.final_feature_weight, hold_depth=True)
        else:
            term = self._printed_term(frame, pose, mesh, rise=0.0)
        return self.region.displaced(mesh, self.final_deformation.deform_to_features(term))

    def _feature_term(
        self, frame: RgbdFrame, pose: np.ndarray, mesh: np.ndarray, weight: float, hold_depth: bool
    ) -> FeatureTerm:
        rows = feature_rows(frame.features, frame.camera, pose)
        actor = self.actor
        corners, share = actor.feature_triangles[rows.index], actor.feature_weights[rows.index]
        points = np.einsum("fk,fkd->fd", share, mesh[corners])
        return feature_term(rows, points, pose, frame.camera.fx, weight, hold_depth)

    def _printed_term(self, frame: RgbdFrame, pose: np.ndarray, mesh: np.ndarray, rise: np.ndarray | float) -> FeatureTerm:
        """The features' rows of equations (4) and (5); ``rise`` (40,) mm: by how much their depth is to change."""
        points = np.einsum("fk,fkd->fd", self.actor.feature_weights, mesh[self.actor.feature_triangles])
        return printed_term(frame.features, frame.camera, pose, points, rise, self.parameters.laplacian)

    def _project(self, v1: np.ndarray, v2: np.ndarray) -> tuple[np.ndarray, Parts]:
        """v3 (N, 3): v2 projected on the adaptive space (section 4.3, last equation); and what v2 - v1 is made of."""
        parts = self.model.parts(self.region.difference(v2, v1))
        return self.region.moved(v1, *self.model.project(parts)), parts

    def _tracked(
        self,
        frame: RgbdFrame,
        pose: np.ndarray,
        meshes: tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray],
        coefficients: tuple[np.ndarray, np.ndarray],
        distances: tuple[float, float],
        ms: dict[str, float],
        held_out: np.ndarray,
        state: SampleState = SampleState.IN_ANCHOR_SPACE,
        residual: float = float("nan"),
    ) -> TrackedFrame:
        """The result of a tracked ``frame``: v1 to v4, the coefficients of v1 and of v4, :meth:`Parts.distances`, times."""
        learned = state, self.model.updates
        own = frame.index, frame.timestamp, True, pose, *meshes, *coefficients
        return TrackedFrame(*own, *learned, residual, *distances, ms, held_out=held_out)

    def untracked(self, frame: RgbdFrame, reason: str, ms: dict[str, float] | None = None) -> TrackedFrame:
        """The result of a ``frame`` in which there is no face, or none that can be tracked: the neutral, unmoved."""
        neutral, x = self.actor.neutral, self.state.coefficients
        return TrackedFrame(
            frame.index,
            frame.timestamp,
            False,
            np.eye(4),
            neutral,
            neutral,
            neutral,
            neutral,
            x,
            x,
            SampleState.UNTRACKED,
            self.model.updates,
            stage_ms=ms or dict.fromkeys(STAGE_NAMES, 0.0),
            reason=reason,
        )


def differ(old: Parameters | None, new: Parameters, *names: str) -> bool:
    """Whether any of the stages or parameters ``names`` ("kalman", "laplacian.w2") differs; True without ``old``."""
    values: Callable[[Parameters], object] = attrgetter(*names)
    return old is None or values(old) != values(new)


_clock: Callable[[], float] = time.perf_counter


@contextmanager
def stage_clock(clock: Callable[[], float]) -> Iterator[None]:
    """Context in which the stages' times are taken from another clock, s: the processor's, where others use it too."""
    global _clock
    before, _clock = _clock, clock
    try:
        yield
    finally:
        _clock = before


@contextmanager
def timed(ms: dict[str, float], stage: str) -> Iterator[None]:
    """Add the milliseconds of the block to ``ms[stage]``."""
    clock = _clock
    start = clock()
    try:
        yield
    finally:
        ms[stage] += (clock() - start) * 1e3
