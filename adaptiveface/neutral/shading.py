"""Tell the shading of a face's form from the texture of its skin.

Skin without any texture still has brightness that changes over it: beside the nose and under the lips the surface turns away
from the lamp. All pictures of a scan show these slopes alike, and yet they do not move with the skin. They are predicted here:
the light is fitted to a picture, the neutral is drawn in it without texture, and the slopes of that drawing are taken.
"""

from __future__ import annotations

import cv2
import numpy as np

from ..geometry.frame import RgbdFrame
from ..geometry.mesh import transform_points, vertex_normals
from ..geometry.rendering import ray_cast
from ..model.actor import Actor
from ..model.appearance import SURROUNDINGS, mixtures
from .appearance import MIN_COSINE

#: Deviation of the logarithm of the brightness from the light's, beyond which a sample is texture and counts little.
_TEXTURE = 0.1
_ROUNDS = 5
#: Weight of the squares of the predicted slopes against those of the rest, which are texture: the light is only approximate.
_SHADING = 1.0


def harmonics(normals: np.ndarray) -> np.ndarray:
    """(Q, 9) spherical harmonics of orders zero to two, unnormalised, of unit normals (Q, 3) (Ramamoorthi & Hanrahan 2001)."""
    x, y, z = normals.T
    return np.column_stack([np.ones(len(normals)), x, y, z, x * y, y * z, z * x, x * x - y * y, 3.0 * z * z - 1.0])


def fit_light(brightness: np.ndarray, normals: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Fit the light to samples of a picture.

    Parameters
    ----------
    brightness : (Q,)
        Logarithm of the samples' brightness.
    normals : (Q, 3)
        Unit normals, camera frame.
    weights : (Q,)
        How much each sample counts.

    Returns
    -------
    (9,)
        Coefficients of :func:`harmonics` that give the logarithm of the brightness, with robust weights.
    """
    basis, counts = harmonics(normals), weights
    light = np.zeros(9)
    for _ in range(_ROUNDS):
        weighted = basis * counts[:, None]
        light = np.linalg.solve(weighted.T @ basis + 1e-3 * np.eye(9), weighted.T @ brightness)
        counts = weights / (1.0 + ((brightness - basis @ light) / _TEXTURE) ** 2)
    return light


def shaded_face(actor: Actor, frame: RgbdFrame, pose: np.ndarray, places: np.ndarray) -> np.ndarray | None:
    """Draw how the light of a picture shades the neutral, as the brightness of :func:`.skin_channels`.

    Parameters
    ----------
    actor : Actor
        With the head as the frame shows it.
    frame : RgbdFrame
        With colour.
    pose : (4, 4)
        Head to camera, mm.
    places : (Q,)
        Numbers of the vertices by which the light is fitted.

    Returns
    -------
    (H, W) float32 or None
        Percent of the brightness around, 0 beside the face. None if the face does not lie in the picture.
    """
    camera, vertices = frame.camera, transform_points(pose, actor.neutral)
    normals = vertex_normals(actor.neutral, actor.triangles) @ pose[:3, :3].T
    pixels = camera.project(vertices)
    border = int(4 * SURROUNDINGS)
    low = np.clip(pixels.min(axis=0).astype(int) - border, 0, [camera.width, camera.height])
    high = np.clip(pixels.max(axis=0).astype(int) + border, 0, [camera.width, camera.height])
    facing = -(normals[places] * vertices[places]).sum(axis=1) / np.linalg.norm(vertices[places], axis=1)
    weights = np.clip(facing - MIN_COSINE, 0.0, None) ** 4
    if (high - low).min() < 2 or not weights.any():
        return None
    assert frame.colour is not None  # the caller ensures it
    grey = cv2.GaussianBlur(mixtures(frame.colour)[0], (0, 0), 2.0)
    found = cv2.remap(grey, pixels[places].astype(np.float32)[:, None], None, cv2.INTER_LINEAR)[:, 0]
    light = fit_light(np.log(np.maximum(found, 1.0)).astype(float), normals[places], weights)
    hits = ray_cast(camera, vertices, actor.triangles, (*low, *high))
    seen = hits.triangle >= 0
    corners = actor.triangles[hits.triangle[seen]]
    inside = seen.astype(np.float32)
    picture = np.zeros(seen.shape, np.float32)
    picture[seen] = ((harmonics(normals) @ light)[corners] * hits.barycentric[seen]).sum(axis=1)
    around = cv2.GaussianBlur(picture, (0, 0), SURROUNDINGS) / np.maximum(cv2.GaussianBlur(inside, (0, 0), SURROUNDINGS), 1e-3)
    whole = np.zeros((camera.height, camera.width), np.float32)
    whole[low[1] : high[1], low[0] : high[0]] = 100.0 * (picture - around) * inside
    return whole


def texture_share(gradients: np.ndarray, shading: np.ndarray) -> np.ndarray:
    """(Q,) share of the brightness' gradients (Q, 2) that is texture, where the form alone would give ``shading`` (Q, 2)."""
    texture = ((gradients - shading) ** 2).sum(axis=1)
    share: np.ndarray = texture / np.maximum(texture + _SHADING * (shading**2).sum(axis=1), 1e-12)
    return share
