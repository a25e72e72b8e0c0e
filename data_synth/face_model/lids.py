"""A blink that closes: the upper lid's margin comes down exactly onto the lower one, sliding over the eyeball."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .fields import FieldSmoother

LOWER_LID_SHARE = 0.12  # how much of the opening the lower lid closes; the upper lid does the rest
LID_THICKNESS_MM = 1.2  # lid skin stays this far outside the eyeball
REACH_MM = 15.0  # the lid's skin moves up to here from the margins


@dataclass(frozen=True)
class EyeOpening:
    """One eye: margin vertices from the inner to the outer canthus (both ends shared), and its eyeball."""

    upper: np.ndarray
    lower: np.ndarray
    centre: np.ndarray
    radius: float


def blink(points, unit, eye: EyeOpening, distance: np.ndarray, smoother: FieldSmoother) -> np.ndarray:
    """(V, 3) displacement that closes one eye.

    ``unit`` (V, 3), the authored blink, shapes the lid between margin and brow; a smooth correction brings the margins
    together; skin that would enter the eyeball is pushed out. ``distance`` (V,) mm from the margins along the surface.
    """
    field = _meet(points, unit, eye, distance < REACH_MM, smoother)
    for _ in range(3):
        field = _outside_eyeball(points, field, eye, distance, smoother)
    return field


def _meet(points, unit, eye: EyeOpening, region, smoother) -> np.ndarray:
    closed = closing_line(points, eye)
    rims = np.concatenate([eye.upper, eye.lower[1:-1]])
    along = np.concatenate([arc_fraction(points[eye.upper]), arc_fraction(points[eye.lower])[1:-1]])
    target = np.stack([np.interp(along, closed[0], closed[1][:, k]) for k in range(3)], axis=1)
    return unit + smoother.extend(target - points[rims] - unit[rims], rims, region)


def closing_line(points: np.ndarray, eye: EyeOpening) -> tuple[np.ndarray, np.ndarray]:
    """Where the margins meet: fractions (n,) from canthus to canthus and points (n, 3) on the eyeball's cover."""
    fraction = np.linspace(0, 1, 33)
    curves = []
    for margin in (eye.upper, eye.lower):
        at = arc_fraction(points[margin])
        curves.append(np.stack([np.interp(fraction, at, points[margin][:, k]) for k in range(3)], axis=1))
    line = LOWER_LID_SHARE * curves[0] + (1 - LOWER_LID_SHARE) * curves[1]
    ray = line - eye.centre
    radii = [np.linalg.norm(c - eye.centre, axis=1) for c in curves]
    radius = LOWER_LID_SHARE * radii[0] + (1 - LOWER_LID_SHARE) * radii[1]
    return fraction, eye.centre + ray * (radius / np.linalg.norm(ray, axis=1))[:, None]


def arc_fraction(curve: np.ndarray) -> np.ndarray:
    """(n,) arc length from the first point, over the whole length."""
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(curve, axis=0), axis=1))])
    return length / length[-1]


def _outside_eyeball(points, field, eye: EyeOpening, distance, smoother) -> np.ndarray:
    """Push skin of the closed lid out to the eyeball's radius plus the lid's thickness (less at the margins)."""
    ray = points + field - eye.centre
    radius = np.linalg.norm(ray, axis=1)
    cover = eye.radius + LID_THICKNESS_MM * np.clip(distance / 3.0, 0, 1)
    rims = np.union1d(eye.upper, eye.lower)
    moving = (distance < REACH_MM) & (np.linalg.norm(field, axis=1) > 0.5) & (ray[:, 2] > 0)
    inside = moving & (radius < cover)
    inside[rims] = False
    push = ray * (cover / np.maximum(radius, 1e-9) - 1)[:, None]
    at = np.union1d(np.flatnonzero(inside), rims)
    return field + smoother.extend(np.where(inside[at, None], push[at], 0.0), at, distance < REACH_MM)
