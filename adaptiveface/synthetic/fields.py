"""Smooth random fields over space, and soft steps over time and activation."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike


def smooth_field(rng: np.random.Generator, points: np.ndarray, wavelength: float, channels: int = 1) -> np.ndarray:
    """(N, channels) band-limited random field at points (N, 3) mm: zero mean and unit variance over the draws.

    A sum of random cosines (random Fourier features, Rahimi & Recht 2007) with wavelengths of 0.75 to 1.5 times
    ``wavelength`` mm, so points that are close in space, such as upper and lower lip, move alike.
    """
    n_waves = 24
    direction = rng.normal(size=(channels, n_waves, 3))
    direction /= np.linalg.norm(direction, axis=2, keepdims=True)
    number = 2 * np.pi / (wavelength * rng.uniform(0.75, 1.5, (channels, n_waves, 1)))
    phase = rng.uniform(0, 2 * np.pi, (channels, n_waves))
    angle = np.einsum("nd,ckd->nck", points, direction * number) + phase
    return np.sqrt(2 / n_waves) * np.cos(angle).sum(axis=2)


def soft_step(x: ArrayLike) -> np.ndarray:
    """Rise from 0 at 0 to 1 at 1 along the minimum-jerk polynomial (Flash & Hogan 1985). It is constant elsewhere."""
    x = np.clip(x, 0, 1)
    return x**3 * (10 - 15 * x + 6 * x**2)
