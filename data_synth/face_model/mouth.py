"""Lips that touch instead of crossing.

A mouth is measured in slices of constant x: ``lowest upper`` is the lower envelope of the upper lip, ``highest
lower`` the upper envelope of the lower lip, each over the whole lip from its outer contour to the mouth opening.
Where the first lies below the second the lips cross, and both are brought to one contact height, with the smoothest
correction around.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .fields import FieldSmoother

SLICE_MM = 1.0
REACH_MM = 16.0  # the correction fades to zero this far from the lips
ITERATIONS = 4


@dataclass(frozen=True)
class Lips:
    """Vertex masks (V,) of both lips, without the mouth corners where they join, and where corrections may act."""

    upper: np.ndarray
    lower: np.ndarray
    region: np.ndarray


def lip_envelopes(points: np.ndarray, lips: Lips, triangles: np.ndarray, slices: np.ndarray) -> tuple:
    """Lowest height of the upper and highest of the lower lip, each (len(slices),) mm; NaN in slices without both."""
    envelopes = []
    for lip, pick in ((lips.upper, np.fmin), (lips.lower, np.fmax)):
        inside = triangles[lip[triangles].all(axis=1)]
        samples = _barycentric_grid(8) @ points[inside]
        number = np.rint((samples[..., 0].ravel() - slices[0]) / SLICE_MM).astype(int)
        height = np.full(len(slices), np.nan)
        ok = (number >= 0) & (number < len(slices))
        pick.at(height, number[ok], samples[..., 1].ravel()[ok])
        envelopes.append(height)
    return tuple(envelopes)


def _barycentric_grid(n: int) -> np.ndarray:
    return np.array([(i, j, n - i - j) for i in range(n + 1) for j in range(n + 1 - i)]) / n


def separate_lips(points, lips, triangles, smoother: FieldSmoother, share: float = 0.5) -> np.ndarray:
    """(V, 3) correction that takes crossing lips of ``points`` (V, 3) to one contact height.

    ``share`` of the crossing is given to the upper lip, the rest to the lower.
    """
    half_width = np.ceil(np.abs(points[lips.upper | lips.lower, 0]).max())
    slices = np.arange(-half_width, half_width + SLICE_MM, SLICE_MM)
    correction = np.zeros_like(points)
    active: dict[int, float] = {}
    for _ in range(ITERATIONS):
        moved = points + correction
        upper, lower = lip_envelopes(moved, lips, triangles, slices)
        seen = np.isfinite(upper) & np.isfinite(lower)
        gap = np.interp(slices, slices[seen], (upper - lower)[seen])
        contact = np.interp(slices, slices[seen], (lower + (1 - share) * (upper - lower))[seen])
        gap, contact = _along(gap), _along(contact)
        for lip, sign in ((lips.upper, 1.0), (lips.lower, -1.0)):
            ids = np.flatnonzero(lip)
            opening = np.interp(moved[ids, 0], slices, gap)
            missing = np.interp(moved[ids, 0], slices, contact) - moved[ids, 1]
            crossing = (sign * missing > 0) & (opening < 0)
            active.update(zip(ids[crossing], (correction[ids, 1] + missing)[crossing], strict=True))
        if not active:
            break
        at = np.fromiter(active, int)
        lift = np.fromiter(active.values(), float)[:, None]
        correction = smoother.extend(lift * [0.0, 1.0, 0.0], at, lips.region)
    return correction


def _along(values: np.ndarray) -> np.ndarray:
    """Light smoothing over neighbouring slices, so that the contact line has no steps."""
    padded = np.pad(values, 1, mode="edge")
    return 0.25 * padded[:-2] + 0.5 * padded[1:-1] + 0.25 * padded[2:]
