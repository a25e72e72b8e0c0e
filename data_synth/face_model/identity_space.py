"""Mean head and identity modes: rigid alignment of the sampled heads, then a weighted PCA of them and their mirrors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from adaptiveface.geometry.mesh import rigid_alignment, transform_points, vertex_areas

from .tracking_mesh import TrackingMesh

ALIGNMENT_ROUNDS = 4
BACK_WEIGHT, NECK_WEIGHT, EYE_WEIGHT = 0.10, 0.25, 0.05  # relative to the frontal region


@dataclass(frozen=True)
class IdentitySpace:
    """mean (P, 3) mm; modes (M, P, 3) mm per standard deviation; variance (S,): each mode's share, sorted."""

    mean: np.ndarray
    modes: np.ndarray
    variance: np.ndarray


def align_heads(heads: np.ndarray, weights: np.ndarray, rounds: int = ALIGNMENT_ROUNDS) -> np.ndarray:
    """Rigidly align heads (S, P, 3) to their common mean with point weights (P,) (generalised Procrustes, no scale)."""
    heads = heads.astype(float)
    for _ in range(rounds):
        mean = heads.mean(axis=0)
        heads = np.stack([transform_points(rigid_alignment(head, mean, weights), head) for head in heads])
    return heads


def mirrored(field: np.ndarray, mirror: np.ndarray) -> np.ndarray:
    """The field (..., P, 3) of the head seen in a mirror."""
    return field[..., mirror, :] * [-1.0, 1.0, 1.0]


def vertex_weights(rest: np.ndarray, mesh: TrackingMesh, n_eyes: int) -> np.ndarray:
    """(P,) areas relative to the frontal mean, lowered at the back, the neck and the eyeballs."""
    areas = vertex_areas(rest, mesh.triangles)
    weights = areas / areas[: mesh.n_frontal].mean()
    weights[mesh.n_frontal :] *= BACK_WEIGHT
    weights[rest[:, 1] < rest[: mesh.n_frontal, 1].min() - 3] *= NECK_WEIGHT
    return np.concatenate([weights, np.full(n_eyes, EYE_WEIGHT)])


def identity_space(heads: np.ndarray, weights: np.ndarray, mirror: np.ndarray, n_modes: int) -> IdentitySpace:
    """PCA of aligned heads (S, P, 3) and their mirrors; every mode is exactly symmetric or antisymmetric."""
    heads = np.concatenate([heads, mirrored(heads, mirror)])
    mean = heads.mean(axis=0)
    mean = 0.5 * (mean + mirrored(mean, mirror))
    offsets = heads - mean
    weighted = (offsets * np.sqrt(weights)[:, None]).reshape(len(heads), -1)
    eigenvalues, vectors = np.linalg.eigh(weighted @ weighted.T / len(heads))
    variance = np.maximum(eigenvalues[::-1], 0)
    coefficients = vectors[:, ::-1][:, :n_modes] * np.sqrt(len(heads))  # unit variance
    modes = np.einsum("sm,spc->mpc", coefficients, offsets, optimize=True) / len(heads)
    parity = np.sign((modes * mirrored(modes, mirror)).sum(axis=(1, 2)))[:, None, None]
    modes = 0.5 * (modes + parity * mirrored(modes, mirror))
    flat = modes.reshape(n_modes, -1)
    modes *= np.sign(flat[np.arange(n_modes), np.abs(flat).argmax(axis=1)])[:, None, None]
    return IdentitySpace(mean, modes, variance / variance.sum())
