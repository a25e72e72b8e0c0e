"""The tracker: one depth frame in, every stage's result out. Read it beside section 4 of the paper."""

from __future__ import annotations

import time
from contextlib import contextmanager
from dataclasses import replace

import numpy as np

from ..actor import Actor
from ..frame import Features2D, RgbdFrame
from ..mesh import transform_points, vertex_normals
from ..parameters import Parameters
from ..registration.association import find_correspondences
from ..registration.surface import DepthSurface, crop_window, depth_surface, occluded_share
from .adaptive_pca import AdaptiveModel
from .detection import pose_from_features
from .expression import BlendshapeFit
from .feature_confidence import weigh_features
from .feature_refinement import FeatureRefinement
from .feature_rows import feature_rows, reprojection_errors
from .held_out import HeldOut
from .kalman import CoefficientFilter
from .laplacian import FeatureTerm, LaplacianDeformation, feature_term
from .printed import depth_offsets, offsets_at_features, printed_term
from .rigid import RigidFit, RigidTracker
from .types import STAGE_NAMES, SampleState, TrackedFrame
from .verdict import why_lost

#: Weight, 1/mm^2, by which the mesh is bent to the coarsely refined features before they are refined finely.
FOLLOW_WEIGHT = 3.0


class FaceTracker:
    """Tracks one actor. ``track(frame)`` for every frame in order; ``reset()`` starts over, ``forget()`` drops the pose only.

    ``given`` is the actor it was made for; ``actor`` the same with the features that the tracker works with.
    State between frames: the head pose, the coefficients, the last deformation and final mesh, and the adaptive ``model``.
    """

    def __init__(self, actor: Actor, parameters: Parameters | None = None) -> None:
        self.given = self.actor = actor
        self.parameters = p = parameters or Parameters()
        blendshapes = BlendshapeFit(actor, p.blendshapes)
        self.model = AdaptiveModel(actor, blendshapes.basis, p.adaptive_pca)
        self.kalman = CoefficientFilter(p.kalman)
        frontal, triangles = actor.frontal, actor.triangles
        rigging = (actor.neutral, triangles, frontal, actor.feature_triangles, actor.feature_weights)
        self.deformation = LaplacianDeformation(*rigging, *p.laplacian.energies)
        self.final_deformation = LaplacianDeformation(*rigging, *p.laplacian.final_energies)
        self._frontal = np.flatnonzero(frontal)
        self._outside = np.flatnonzero(~frontal)
        self._neutral = actor.neutral[self._frontal]
        self._outline = actor.neutral[self._frontal[::5]]  # dense enough to know where the face is
        self._may_match = actor.depth_valid[frontal]
        self._local = local = np.cumsum(frontal) - 1
        self._frontal_triangles = local[triangles[frontal[triangles].all(axis=1)]]
        self.held_out = HeldOut(actor)
        self.refine_with(p)
        self.fit_with(blendshapes)
        self.reset()

    def refine_with(self, parameters: Parameters) -> None:
        """Refine detected features by these parameters, if the actor's appearance is known."""
        known = self.actor.appearance is not None and parameters.refinement.on
        self.refinement = FeatureRefinement(self.actor, parameters.refinement) if known else None

    def fit_with(self, blendshapes: BlendshapeFit) -> None:
        """Use these blendshapes, and the rigid alignment of the vertices that they fit."""
        self.blendshapes, p = blendshapes, self.parameters.rigid
        self._fitted = self._local[blendshapes.depth_vertices]
        motion = np.linalg.norm(blendshapes.basis[:, blendshapes.depth_vertices], axis=2).max(axis=0)
        self.rigid = RigidTracker(1.0 / (1.0 + (motion / p.stiff) ** 2), p)

    def reset(self) -> None:
        """Start over: forget the pose, the expression and everything learned."""
        self.model.reset()
        self._x = np.zeros(len(self.blendshapes.basis))
        self.forget()

    def forget(self) -> None:
        """Forget where the head was; the next frame is searched by its 2D features."""
        self.pose: np.ndarray | None = None
        self._x = np.zeros_like(self._x)
        self._v1 = self._v4 = self.actor.neutral
        self._deformation = np.zeros((len(self._frontal), 3))
        self.kalman.reset()

    def track(self, frame: RgbdFrame) -> TrackedFrame:
        """Section 4 for one frame. Never raises on a bad frame: the result says ``tracked`` False and why."""
        ms = dict.fromkeys(STAGE_NAMES, 0.0)
        with timed(ms, "preprocess"):
            normals = self._normals()
        rigid, surface = self._find_head(frame, normals, ms)
        if rigid is None:
            self.forget()
            return self.untracked(frame, why_lost(frame, self.blendshapes.feature_points(self._x)), ms)
        face = None if frame.features is None else frame.features.face  # refined features come without it
        with timed(ms, "preprocess"):
            frame = self._refine_features(frame, rigid.pose)
            expected = transform_points(rigid.pose, self.blendshapes.feature_points(self._x))
            frame = weigh_features(frame, expected)

        with timed(ms, "blendshapes"):  # section 4.2
            stiff = normals[self._fitted]
            pose, x = self.blendshapes.fit(
                surface, frame.features, frame.camera, rigid.pose, self._x, stiff, settle=self._settled
            )
            v1 = self.blendshapes.shape(x)
        with timed(ms, "laplacian"):  # section 4.3, equations (3) to (7)
            deformation, coverage, occluded = self._deform_to_depth(surface, frame, pose, v1, normals)
            v2 = self._displace(v1, deformation)
        with timed(ms, "projection"):  # section 4.3, last equation
            v3 = self._project(v2)
        with timed(ms, "final_deformation"):  # section 4.4
            v4 = self._displace(v3, self._deform_to_features(frame, pose, v3))
        anchor, adaptive = self.model.distances(deformation.ravel())  # figure 11: before the frame is learned from
        with timed(ms, "adaptive_pca"):  # section 5
            state = self._learn(deformation, coverage, occluded)
        with timed(ms, "resolve"):  # section 6
            coefficients = self.blendshapes.resolve(v4, x)

        self.pose, self._x, self._deformation = pose, x, deformation
        self._v1, self._v4 = v1, v4
        return TrackedFrame(
            frame.index,
            frame.timestamp,
            True,
            pose,
            v1,
            v2,
            v3,
            v4,
            x,
            coefficients,
            state,
            self.model.updates,
            rigid.residual,
            anchor,
            adaptive,
            ms,
            held_out=self.held_out.measure(face, frame.camera, pose, v4),
        )

    def _settled(self, x: np.ndarray) -> np.ndarray:
        """The coefficients (A,) of this frame: filtered over time, within their bounds (section 4.2)."""
        limits = self.parameters.blendshapes
        return np.clip(self.kalman.update(x), limits.lower, limits.upper)

    # ---- section 4.1 -----------------------------------------------------------------------------------------------
    def _find_head(self, frame: RgbdFrame, normals: np.ndarray, ms) -> tuple[RigidFit | None, DepthSurface | None]:
        """Rigid ICP from the last pose, or from the 2D features where that fails or disagrees with them."""
        best: tuple[RigidFit | None, DepthSurface | None] = (None, None)
        for propose in (lambda: self.pose, lambda: self._detect(frame)):
            with timed(ms, "preprocess"):
                start = propose()
                surface = None if start is None else self._crop(frame, start)
            if surface is None:
                continue
            with timed(ms, "rigid"):
                mesh = self._v4 if self.parameters.rigid.shape == "output" else self._v1
                shape = mesh[self.blendshapes.depth_vertices]
                fit = self.rigid.align(surface, shape, normals[self._fitted], start)
            if fit.residual < self.parameters.rigid.lost:
                if self._agrees(frame, fit.pose):
                    return fit, surface
                best = best if best[0] and best[0].residual < fit.residual else (fit, surface)
        return best

    def _detect(self, frame: RgbdFrame) -> np.ndarray | None:
        return pose_from_features(frame, self.blendshapes.feature_points(self._x))

    def _agrees(self, frame: RgbdFrame, pose: np.ndarray) -> bool:
        if frame.features is None or frame.features.valid.sum() < 6:
            return True
        points = transform_points(pose, self.blendshapes.feature_points(self._x))
        return bool(np.median(reprojection_errors(frame.features, frame.camera, points)) < self.parameters.rigid.relocate)

    def _crop(self, frame: RgbdFrame, pose: np.ndarray) -> DepthSurface | None:
        points = transform_points(pose, self._outline)
        if (points[:, 2] < 50.0).any():
            return None
        pixels = frame.camera.project(points)
        p = self.parameters.depth
        window = crop_window(frame.camera, pixels, p.margin * frame.camera.fx / float(points[:, 2].mean()), p.crop)
        surface = depth_surface(frame.depth, frame.camera, window, p)
        return surface if surface.valid.any() else None

    # ---- the 2D features, by the neutral's colours (not in the paper) ----------------------------------------------
    def _refine_features(self, frame: RgbdFrame, pose: np.ndarray) -> RgbdFrame:
        """The frame with refined features, where it has colour and the actor's appearance is known."""
        features = frame.features
        if self.refinement is None or frame.colour is None or features is None or features.valid.sum() < 6:
            return frame

        def follow(refined: Features2D, mesh: np.ndarray) -> np.ndarray:
            """The mesh (N, 3) bent to the features alone, which all count alike."""
            certain = replace(frame, features=replace(refined, confidence=np.ones(len(refined.confidence))))
            term = self._feature_term(certain, pose, mesh, FOLLOW_WEIGHT, hold_depth=True)
            return self._displace(mesh, self.final_deformation.deform_to_features(term))

        return replace(frame, features=self.refinement.refine(frame, self._v4, pose, follow))

    # ---- sections 4.3, 4.4 and 5 -----------------------------------------------------------------------------------
    def _normals(self) -> np.ndarray:
        """(n, 3) head-frame normals of the frontal vertices of the last frame's v1."""
        return vertex_normals(self._v1[self._frontal], self._frontal_triangles)

    def _deform_to_depth(self, surface, frame, pose, v1, normals) -> tuple[np.ndarray, float, float]:
        """Displacement (n, 3); shares of the vertices that have depth, and that something in front of them hides."""
        p = self.parameters.laplacian
        matches = find_correspondences(surface, v1[self._frontal], normals, p.prune, pose)
        matches.weights[~self._may_match] = 0.0
        coverage = matches.count / max(int(self._may_match.sum()), 1)
        occluded = occluded_share(surface, matches.points[::3], normals[::3] @ pose[:3, :3].T, p.prune)
        if p.feature_rows == "soft":
            term = self._feature_term(frame, pose, v1, p.feature_weight, hold_depth=False)
        else:
            rise = offsets_at_features(matches, pose, self.deformation.corners, self.deformation.shares) @ pose[2, :3]
            term = self._printed_term(frame, pose, v1, rise)
        if p.depth_term == "point-to-point":
            offsets = depth_offsets(matches, pose, self._deformation)
            return self.deformation.deform_to_points(offsets, term), coverage, occluded
        planes = matches.normals @ pose[:3, :3]
        return self.deformation.deform(matches, planes, term, self._deformation, p.steps), coverage, occluded

    def _deform_to_features(self, frame: RgbdFrame, pose: np.ndarray, v3: np.ndarray) -> np.ndarray:
        p = self.parameters.laplacian
        if p.feature_rows == "soft":
            term = self._feature_term(frame, pose, v3, p.final_feature_weight, hold_depth=True)
        else:
            term = self._printed_term(frame, pose, v3, rise=0.0)
        return self.final_deformation.deform_to_features(term)

    def _feature_term(self, frame: RgbdFrame, pose: np.ndarray, vertices: np.ndarray, weight: float, hold_depth: bool):
        rows = feature_rows(frame.features, frame.camera, pose)
        actor = self.actor
        corners, share = actor.feature_triangles[rows.index], actor.feature_weights[rows.index]
        points = np.einsum("fk,fkd->fd", share, vertices[corners])
        return feature_term(rows, points, pose, frame.camera.fx, weight, hold_depth)

    def _printed_term(self, frame: RgbdFrame, pose: np.ndarray, vertices: np.ndarray, rise) -> FeatureTerm:
        """The features' rows of equations (4) and (5); ``rise`` (40,) mm: by how much their depth is to change."""
        points = np.einsum("fk,fkd->fd", self.actor.feature_weights, vertices[self.actor.feature_triangles])
        return printed_term(frame.features, frame.camera, pose, points, rise, self.parameters.laplacian)

    def _project(self, v2: np.ndarray) -> np.ndarray:
        frontal, outside = self.model.project(self._displacement(v2))
        v3 = self.actor.neutral.copy()
        v3[self._frontal] += frontal.reshape(-1, 3)
        v3[self._outside] += outside.reshape(-1, 3)
        return v3

    def _learn(self, deformation: np.ndarray, coverage: float, occluded: float) -> SampleState:
        """v2 as a training sample; v1 - b0 lies in the anchor space, so that only v2 - v1 has a part outside it."""
        p = self.parameters.adaptive_pca
        if coverage < p.min_coverage or occluded > p.max_occluded:
            return SampleState.HIDDEN
        return self.model.learn(deformation.ravel()) if p.learn else self.model.classify(deformation.ravel())[0]

    def _displacement(self, vertices: np.ndarray) -> np.ndarray:
        return (vertices[self._frontal] - self._neutral).ravel()

    def _displace(self, vertices: np.ndarray, deformation: np.ndarray) -> np.ndarray:
        moved = vertices.copy()
        moved[self._frontal] += deformation
        return moved

    def untracked(self, frame: RgbdFrame, reason: str, ms: dict[str, float] | None = None) -> TrackedFrame:
        """The result of a ``frame`` in which there is no face, or none that can be tracked: the neutral, unmoved."""
        neutral, x = self.actor.neutral, self._x
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


@contextmanager
def timed(ms: dict[str, float], stage: str):
    """Add the milliseconds of the block to ``ms[stage]``."""
    start = time.perf_counter()
    try:
        yield
    finally:
        ms[stage] += (time.perf_counter() - start) * 1e3
