"""Detected 2D features moved to where the picture shows the skin that they sat on in the neutral.

A detector's error follows the expression and the person, and is alike at neighbouring features; no weight takes it out.
Around each feature the neutral's colours are known (:class:`Appearance`), and last frame's mesh says how the skin is bent
now. Wanted are the shifts d_f (px) of the patches that minimise

    sum_f sum_q |I(p_q + d_f) - g_f T_q - o_f|^2 / s_f^2  +  (d - d0)^T S^-1 (d - d0)

Lucas & Kanade 1981, with a gain g and an offset o of the brightness (Baker & Matthews 2004, part 3), on the colours T of
the neutral; d0 is where the detector sees the features, and S its errors' covariance, which lets a corner of the mouth
help the lip beside it. A patch that does not match has a large s_f, and follows its neighbours and the detector.
"""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np

from ..geometry.camera import Camera
from ..geometry.frame import FEATURE_REGIONS, Features2D, RgbdFrame
from ..geometry.mesh import surface_points, transform_points
from ..model.actor import Actor
from ..model.appearance import BLURS, blurred_channels, mixtures
from ..parameters import RefinementParameters
from .patch_alignment import align_patches
from .skin_samples import carry_to_pixels

#: Share of the detector's variance that is a feature's own; the rest is alike at its neighbours.
OWN_SHARE = 0.15
#: px beside the patches in which the picture is prepared: blurs and shifts reach so far.
_BORDER = 16
#: Every so many samples of a patch are compared at each blur: in a blurred picture neighbours tell the same.
STRIDES = (2, 1)
#: Variance, px^2, that no picture takes out of a feature: the mesh itself is a little off.
_FLOOR = 0.2

#: Moves the mesh (N, 3) so that its features lie at the given ones.
Follow = Callable[[Features2D, np.ndarray], np.ndarray]


