"""Gather how the whole face looks from the colour pictures of the neutral scan."""

from __future__ import annotations

from collections.abc import Iterable

import cv2
import numpy as np

from ..geometry.camera import Camera
from ..geometry.frame import FEATURE_REGIONS, RgbdFrame
from ..geometry.mesh import surface_points, transform_points, triangle_normals, vertex_normals
from ..model.actor import Actor
from ..model.skin import MOST, Skin, skin_channels
from ..parameters import SkinParameters
from .appearance import MIN_COSINE, SEEN, inner_grid
from .shading import shaded_face, texture_share

#: Distance from the features of the eyes within which there is no sample, mm, because lids slide over eyeballs.
LIDS = 9.0
#: Half the distance over which differences of the picture give slopes, px.
_STEP = 0.6
#: Every so many pictures the shading is predicted, which takes some 20 ms.
_SHADED = 5
#: Largest number of pixels that OpenCV looks up at once, approximately.
_ROWS = 30000
#: Size of the cells that provide samples in turn, so that the first samples cover the face, mm.
_CELL = 6.0


def gather_skin(actor: Actor, views: Iterable[tuple[RgbdFrame, np.ndarray]], parameters: SkinParameters) -> Skin | None:
    """Gather the neutral's skin.

    The weight of a picture is a fourth power that grows as the skin turns to the camera.

    Parameters
    ----------
    actor : Actor
        With the head as the frames show it.
    views : iterable of (RgbdFrame, (4, 4))
        Frames with their head-to-camera poses, mm.
    parameters : SkinParameters
        Spacing of the samples, and the noise of the pictures.

    Returns
    -------
    Skin or None
        None if no frame has colour.
    """
    triangles, weights = _samples(actor, parameters.spacing)
    points = surface_points(actor.neutral, triangles, weights)
    normals = surface_points(vertex_normals(actor.neutral, actor.triangles), triangles, weights)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-9)
    tangents = _tangents(normals)
    total, heavy = np.zeros((2, len(points)))
    sums, squares = np.zeros((2, len(points), 3, 3))  # of each channel: its value, and its slopes along the tangents
    shaded, shading = np.zeros(len(points)), np.zeros((len(points), 2))
    lit = np.flatnonzero(actor.frontal & actor.depth_valid)
    for number, (frame, pose) in enumerate(views):
        if frame.colour is None:
            continue
        placed = transform_points(pose, points)
        cosine = -((normals @ pose[:3, :3].T) * placed).sum(axis=1) / np.linalg.norm(placed, axis=1)
        weight = np.clip(cosine - MIN_COSINE, 0.0, None) ** 4
        found = _look(skin_channels(frame.colour), frame.camera, pose, points, tangents)
        total += weight
        heavy += weight**2
        sums += weight[:, None, None] * found
        squares += weight[:, None, None] * found**2
        if number % _SHADED == 0 and (drawn := shaded_face(actor, frame, pose, lit)) is not None:
            shaded += weight
            shading += weight[:, None] * _look(drawn, frame.camera, pose, points, tangents)[:, 1:]
    kept = np.flatnonzero(total > (SEEN - MIN_COSINE) ** 4)
    if not len(kept):
        return None
    means = sums[kept] / total[kept, None, None]
    variances = np.maximum(squares[kept] / total[kept, None, None] - means**2, 0.0)
    gradients, deviations = means[:, :, 1:], np.sqrt(variances[:, :, 0])
    coherence = _coherence(gradients, variances[:, :, 1:], total[kept] ** 2 / heavy[kept])
    coherence[:, 0] *= texture_share(gradients[:, 0], shading[kept] / np.maximum(shaded[kept], 1e-12)[:, None])
    worth = (coherence * (gradients**2).sum(axis=2) / (parameters.noise**2 + deviations**2)).sum(axis=1)
    order = _most_telling(points[kept], worth)[:MOST]
    chosen = kept[order]
    corners = actor.neutral[triangles[chosen]]
    edges = corners[:, 1:] - corners[:, :1]
    slopes = np.einsum("qct,tqd,qed->qce", gradients[order], tangents[:, chosen], edges)
    return Skin(triangles[chosen], weights[chosen], means[order, :, 0], deviations[order], slopes, coherence[order])


