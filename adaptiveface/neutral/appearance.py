"""Gather the appearance of the skin around the 2D features from the colour pictures of the neutral scan."""

from __future__ import annotations

from collections.abc import Iterable

import cv2
import numpy as np

from ..geometry.frame import RgbdFrame
from ..geometry.mesh import surface_points, transform_points, vertex_normals
from ..model.actor import Actor
from ..model.appearance import BLURS, Appearance, channels
from ..parameters import RefinementParameters
from .features import surface_patch

#: Smallest cosine between the skin's normal and the viewing ray at which a picture counts.
MIN_COSINE = 0.3
#: A sample needs at least the weight of one view with this cosine.
SEEN = 0.5


def gather_appearance(
    actor: Actor, views: Iterable[tuple[RgbdFrame, np.ndarray]], parameters: RefinementParameters
) -> Appearance | None:
    """Gather how the neutral looks around its features.

    The weight of a picture is a fourth power that grows as the skin turns to the camera. Frontal pictures therefore decide,
    and slanted ones blur nothing.

    Parameters
    ----------
    actor : Actor
        With the head as the frames show it.
    views : iterable of (RgbdFrame, (4, 4))
        Frames with their head-to-camera poses, mm.
    parameters : RefinementParameters
        Radius and spacing of the samples.

    Returns
    -------
    Appearance or None
        None if no frame has colour.
    """
    triangles, weights, feature = _samples(actor, parameters.radius, parameters.spacing)
    points = surface_points(actor.neutral, triangles, weights)
    normals = surface_points(vertex_normals(actor.neutral, actor.triangles), triangles, weights)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-9)
    colours, total = np.zeros((len(BLURS), len(points), 3)), np.zeros(len(points))
    for frame, pose in views:
        if frame.colour is None:
            continue
        seen = transform_points(pose, points)
        cosine = -((normals @ pose[:3, :3].T) * seen).sum(axis=1) / np.linalg.norm(seen, axis=1)
        weight = np.clip(cosine - MIN_COSINE, 0.0, None) ** 4
        at = frame.camera.project(seen).astype(np.float32)[:, None]
        total += weight
        for sums, blur in zip(colours, BLURS, strict=True):
            sums += weight[:, None] * cv2.remap(channels(frame.colour, blur), at, None, cv2.INTER_LINEAR)[:, 0]
    kept = total > (SEEN - MIN_COSINE) ** 4
    if not kept.any():
        return None
    return Appearance(triangles[kept], weights[kept], feature[kept], colours[:, kept] / total[kept, None])


def _samples(actor: Actor, radius: float, spacing: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Triangles (Q, 3), weights (Q, 3) and feature (Q,) of samples about ``spacing`` apart around every feature, mm.

    A sample is connected with its feature within ``radius``, so that it never lies on the other lip.
    """
    vertices, frontal = actor.neutral, actor.triangles[actor.frontal[actor.triangles].all(axis=1)]
    homes = surface_points(vertices, actor.feature_triangles, actor.feature_weights)
    triangles, weights, feature = [], [], []
    for f, home in enumerate(homes):
        for corners in surface_patch(frontal, vertices, actor.feature_triangles[f], home, radius):
            a, b, c = vertices[corners]
            size = np.sqrt(np.linalg.norm(np.cross(b - a, c - a)))
            shares = inner_grid(max(1, int(np.ceil(size / spacing))))
            shares = shares[np.linalg.norm(shares @ vertices[corners] - home, axis=1) <= radius]
            triangles.append(np.repeat(corners[None], len(shares), axis=0))
            weights.append(shares)
            feature.append(np.full(len(shares), f, np.int32))
    return np.concatenate(triangles), np.concatenate(weights), np.concatenate(feature)


def inner_grid(steps: int) -> np.ndarray:
    """Evenly spread barycentric weights (steps (steps + 1) / 2, 3) inside a triangle."""
    i, j = np.meshgrid(np.arange(steps), np.arange(steps), indexing="ij")
    inside = i + j < steps
    a, b = i[inside] + 1 / 3, j[inside] + 1 / 3
    return np.stack([a, b, steps - a - b], axis=1) / steps
