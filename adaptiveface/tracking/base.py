"""Hold what the trackers with and without depth share: the state between frames, and the stages that both use."""

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

from ..geometry.camera import Camera
from ..geometry.frame import Features2D, RgbdFrame
from ..model.actor import Actor
from ..parameters import Parameters
from .adaptive_pca import AdaptiveModel, Parts
from .held_out import HeldOut
from .laplacian import FeatureTerm, feature_term
from .personal_blendshapes import PersonalBlendshapes
from .printed import printed_term
from .region import FrontalRegion
from .stages import Stages
from .state import TrackerState
from .types import STAGE_NAMES, SampleState, TrackedFrame


class Tracker(ABC):
    """Tracks one actor. Call ``track(frame)`` for every frame in order.

    Attributes
    ----------
    given, actor : Actor
        The actor for which the tracker was made, and the same actor with the features that the tracker uses.
    stages : Stages
        How the stages are made. The stages themselves are attributes of the same names.
    state : TrackerState
        The face after the last frame.
    model : AdaptiveModel
        What has been learned (section 5).
    """

    def __init__(self, actor: Actor, parameters: Parameters | None = None, stages: Stages | None = None) -> None:
        self.given = self.actor = actor
        self.parameters, self.stages = parameters or Parameters(), stages or Stages()
        self.region, self.held_out = FrontalRegion(actor), HeldOut(actor)
        self._make_stages(None)
        self.model = self._new_model()
        self.reset()

    #: What is learned about the meshes of the expressions; None if they are not learned.
    personal: PersonalBlendshapes | None = None

    # ---- the state between frames ----------------------------------------------------------------------------------
    @property
    def pose(self) -> np.ndarray | None:
        """The last pose (4, 4), head frame to camera frame, mm; None if it is not known."""
        return self.state.pose

    @property
    def detect_every(self) -> int:
        """Interval of frames at which the detector must look from now on; 1 if nothing else finds features."""
        return 1

    @property
    def expressions(self) -> np.ndarray | None:
        """The current expressions (A, N, 3), mm; None while they are the actor's."""
        return None if self.blendshapes is self.transferred else self.blendshapes.basis

    def wear_personal(self) -> None:
        """Fit with the current expressions. The anchors remain those of the transferred expressions."""
        self.blendshapes = self.transferred
        if self.personal is not None and self.personal.updates:
            basis = self.region.changed(self.transferred.basis, self.personal.change)
            self.blendshapes = self.transferred.with_basis(basis)

    def personal_actor(self) -> Actor:
        """Return the actor with the current expressions. When it is saved, another tracker can continue with them."""
        blendshapes = self.given.blendshapes.copy()
        blendshapes[: len(self.blendshapes.basis)] = self.blendshapes.basis
        return replace(self.given, blendshapes=blendshapes)

    def forget_learned(self) -> None:
        """Forget everything learned, but keep the pose and the expression."""
        self.model.reset()

    def reset(self) -> None:
        """Start over: forget the pose, the expression and everything learned."""
        self.forget_learned()
        self.forget()

    def forget(self) -> None:
        """Forget the pose and the expression. The head is then found by the 2D features of the next frame."""
        neutral = self.actor.neutral
        self.state = TrackerState(
            pose=None,
            coefficients=np.zeros(len(self.blendshapes.basis)),
            v1=neutral,
            v4=neutral,
            deformation=np.zeros((len(self.region), 3)),
        )

    def copy(self) -> Self:
        """Copy the tracker between two frames. Arrays are not copied, because tracking replaces them."""
        out = copy.copy(self)
        out.model = self.model.copy()
        return out

    def with_state(self, state: TrackerState) -> Self:
        """Return a copy that continues from ``state``, which has the same number of expressions. Nothing is factorised."""
        out = self.copy()
        out.state = state
        return out

    def with_parameters(self, parameters: Parameters, relearn: bool = True) -> Self:
        """Return a tracker that continues from this one with other parameters. Only the stages that changed are made again.

        Parameters
        ----------
        parameters : Parameters
            Of the new tracker.
        relearn : bool
            Whether the model learns again from the samples in its buffer if the number of expressions, of correctives or of
            samples changes. False leaves the model unchanged, but another number of expressions starts it over.

        Returns
        -------
        Tracker
            Of the same kind.
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
        """Adapt the ``state`` of a tracker with another number of expressions, and drop those that this tracker lacks."""
        x = np.zeros(len(self.blendshapes.basis))
        count = min(len(x), len(state.coefficients))
        x[:count] = state.coefficients[:count]
        return replace(state, coefficients=x, v1=self.blendshapes.shape(x), filter=None)

    # ---- the stages ------------------------------------------------------------------------------------------------
    def _make_stages(self, old: Parameters | None) -> None:
        """Make the stages whose parameters differ from ``old``, or all stages if ``old`` is None."""
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
        """Track one frame. A bad frame raises nothing: ``tracked`` is then False, and ``reason`` says why."""

    def _filtered(self, measured: np.ndarray) -> np.ndarray:
        """Filter the coefficients (A,) of this frame over time, and keep them within their bounds (section 4.2)."""
        limits = self.parameters.blendshapes
        filtered = self.kalman.step(self.state.filter, measured)
        self.state = replace(self.state, filter=filtered)
        coefficients: np.ndarray = np.clip(filtered.coefficients, limits.lower, limits.upper)
        return coefficients

    def _deform_to_features(self, frame: RgbdFrame, pose: np.ndarray, mesh: np.ndarray) -> np.ndarray:
        """Deform ``mesh`` (N, 3) to the features alone (section 4.4), head frame, mm."""
        p = self.parameters.laplacian
        if p.feature_rows == "soft":
            term = self._feature_term(frame.features, frame.camera, pose, mesh, p.final_feature_weight, hold_depth=True)
        else:
            term = self._printed_term(frame, pose, mesh, rise=0.0)
        return self.region.displaced(mesh, self.final_deformation.deform_to_features(term))

    def _feature_term(
        self, seen: Features2D | None, camera: Camera, pose: np.ndarray, mesh: np.ndarray, weight: float, hold_depth: bool
    ) -> FeatureTerm:
        """The rows that pull the features of ``mesh`` (N, 3) to where they were ``seen``."""
        corners, shares = self.actor.feature_triangles, self.actor.feature_weights
        return feature_term(seen, camera, pose, mesh, corners, shares, weight, hold_depth)

    def _printed_term(self, frame: RgbdFrame, pose: np.ndarray, mesh: np.ndarray, rise: np.ndarray | float) -> FeatureTerm:
        """Rows of the features in equations (4) and (5). ``rise`` (40,) is the wanted change of their depth, mm."""
        points = np.einsum("fk,fkd->fd", self.actor.feature_weights, mesh[self.actor.feature_triangles])
        return printed_term(frame.features, frame.camera, pose, points, rise, self.parameters.laplacian)

    def _project(self, v1: np.ndarray, v2: np.ndarray) -> tuple[np.ndarray, Parts]:
        """Project v2 on the adaptive space (section 4.3, last equation); returns v3 (N, 3) and the parts of v2 - v1."""
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
        """Make the result of a tracked frame.

        ``meshes`` are v1 to v4, ``coefficients`` those of v1 and of v4, and ``distances`` those of :meth:`Parts.distances`.
        """
        learned = state, self.model.updates
        own = frame.index, frame.timestamp, True, pose, *meshes, *coefficients
        return TrackedFrame(*own, *learned, residual, *distances, ms, held_out=held_out)

    def untracked(self, frame: RgbdFrame, reason: str, ms: dict[str, float] | None = None) -> TrackedFrame:
        """Make the result of a frame without a face that can be tracked: the neutral without motion."""
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
    """Whether any of the stages or parameters ``names`` ("kalman", "laplacian.w2") differs; True if ``old`` is None."""
    values: Callable[[Parameters], object] = attrgetter(*names)
    return old is None or values(old) != values(new)


_clock: Callable[[], float] = time.perf_counter


@contextmanager
def stage_clock(clock: Callable[[], float]) -> Iterator[None]:
    """Context in which another clock measures the stages, s: that of the processor, if other programs use it, too."""
    global _clock
    before, _clock = _clock, clock
    try:
        yield
    finally:
        _clock = before


class timed:  # noqa: N801
    """Context that adds its milliseconds to ``ms[stage]``: entered 18 times a frame, where a generator takes twice as long."""

    __slots__ = ("_clock", "_ms", "_stage", "_start")

    def __init__(self, ms: dict[str, float], stage: str) -> None:
        self._ms, self._stage, self._clock = ms, stage, _clock

    def __enter__(self) -> None:
        self._start = self._clock()

    def __exit__(self, *_: object) -> None:
        self._ms[self._stage] += (self._clock() - self._start) * 1e3
