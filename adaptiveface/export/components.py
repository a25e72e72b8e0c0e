"""Compute morph targets for a residual motion: principal components of meshes over time, in bounded memory.

Decomposing all F frames takes F^2 numbers and F^3 steps. This is done for up to :data:`SAMPLE` frames, because it gives the
fewest components. For a longer take, the components are those of :data:`SAMPLE` frames, spread evenly. Every frame is then
checked once, and components are added for frames whose error exceeds the tolerance.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

#: How many frames are decomposed at once.
SAMPLE = 512
#: Frames that are looked at together in a long take.
BLOCK = 128
#: Components that are taken away together while the fewest are sought.
_STEP = 16

#: A function that returns the meshes (f, V, 3), mm, of given frame numbers (f,).
Meshes = Callable[[np.ndarray], np.ndarray]


def frame_blocks(count: int, size: int = BLOCK) -> Iterator[np.ndarray]:
    """Numbers of all frames, ``size`` at a time."""
    for start in range(0, count, size):
        yield np.arange(start, min(start + size, count))


def principal_targets(meshes: Meshes, count: int, tolerance: float) -> tuple[np.ndarray, np.ndarray]:
    """Decompose displacements into few morph targets.

    Parameters
    ----------
    meshes : callable
        Returns the displacements of given frames.
    count : int
        Number of frames.
    tolerance : float
        Largest distance of a vertex from its place, mm.

    Returns
    -------
    targets : (K, V, 3)
        In mm.
    weights : (count, K)
        Of the targets in every frame. None exceeds 1 in magnitude.
    """
    chosen = np.unique(np.linspace(0, count - 1, min(count, SAMPLE)).round().astype(int))
    sample = meshes(chosen)
    shape = sample.shape[1:]
    flat = sample.reshape(len(chosen), -1)
    basis = _fewest(flat, tolerance)
    weights = [flat @ basis.T]
    if count > len(chosen):
        del sample, flat
        basis, weights = _extended(basis, meshes, count, tolerance)
    amounts = np.zeros((count, len(basis)))
    done = 0
    for block in weights:  # earlier frames did not need the components that were added later
        amounts[done : done + len(block), : block.shape[1]] = block
        done += len(block)
    scale = np.maximum(np.abs(amounts).max(axis=0, initial=1e-12), 1e-12)
    return (basis.astype(float) * scale[:, None]).reshape(len(basis), *shape), amounts / scale


def _extended(basis: np.ndarray, meshes: Meshes, count: int, tolerance: float) -> tuple[np.ndarray, list[np.ndarray]]:
    """The basis (K, 3V), extended by what single frames still need, and the weights, one block per state of the basis.

    Single precision is exact to 1e-5 mm here, and takes half the time.
    """
    weights, basis = [], basis.astype(np.float32)
    for frames in frame_blocks(count):
        flat = meshes(frames).reshape(len(frames), -1).astype(np.float32)
        block = flat @ basis.T
        rest = flat - block @ basis
        missing = _farthest(rest) > tolerance + 1e-4
        if missing.any():
            more = _fewest(rest[missing].astype(float), tolerance).astype(np.float32)
            added = np.zeros((len(frames), len(more)), np.float32)
            added[missing] = rest[missing] @ more.T
            basis, block = np.concatenate([basis, more]), np.hstack([block, added])
        weights.append(block)
    return basis, weights


def _fewest(flat: np.ndarray, tolerance: float) -> np.ndarray:
    """(K, 3V) orthonormal principal components of rows (F, 3V), as few as leave every vertex within the tolerance."""
    values, vectors = np.linalg.eigh(flat @ flat.T)
    kept = values > 1e-12 * max(values[-1], 1e-30)
    vectors = vectors[:, kept][:, ::-1]
    rest, known = np.array(flat), 0
    while known < vectors.shape[1] and _farthest(rest).max(initial=0.0) > tolerance:
        step = vectors[:, known : known + _STEP]
        before, rest = rest, rest - step @ (step.T @ rest)
        known += step.shape[1]
        if _farthest(rest).max(initial=0.0) <= tolerance:  # possibly a few too many: the error falls, except for small ripples
            low, high = known - step.shape[1] + 1, known
            while low < high:
                middle = (low + high) // 2
                part = step[:, : middle - known + step.shape[1]]
                enough = _farthest(before - part @ (part.T @ before)).max() <= tolerance
                low, high = (low, middle) if enough else (middle + 1, high)
            known = high
            break
    chosen = vectors[:, :known]
    basis = chosen.T @ flat
    return basis / np.linalg.norm(basis, axis=1, keepdims=True)


def _farthest(flat: np.ndarray) -> np.ndarray:
    """(F,) mm: the longest of the vectors in rows (F, 3V)."""
    vectors = flat.reshape(len(flat), -1, 3)
    return np.sqrt(np.einsum("fvk,fvk->fv", vectors, vectors).max(axis=1, initial=0.0))
