"""Track: one depth frame goes in, and every stage's result comes out. Read this beside section 4 of the paper."""

from __future__ import annotations

from dataclasses import replace
from typing import Self

import numpy as np

from ..geometry.frame import Features2D, RgbdFrame
from ..geometry.mesh import transform_points
from ..model.actor import Actor
from ..parameters import Parameters
from ..registration.association import Correspondences, find_correspondences
from ..registration.surface import DepthSurface, crop_window, depth_surface, occluded_share
from .adaptive_pca import Parts
from .base import Tracker, differ, timed
from .colour_clock import ColourClock
from .dense_skin import DenseSkin, Looks
from .detection import pose_from_features
from .feature_confidence import weigh_features
from .feature_prediction import MOST_OCCLUDED, confidence_kept, predict_features
from .feature_refinement import FeatureRefinement
from .feature_rows import reprojection_errors
from .laplacian import FrameSystem
from .personal_blendshapes import PersonalBlendshapes
from .printed import depth_offsets, offsets_at_features
from .rigid import RigidFit
from .stages import Stages
from .state import TrackerState
from .types import STAGE_NAMES, SampleState, TrackedFrame
from .verdict import why_lost

#: Weight by which the mesh is deformed to the coarsely refined features before they are refined finely, 1/mm^2.
FOLLOW_WEIGHT = 3.0
#: The personal blendshapes learn from this share of the fitted coefficients, and from the re-solved ones for the rest.
MEASURED = 0.25


