"""Patterns in space that are evaluated at the points a camera sees: smooth noise and spots, without what pixels cannot show."""

from __future__ import annotations

import numpy as np

from ..caches.compiled import compiled


@compiled
def _hashed(x, y, z, seed):
    """64 random bits of a cell of the grid (SplitMix64, Steele et al. 2014)."""
    h = np.uint64(x) * np.uint64(0x9E3779B97F4A7C15) ^ np.uint64(y) * np.uint64(0xC2B2AE3D27D4EB4F)
    h ^= np.uint64(z) * np.uint64(0x165667B19E3779F9) ^ np.uint64(seed) * np.uint64(0xD6E8FEB86659FD93)
    h = (h ^ (h >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    h = (h ^ (h >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return h ^ (h >> np.uint64(31))


@compiled
def _uniform(bits, which):
    """The ``which``-th of four numbers in [0, 1) from 64 bits."""
    return ((bits >> np.uint64(16 * which)) & np.uint64(0xFFFF)) / 65536.0


@compiled
def _gradient(x, y, z, dx, dy, dz, seed):
    bits = _hashed(x, y, z, seed)
    a, b, c = _uniform(bits, 0) - 0.5, _uniform(bits, 1) - 0.5, _uniform(bits, 2) - 0.5
    return (a * dx + b * dy + c * dz) / np.sqrt(a * a + b * b + c * c + 1e-6)


@compiled
def _fade(t):
    return t * t * t * (10.0 - 15.0 * t + 6.0 * t * t)


@compiled
def _smooth(px, py, pz, seed):
    """Gradient noise of about unit variance with a wavelength of about 1.6 (Perlin 2002, "Improving noise")."""
    x, y, z = int(np.floor(px)), int(np.floor(py)), int(np.floor(pz))
    dx, dy, dz = px - x, py - y, pz - z
    u, v, w = _fade(dx), _fade(dy), _fade(dz)
    total = 0.0
    for k in range(2):
        for j in range(2):
            for i in range(2):
                weight = (u if i else 1.0 - u) * (v if j else 1.0 - v) * (w if k else 1.0 - w)
                total += weight * _gradient(x + i, y + j, z + k, dx - i, dy - j, dz - k, seed)
    return 5.1 * total


@compiled(nogil=True)
def _octaves(points, footprint, wavelengths, amplitudes, seed, out):
    for p in range(len(points)):
        for k in range(len(wavelengths)):
            shown = min(wavelengths[k] / (2.0 * footprint[p]) - 1.0, 1.0)
            if shown > 0.0:
                s = 1.6 / wavelengths[k]
                out[p] += shown * amplitudes[k] * _smooth(s * points[p, 0], s * points[p, 1], s * points[p, 2], seed + 7919 * k)


def noise(points: np.ndarray, footprint: np.ndarray, wavelengths, amplitudes, seed: int) -> np.ndarray:
    """(P,) sum of smooth noise of several ``wavelengths`` mm and ``amplitudes`` (standard deviations) at points (P, 3) mm.

    ``footprint`` (P,) is the size of a pixel on the surface, mm. Structures finer than two pixels are left out, because a
    lens and a pixel average them.
    """
    out = np.zeros(len(points))
    _octaves(points, footprint, np.asarray(wavelengths, float), np.asarray(amplitudes, float), seed, out)
    return out


@compiled(nogil=True)
def _spots(points, footprint, density, cell, low, high, seed, out):
    for p in range(len(points)):
        blur = 0.5 * footprint[p]
        if density[p] <= 0.0 or blur > 0.5 * cell:
            continue
        x, y, z = points[p, 0] / cell, points[p, 1] / cell, points[p, 2] / cell
        i0, j0, k0 = int(np.floor(x)), int(np.floor(y)), int(np.floor(z))
        for k in range(k0 - 1, k0 + 2):
            for j in range(j0 - 1, j0 + 2):
                for i in range(i0 - 1, i0 + 2):
                    bits = _hashed(i, j, k, seed)
                    more = _hashed(i, j, k, seed + 1)
                    if _uniform(more, 0) >= density[p]:
                        continue
                    dx, dy, dz = x - i - _uniform(bits, 0), y - j - _uniform(bits, 1), z - k - _uniform(bits, 2)
                    share = _uniform(bits, 3)
                    radius = low + (high - low) * share * share
                    wide = radius * radius + blur * blur
                    far = (dx * dx + dy * dy + dz * dz) * cell * cell / wide
                    if far < 9.0:
                        out[p] += (0.5 + 0.5 * _uniform(more, 1)) * radius * radius / wide * np.exp(-far)


def spots(points: np.ndarray, footprint: np.ndarray, density: np.ndarray, cell: float, radii, seed: int) -> np.ndarray:
    """(P,) round spots of about 1, which add up: one in a share ``density`` (P,) of the cubes of ``cell`` mm, at random places.

    ``radii``: the smallest and the largest, mm; small ones are more frequent. A spot smaller than a pixel is as much paler.
    """
    out = np.zeros(len(points))
    _spots(points, footprint, np.ascontiguousarray(density, float), cell, radii[0], radii[1], seed, out)
    return out
