"""How the whole face looks, gathered from the colour pictures of the neutral scan."""

from __future__ import annotations

from collections.abc import Iterable

import cv2
import numpy as np

from ..geometry.frame import FEATURE_REGIONS, RgbdFrame
from ..geometry.mesh import surface_points, transform_points, triangle_normals, vertex_normals
from ..model.actor import Actor
from ..model.appearance import channels
from ..model.skin import MOST, Skin
from ..parameters import SkinParameters
from .appearance import MIN_COSINE, SEEN, inner_grid

#: mm around the features of the eyes in which no sample lies: lids slide over eyeballs, whose colour is not the neutral's.
LIDS = 9.0
#: px: gradients are taken at this blur, where they hold little noise.
_BLUR = 1.5
#: OpenCV looks up so many pixels at once, and a few more.
_ROWS = 30000
#: mm: size of the cells that give one sample after the other, so that the first ones cover the face.
_CELL = 6.0


def gather_skin(actor: Actor, views: Iterable[tuple[RgbdFrame, np.ndarray]], parameters: SkinParameters) -> Skin | None:
    """The neutral's :class:`Skin` from frames with colour and their head-to-camera poses (4, 4).

    Every picture counts by the fourth power of how far the skin is turned to it. None when no frame has colour.
    """
    triangles, weights = _samples(actor, parameters.spacing)
    points = surface_points(actor.neutral, triangles, weights)
    normals = surface_points(vertex_normals(actor.neutral, actor.triangles), triangles, weights)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-9)
    (total, detail), (sums, squares) = np.zeros((2, len(points))), np.zeros((2, len(points), 3))
    for frame, pose in views:
        if frame.colour is None:
            continue
        seen = transform_points(pose, points)
        cosine = -((normals @ pose[:3, :3].T) * seen).sum(axis=1) / np.linalg.norm(seen, axis=1)
        weight = np.clip(cosine - MIN_COSINE, 0.0, None) ** 4
        at = frame.camera.project(seen)
        colours = _at(channels(frame.colour, 0.0), at)
        steepness = _at(_squared_gradient(channels(frame.colour, _BLUR)), at)
        total += weight
        sums += weight[:, None] * colours
        squares += weight[:, None] * colours**2
        detail += weight * steepness * (frame.camera.fx / seen[:, 2]) ** 2
    kept = np.flatnonzero(total > (SEEN - MIN_COSINE) ** 4)
    if not len(kept):
        return None
    means, detail = sums[kept] / total[kept, None], detail[kept] / total[kept]
    deviations = np.sqrt(np.maximum(squares[kept] / total[kept, None] - means**2, 0.0))
    order = _most_telling(points[kept], detail / (parameters.noise**2 + (deviations**2).mean(axis=1)))[:MOST]
    chosen = kept[order]
    return Skin(triangles[chosen], weights[chosen], means[order], deviations[order], detail[order])


def _at(picture: np.ndarray, pixels: np.ndarray) -> np.ndarray:
    """(Q, ...) values of a picture (H, W, ...) at pixels (Q, 2), bilinear."""
    parts = np.array_split(pixels.astype(np.float32)[:, None], len(pixels) // _ROWS + 1)
    return np.concatenate([cv2.remap(picture, part, None, cv2.INTER_LINEAR)[:, 0] for part in parts]).astype(float)


def _squared_gradient(picture: np.ndarray) -> np.ndarray:
    """(H, W) squared gradient per px^2, summed over the channels of a picture (H, W, 3)."""
    along = (cv2.Scharr(picture, cv2.CV_32F, *axis) / 32.0 for axis in ((1, 0), (0, 1)))
    total: np.ndarray = sum((gradient**2).sum(axis=2) for gradient in along)
    return total


def _most_telling(points: np.ndarray, worth: np.ndarray) -> np.ndarray:
    """Order (Q,) of samples at points (Q, 3), mm: the best of every cell by their worth (Q,), then the second ones, and so on.

    By worth alone they would lie on brows, lips and the hairline, where features are, and leave cheeks and chin out.
    """
    _, cell = np.unique(np.floor(points / _CELL).astype(int), axis=0, return_inverse=True)
    best_first = np.lexsort((-worth, cell.ravel()))
    ordered = cell.ravel()[best_first]
    starts = np.concatenate([[0], np.flatnonzero(np.diff(ordered)) + 1])
    rank = np.empty(len(worth))
    rank[best_first] = np.arange(len(worth)) - np.repeat(starts, np.diff(np.append(starts, len(worth))))
    return np.lexsort((-worth, rank))


def _samples(actor: Actor, spacing: float) -> tuple[np.ndarray, np.ndarray]:
    """Triangles (Q, 3) and weights (Q, 3) of samples about ``spacing`` mm apart, where depth is valid, without the lids."""
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
