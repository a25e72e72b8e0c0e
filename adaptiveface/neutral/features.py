"""The 2D features of the neutral frames as constraints on the head, and their calibration for one person.

A feature seen at a pixel of frame k lies on a viewing ray. The mean over the frames of its squared distances to these
rays is a quadratic form of its 3D position x, x.A x - 2 b.x + c, so that all frames together cost one (3, 3) matrix:
the point-to-point 2D feature constraints of section 3.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .fuse import FusedScan


@dataclass(frozen=True)
class FeatureConstraints:
    """Mean squared distance of each feature to its viewing rays: energy x.A x - 2 b.x + c, in the scan frame, mm^2.

    A (40, 3, 3), b (40, 3), c (40,); weights (40,): accumulated confidence over the frames, 0 = never seen.
    """

    A: np.ndarray
    b: np.ndarray
    c: np.ndarray
    weights: np.ndarray

    @property
    def seen(self) -> np.ndarray:
        """(40,) bool: the features with a constraint."""
        return self.weights > 0

    def rms(self, points: np.ndarray) -> np.ndarray:
        """(40,) root mean square distance of points (40, 3) in the scan frame to their rays, mm."""
        square = np.einsum("fi,fij,fj->f", points, self.A, points) - 2 * (self.b * points).sum(1) + self.c
        return np.sqrt(np.maximum(square, 0.0))


def feature_constraints(scan: FusedScan, points: np.ndarray, normals: np.ndarray) -> FeatureConstraints:
    """Gather the rays of the scan's frames, given the features' present position and normal (40, 3) in the scan frame.

    A view weighs by the cosine at which it sees the feature's skin: detectors guess what is turned away. Rays farther
    than three robust standard deviations from their median are dropped.
    """
    rows = [_rays(scan, k, points, normals) for k in range(len(scan.frames)) if scan.features[k] is not None]
    if not rows:
        zero = np.zeros(len(points))
        return FeatureConstraints(np.zeros((len(points), 3, 3)), np.zeros_like(points), zero, zero)
    centre, direction, weight = (np.stack(part) for part in zip(*rows, strict=True))
    across = np.eye(3) - direction[..., :, None] * direction[..., None, :]
    weight = _without_outliers(points, centre, across, weight)
    total = weight.sum(axis=0)
    weight = weight / np.where(total > 0, total, 1.0)
    A = np.einsum("kf,kfij->fij", weight, across)
    b = np.einsum("kf,kfij,kfj->fi", weight, across, centre)
    c = np.einsum("kf,kfi,kfij,kfj->f", weight, centre, across, centre)
    return FeatureConstraints(A, b, c, total)


def _rays(scan: FusedScan, k: int, points: np.ndarray, normals: np.ndarray):
    """Of frame k: ray origins (40, 3), unit directions (40, 3) in the scan frame, weights (40,)."""
    rotation, translation = scan.poses[k][:3, :3], scan.poses[k][:3, 3]
    features = scan.features[k]
    pixels = np.where(features.valid[:, None], features.pixels, 0.0)
    direction = scan.cameras[k].back_project(pixels, np.ones(len(pixels))) @ rotation
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    centre = np.broadcast_to(-translation @ rotation, points.shape)
    cosine = -(direction * normals).sum(axis=1)
    weight = np.where(features.valid, features.confidence, 0.0) * np.clip(cosine - 0.2, 0.0, None)
    return centre, direction, weight


def _without_outliers(points, centre, across, weight) -> np.ndarray:
    """Weights (K, 40) with the rays zeroed that lie far from where most frames see the feature."""
    offset = np.einsum("kfij,kfj->kfi", across, points - centre)
    offset = np.where(weight[..., None] > 0, offset, np.nan)
    with np.errstate(all="ignore"):
        seen = (weight > 0).any(axis=0)
        middle = np.zeros_like(points)
        middle[seen] = np.nanmedian(offset[:, seen], axis=0)
        distance = np.linalg.norm(offset - middle, axis=2)
        spread = np.full(len(points), np.inf)
        spread[seen] = np.maximum(3 * 1.4826 * np.nanmedian(distance[:, seen], axis=0), 1.0)
    return np.where(distance <= spread, weight, 0.0)