def _tangents(normals: np.ndarray) -> np.ndarray:
    """Orthonormal directions (2, Q, 3) across unit ``normals`` (Q, 3)."""
    first = np.cross(normals, np.eye(3)[np.abs(normals).argmin(axis=1)])
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return np.stack([first, np.cross(normals, first)])


def _look(picture: np.ndarray, camera: Camera, pose: np.ndarray, points: np.ndarray, tangents: np.ndarray) -> np.ndarray:
    """Channels at points (Q, 3) in the head frame, and their change per mm along the tangents (2, Q, 3): (Q, 3, 3)."""
    step = _STEP * float(np.median(transform_points(pose, points)[:, 2])) / camera.fx

    def at(places: np.ndarray) -> np.ndarray:
        return _at(picture, camera.project(transform_points(pose, places)))

    slopes = [(at(points + step * along) - at(points - step * along)) / (2.0 * step) for along in tangents]
    return np.stack([at(points), *slopes], axis=-1)


def _coherence(gradients: np.ndarray, variances: np.ndarray, count: np.ndarray) -> np.ndarray:
    """Share (Q, 3) of a picture's squared gradient that belongs to the skin, because all pictures show it.

    ``gradients`` and ``variances`` (Q, 3, 2) are the mean and the variance over the pictures, of which ``count`` (Q,) are
    independent. The rest is noise and gloss, which stays below the light while the head turns. Its share in the mean is
    subtracted.
    """
    square, noise = (gradients**2).sum(axis=2), variances.sum(axis=2)
    left = square - noise / np.maximum(count[:, None] - 1.0, 1.0)
    coherence: np.ndarray = np.maximum(left, 0.0) / np.maximum(square + noise, 1e-12)
    return coherence


def _at(picture: np.ndarray, pixels: np.ndarray) -> np.ndarray:
    """Look up a picture (H, W, ...) at pixels (Q, 2) bilinearly; returns (Q, ...)."""
    parts = np.array_split(pixels.astype(np.float32)[:, None], len(pixels) // _ROWS + 1)
    return np.concatenate([cv2.remap(picture, part, None, cv2.INTER_LINEAR)[:, 0] for part in parts]).astype(float)


def _most_telling(points: np.ndarray, worth: np.ndarray) -> np.ndarray:
    """Order (Q,) of samples at points (Q, 3) mm: the best sample of every cell by its worth, then the second ones, and so on.

    Ordered by worth alone, the first samples would lie on brows, lips and the hairline, and leave out cheeks and chin.
    """
    _, cell = np.unique(np.floor(points / _CELL).astype(int), axis=0, return_inverse=True)
    best_first = np.lexsort((-worth, cell.ravel()))
    ordered = cell.ravel()[best_first]
    starts = np.concatenate([[0], np.flatnonzero(np.diff(ordered)) + 1])
    rank = np.empty(len(worth))
    rank[best_first] = np.arange(len(worth)) - np.repeat(starts, np.diff(np.append(starts, len(worth))))
    return np.lexsort((-worth, rank))


def _samples(actor: Actor, spacing: float) -> tuple[np.ndarray, np.ndarray]:
    """Triangles (Q, 3) and weights (Q, 3) of samples about ``spacing`` mm apart, on skin with valid depth except the lids."""
    usable = actor.frontal & actor.depth_valid
    homes = surface_points(actor.neutral, actor.feature_triangles, actor.feature_weights)[FEATURE_REGIONS == "eyes"]
    usable &= (np.linalg.norm(actor.neutral[:, None] - homes, axis=2) > LIDS).all(axis=1)
    corners = actor.triangles[usable[actor.triangles].all(axis=1)]
    steps = np.ceil(np.sqrt(np.linalg.norm(triangle_normals(actor.neutral, corners), axis=1)) / spacing).astype(int)
    triangles, weights = [], []
    for count in np.unique(np.clip(steps, 1, 8)):
        chosen, shares = corners[np.clip(steps, 1, 8) == count], inner_grid(int(count))
        triangles.append(np.repeat(chosen, len(shares), axis=0))
        weights.append(np.tile(shares, (len(chosen), 1)))
    return np.concatenate(triangles).astype(np.int32), np.concatenate(weights)