class FeatureRefinement:
    """Refines the detected features of one actor, who has an ``appearance``."""

    def __init__(self, actor: Actor, parameters: RefinementParameters) -> None:
        if actor.appearance is None:
            raise ValueError("the appearance of the actor's neutral is not known")
        self.actor, self.parameters = actor, parameters
        self._look = look = actor.appearance
        self._starts = np.searchsorted(look.feature, np.arange(len(actor.feature_triangles) + 1))
        homes = surface_points(actor.neutral, actor.feature_triangles, actor.feature_weights)
        away = np.linalg.norm(surface_points(actor.neutral, look.triangles, look.weights) - homes[look.feature], axis=1)
        self._nearness = np.exp(-0.5 * (away / (0.6 * parameters.radius)) ** 2)
        self._area = _areas(actor.neutral, look.triangles, look.feature)
        self._covariance = _error_covariance(actor, parameters)
        self._inverse = (b"", np.zeros((0, 0)))

    def refine(self, frame: RgbdFrame, mesh: np.ndarray, pose: np.ndarray, follow: Follow) -> Features2D:
        """The frame's features at their refined pixels, each with the confidence that the picture gives it.

        mesh (N, 3): the head as it was last, in its own frame; pose (4, 4) head to camera; ``follow`` bends it to the
        features of the coarse pass, before the fine one.
        """
        found, colour = frame.seen, frame.colour
        if colour is None:
            return found
        seen = np.flatnonzero(found.valid)
        depth = float(transform_points(pose, self.actor.neutral[self.actor.feature_vertices])[:, 2].mean())
        scale = frame.camera.fx / depth  # px per mm
        border = int(self.parameters.radius * scale) + _BORDER
        u, v = np.maximum(found.bounding_box[:2].astype(int) - border, 0)
        right, bottom = np.maximum(found.bounding_box[2:].astype(int) + border, 0)
        picture, corner = colour[v:bottom, u:right], np.array([u, v], float)
        if min(picture.shape[:2]) < border:  # the face has left the picture
            return found
        covariance = self._covariance[np.ix_(seen, seen)] * scale**2
        precision = self._precision(seen.tobytes()) / scale**2
        features, mixed = found, mixtures(picture)
        for level, blur in enumerate(BLURS):
            if level:
                mesh = follow(features, mesh)
            patches = self._patches(mesh, pose, frame.camera, corner, level)
            pixels, variance = self._shift(
                patches, blurred_channels(mixed, blur), found, features, precision, seen, STRIDES[level]
            )
            features = Features2D(pixels, found.confidence)
        gained = (np.diag(covariance) + _FLOOR) / (variance + _FLOOR)
        confidence = found.confidence.copy()
        confidence[seen] = np.minimum(confidence[seen] * gained, 1.0)
        return Features2D(pixels, confidence)

    def _precision(self, seen: bytes) -> np.ndarray:
        """Inverse covariance (n, n) of the errors of the features ``seen``, 1/mm^2. It is kept while these stay the same."""
        if seen != self._inverse[0]:
            index = np.frombuffer(seen, np.intp)
            self._inverse = seen, np.linalg.inv(self._covariance[np.ix_(index, index)])
        return self._inverse[1]

    def _patches(self, mesh: np.ndarray, pose: np.ndarray, camera: Camera, corner: np.ndarray, level: int) -> _Patches:
        """The samples as the mesh carries them, in pixels of the cut-out picture."""
        look, actor = self._look, self.actor
        lens = camera.fx, camera.fy, camera.cx - corner[0], camera.cy - corner[1]
        pixels, weights = carry_to_pixels(mesh, pose, lens, look.triangles, look.weights, self._nearness, self._area)
        homes = surface_points(mesh, actor.feature_triangles, actor.feature_weights)
        return _Patches(camera.project(transform_points(pose, homes)), pixels, weights, look.colours[level], self._starts)

    def _shift(
        self,
        patches: _Patches,
        picture: np.ndarray,
        found: Features2D,
        features: Features2D,
        precision: np.ndarray,
        seen: np.ndarray,
        stride: int,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Pixels (40, 2) of the features after the rounds, and the variance (n,) px^2 that is left of each one seen."""
        along_u, along_v = (cv2.Scharr(picture, cv2.CV_32F, *axis, scale=1 / 32) for axis in ((1, 0), (0, 1)))
        images = (picture, along_u, along_v)
        homes, p = patches.homes[seen], self.parameters
        start, detected = features.pixels[seen] - homes, found.pixels[seen] - homes
        shift, variance = align_patches(
            images, *patches.arrays, seen, start, detected, precision, p.rounds, float(p.noise) ** 2, stride
        )
        pixels = features.pixels.copy()
        pixels[seen] = homes + shift
        return pixels, variance


class _Patches:
    """The samples of all features in one frame: ``arrays`` for the kernel, ``homes`` (40, 2) px of the features."""

    def __init__(
        self, homes: np.ndarray, pixels: np.ndarray, weights: np.ndarray, colours: np.ndarray, starts: np.ndarray
    ) -> None:
        self.homes, self.arrays = homes, (pixels, weights, colours, starts)


def _areas(vertices: np.ndarray, triangles: np.ndarray, feature: np.ndarray) -> np.ndarray:
    """(Q,) mm^2 of skin that each sample stands for: its triangle's, shared by the samples of its feature there."""
    _, which, count = np.unique(np.column_stack([triangles, feature]), axis=0, return_inverse=True, return_counts=True)
    a, b, c = np.moveaxis(vertices[triangles], 1, 0)
    areas: np.ndarray = 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1) / count[which.ravel()]
    return areas


def _error_covariance(actor: Actor, parameters: RefinementParameters) -> np.ndarray:
    """(40, 40) mm^2: errors of the detector are alike at neighbouring features of a region (measured: 0.9 at the next).

    Lips that touch in the neutral err each in its own way: distances are taken with the jaw open, where the rig has that.
    """
    shape = actor.neutral
    if "jawOpen" in actor.expression_names:
        shape = shape + actor.blendshapes[actor.expression_names.index("jawOpen")]
    places = surface_points(shape, actor.feature_triangles, actor.feature_weights)
    distance = np.linalg.norm(places[:, None] - places[None], axis=2)
    alike = np.exp(-0.5 * (distance / parameters.correlation_length) ** 2) * (FEATURE_REGIONS[:, None] == FEATURE_REGIONS)
    covariance: np.ndarray = parameters.deviation**2 * ((1.0 - OWN_SHARE) * alike + OWN_SHARE * np.eye(len(places)))
    return covariance