class FaceTracker(Tracker):
    """Tracks a face in frames with depth by the method of sections 4 and 5.

    Parameters
    ----------
    actor : Actor
        The rig of the person to be tracked.
    parameters : Parameters, optional
        Our defaults without.
    stages : Stages, optional
        The callables that make the stages, any of which can be replaced.
    """

    def __init__(self, actor: Actor, parameters: Parameters | None = None, stages: Stages | None = None) -> None:
        super().__init__(actor, parameters, stages)
        self._middle = self.region.neutral.mean(axis=0)
        self._outline = self.region.neutral[::5]  # dense enough to know where the face is
        self._may_match = actor.depth_valid[actor.frontal]

    def _make_stages(self, old: Parameters | None) -> None:
        super()._make_stages(old)
        p, make = self.parameters, self.stages
        if old is None:
            self.deformation = make.deformation(self.actor, *p.laplacian.energies)
        elif differ(old, p, "laplacian.energies"):
            self.deformation = self.deformation.reweighted(*p.laplacian.energies)
        if differ(old, p, "refinement"):
            known = self.actor.appearance is not None and p.refinement.on
            self.refinement: FeatureRefinement | None = make.refinement(self.actor, p.refinement) if known else None
        if differ(old, p, "skin", "laplacian"):
            self.skin = self._make_skin()
        if differ(old, p, "blendshapes", "rigid"):
            fitted = self.blendshapes.depth_vertices
            motion = np.linalg.norm(self.blendshapes.basis[:, fitted], axis=2).max(axis=0)
            self.rigid = make.rigid(1.0 / (1.0 + (motion / p.rigid.half_weight_motion) ** 2), p.rigid)
            self._fitted = self.region.local[fitted]
        if differ(old, p, "personal_blendshapes", "blendshapes.A"):
            self.personal = self._make_personal()
        if differ(old, p, "personal_blendshapes", "blendshapes"):
            self.wear_personal()

    def _make_personal(self) -> PersonalBlendshapes | None:
        p, basis = self.parameters.personal_blendshapes, self.transferred.basis
        names = self.actor.expression_names[: len(basis)]
        return self.stages.personal_blendshapes(basis[:, self.region.vertices], p, names) if p.on else None

    def _make_skin(self) -> DenseSkin | None:
        """Make the colour term if the actor's skin is known in colour. It only works with soft rows.

        In infrared the sensor's own lamp lights the face, and three people gained nothing by the term.
        """
        p, skin = self.parameters, self.actor.skin
        if skin is None or not skin.coloured or not p.skin.on:
            return None
        if p.laplacian.depth_term != "point-to-plane" or p.laplacian.feature_rows != "soft":
            return None
        return self.stages.skin(skin, self.region, self.deformation, p.skin)

    def forget_learned(self) -> None:
        """Forget the correctives and the personal blendshapes, but keep the pose and the expression."""
        super().forget_learned()
        if self.personal is not None:
            self.personal.reset()
            self.wear_personal()

    def copy(self) -> Self:
        """Copy the tracker between two frames. Arrays are not copied, because tracking replaces them."""
        out = super().copy()
        out.personal = None if self.personal is None else self.personal.copy()
        return out

    @property
    def detect_every(self) -> int:
        """``refinement.detect_every`` while features can be predicted and refined, or 1 if they must be detected."""
        certain = self.refinement is not None and self.state.confidence is not None and not self.state.clock.late
        return self.parameters.refinement.detect_every if certain else 1

    def track(self, frame: RgbdFrame) -> TrackedFrame:
        """Track one frame (section 4).

        Parameters
        ----------
        frame : RgbdFrame
            With 2D features if a face was found.

        Returns
        -------
        TrackedFrame
            Every stage's result. A bad frame raises nothing: ``tracked`` is then False, and ``reason`` says why.
        """
        last, ms = self.state, dict.fromkeys(STAGE_NAMES, 0.0)
        with timed(ms, "preprocess"):
            normals = self.region.normals(last.v1)
        rigid, surface = self._find_head(frame, normals, ms)
        if rigid is None or surface is None:
            self.forget()
            return self.untracked(frame, why_lost(frame, self.blendshapes.feature_points(self.state.coefficients)), ms)
        face = None if frame.features is None else frame.features.face  # refined features do not contain it
        with timed(ms, "preprocess"):
            frame = self._refine_features(found := predict_features(frame, self.actor, last, rigid.pose), rigid.pose)
            expected = transform_points(rigid.pose, self.blendshapes.feature_points(last.coefficients))
            frame = weigh_features(frame, expected)

        with timed(ms, "blendshapes"):  # section 4.2
            stiff = normals.take(self._fitted, axis=0)
            pose, x = self.blendshapes.fit(
                surface, frame.features, frame.camera, rigid.pose, last.coefficients, stiff, settle=self._filtered
            )
            v1 = self.blendshapes.shape(x)
        with timed(ms, "laplacian"):  # section 4.3, equations (3) to (7)
            matches, occluded = self._match_depth(surface, pose, v1, normals)
            coverage = matches.count / max(int(self._may_match.sum()), 1)
        deformation, clock = self._deform(frame, pose, v1, matches, ms)
        with timed(ms, "laplacian"):
            v2 = self.region.displaced(v1, deformation)
        with timed(ms, "projection"):  # section 4.3, last equation
            v3, parts = self._project(v1, v2)
        with timed(ms, "final_deformation"):  # section 4.4
            v4 = self._deform_to_features(frame, pose, v3)
        with timed(ms, "adaptive_pca"):  # section 5
            distances = parts.distances()  # figure 11: before the frame is learned from
            state = self._learn(parts, coverage, occluded, clock.late)
        with timed(ms, "resolve"):  # section 6
            coefficients = self.blendshapes.resolve(v4, x)
        steady = rigid.residual < 0.5 * self.parameters.rigid.max_residual and occluded <= MOST_OCCLUDED
        confidence = confidence_kept(found, frame) if steady else None
        with timed(ms, "adaptive_pca"):
            self._learn_expressions(state, MEASURED * x + (1.0 - MEASURED) * coefficients, v2, coverage)

        self.state = TrackerState(pose, x, v1, v4, deformation, self.state.filter, confidence, clock)
        meshes, held_out = (v1, v2, v3, v4), self.held_out.measure(face, frame.camera, pose, v4, x)
        return self._tracked(frame, pose, meshes, (x, coefficients), distances, ms, held_out, state, rigid.residual)

    # ---- section 4.1 -----------------------------------------------------------------------------------------------
    def _find_head(
        self, frame: RgbdFrame, normals: np.ndarray, ms: dict[str, float]
    ) -> tuple[RigidFit | None, DepthSurface | None]:
        """Run rigid ICP from the last pose, or from the 2D features if that fails or disagrees with them."""
        best: tuple[RigidFit | None, DepthSurface | None] = (None, None)
        for again in (False, True):
            with timed(ms, "preprocess"):
                start = self._detect(frame) if again else self.state.pose
                surface = None if start is None else self._crop(frame, start)
            if start is None or surface is None:
                continue
            with timed(ms, "rigid"):
                mesh = self.state.v4 if self.parameters.rigid.shape == "output" else self.state.v1
                shape = mesh.take(self.blendshapes.depth_vertices, axis=0)
                fit = self.rigid.align(surface, shape, normals.take(self._fitted, axis=0), start)
            if fit.residual < self.parameters.rigid.max_residual:
                if self._agrees(frame, fit.pose):
                    return fit, surface
                best = best if best[0] and best[0].residual < fit.residual else (fit, surface)
            elif again and self._agrees(frame, fit.pose):
                best = best if best[0] else self._find_in_expression(frame, surface, normals, fit.pose, ms)
        return best

    def _find_in_expression(
        self, frame: RgbdFrame, surface: DepthSurface, normals: np.ndarray, pose: np.ndarray, ms: dict[str, float]
    ) -> tuple[RigidFit | None, DepthSurface | None]:
        """Align the head in this frame's expression, for a face that is found laughing and does not fit the one before.

        In a photograph of a broad smile the resting face was 3.2 mm away on average, and the face was called lost.
        """
        stiff = normals.take(self._fitted, axis=0)
        with timed(ms, "blendshapes"):
            pose, x = self.blendshapes.fit(surface, frame.features, frame.camera, pose, self.state.coefficients, stiff)
        with timed(ms, "rigid"):
            shape = self.blendshapes.shape(x).take(self.blendshapes.depth_vertices, axis=0)
            fit = self.rigid.align(surface, shape, stiff, pose)
        return (fit, surface) if fit.residual < self.parameters.rigid.max_residual else (None, None)

    def _detect(self, frame: RgbdFrame) -> np.ndarray | None:
        return pose_from_features(frame, self.blendshapes.feature_points(self.state.coefficients))

    def _agrees(self, frame: RgbdFrame, pose: np.ndarray) -> bool:
        if frame.features is None or frame.features.valid.sum() < 6:
            return True
        points = transform_points(pose, self.blendshapes.feature_points(self.state.coefficients))
        errors = reprojection_errors(frame.features, frame.camera, points)
        return bool(np.median(errors) < self.parameters.rigid.max_reprojection_error)

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
        """Refine the frame's features if it has colour and the actor's appearance is known."""
        features = frame.features
        if self.refinement is None or frame.colour is None or features is None or features.valid.sum() < 6:
            return frame

        def follow(refined: Features2D, mesh: np.ndarray) -> np.ndarray:
            """Deform the mesh (N, 3) to the features alone, which all have the same weight."""
            certain = Features2D(refined.pixels, np.ones(len(refined.confidence)))
            term = self._feature_term(certain, frame.camera, pose, mesh, FOLLOW_WEIGHT, hold_depth=True)
            return self.region.displaced(mesh, self.final_deformation.deform_to_features(term))

        return replace(frame, features=self.refinement.refine(frame, self.state.v4, pose, follow))

    # ---- sections 4.3, 4.4 and 5 -----------------------------------------------------------------------------------
    def _match_depth(
        self, surface: DepthSurface, pose: np.ndarray, v1: np.ndarray, normals: np.ndarray
    ) -> tuple[Correspondences, float]:
        """Match the frontal vertices with the depth, and measure the share of them that something else hides."""
        p = self.parameters.laplacian
        matches = find_correspondences(
            surface, v1.take(self.region.vertices, axis=0), normals, p.max_correspondence_distance, pose
        )
        matches.weights[~self._may_match] = 0.0
        some = np.flatnonzero(self._may_match)[::3]  # vertices under hair are always hidden
        occluded = occluded_share(surface, matches.points[some], normals[some] @ pose[:3, :3].T, p.max_correspondence_distance)
        return matches, occluded

    def _deform(
        self, frame: RgbdFrame, pose: np.ndarray, v1: np.ndarray, matches: Correspondences, ms: dict[str, float]
    ) -> tuple[np.ndarray, ColourClock]:
        """Displacement (n, 3) of v1's frontal vertices towards depth, features and colours, mm, and the pictures' clock."""
        with timed(ms, "skin"):  # the colours tell about motion within the surface
            looks, clock = self._looks(frame, pose, v1, matches)
        with timed(ms, "laplacian"):
            if looks is None:
                return self._deform_to_depth(frame, pose, v1, matches), clock
            p = self.parameters
            weight = p.laplacian.feature_weight
            term = self._feature_term(frame.features, frame.camera, pose, v1, weight, hold_depth=False)
            system = FrameSystem(looks.deformation, matches, matches.normals @ pose[:3, :3], term)
        d, colours = self.state.deformation, looks.first
        for left in range(p.skin.gauss_newton_steps - 1, -1, -1):
            with timed(ms, "laplacian"):  # before the last look, smooth motion is enough
                d = system.deform(d, 0 if left else p.skin.cg_iterations, colours)
            with timed(ms, "skin"):
                colours = looks.again(d) if left else colours
        return d, clock

    def _looks(
        self, frame: RgbdFrame, pose: np.ndarray, v1: np.ndarray, matches: Correspondences
    ) -> tuple[Looks | None, ColourClock]:
        """The rows of a picture, linearised at the last frame's displacement, or None without information, and the clock."""
        last, clock = self.state, self.state.clock
        if self.skin is None or frame.colour is None:
            return None, clock
        vertices, clock = v1.take(self.region.vertices, axis=0), clock.after(frame)
        before = None if last.pose is None else self.region.placed(last.v4, last.pose)
        looks = self.skin.look(frame, pose, vertices, last.deformation, matches.weights > 0, before)
        if looks is not None and last.pose is not None:
            motion = transform_points(pose, self._middle) - transform_points(last.pose, self._middle)
            clock = clock.seen(looks.first, pose[:3, :3], motion, looks.gain)
        return None if clock.late else looks, clock

    def _deform_to_depth(self, frame: RgbdFrame, pose: np.ndarray, v1: np.ndarray, matches: Correspondences) -> np.ndarray:
        """Displacement (n, 3) of the frontal vertices of v1 towards depth and 2D features, mm."""
        p, start = self.parameters.laplacian, self.state.deformation
        if p.feature_rows == "soft":
            term = self._feature_term(frame.features, frame.camera, pose, v1, p.feature_weight, hold_depth=False)
        else:
            rise = offsets_at_features(matches, pose, self.deformation.corners, self.deformation.shares) @ pose[2, :3]
            term = self._printed_term(frame, pose, v1, rise)
        if p.depth_term == "point-to-point":
            return self.deformation.deform_to_points(depth_offsets(matches, pose, start), term)
        return self.deformation.deform(matches, matches.normals @ pose[:3, :3], term, start, p.cg_iterations)

    def _learn(self, parts: Parts, coverage: float, occluded: float, late: bool) -> SampleState:
        """Learn from v2 - v1 as a training sample.

        While the blendshapes are the transferred ones, v1 - b0 lies in the anchor space, and v2 - b0 is the same sample.
        Personal blendshapes explain what they add to v1, so that the sample does not contain it. If ``late``, the colours and
        the features found in them belong to another moment than the depth.
        """
        p = self.parameters.adaptive_pca
        if coverage < p.min_coverage or occluded > p.max_occluded or late:
            return SampleState.HIDDEN
        return self.model.learn(parts) if p.learn else self.model.classify(parts)

    def _learn_expressions(self, state: SampleState, x: np.ndarray, v2: np.ndarray, coverage: float) -> None:
        """Learn from v2 about the meshes of the expressions, in frames from which the correctives would also learn.

        ``x`` lies between the fitted and the re-solved coefficients, whose errors differ (:data:`MEASURED`).
        """
        good = state in (SampleState.IN_ANCHOR_SPACE, SampleState.LEARNED)
        if self.personal is not None and good and self.parameters.adaptive_pca.learn:
            if self.personal.learn(x, self.region.difference(v2, self.actor.neutral), coverage):
                self.wear_personal()
