"""Compare what the adaptive model has learned with a batch PCA of its samples (section 5)."""

from __future__ import annotations

import numpy as np

from ..tracking.adaptive_pca import AdaptiveModel


def singular_values(model: AdaptiveModel) -> np.ndarray:
    """(k,) singular values of the buffer's samples within the k correctives, as the rms displacement of a vertex in mm."""
    samples = model.buffer()
    if len(samples) == 0 or model.correctives.shape[1] == 0:
        return np.zeros(0)
    values = np.linalg.svd(samples @ model.correctives, compute_uv=False)
    return values / np.sqrt(samples.size / 3)


def angle_to_batch(model: AdaptiveModel, samples: np.ndarray | None = None) -> float:
    """Mean principal angle, degrees, between the k correctives and the k leading directions of a batch PCA.

    Batch: a singular value decomposition of all ``samples`` (s, 3n) at once, by default those of the model's buffer, through
    the origin as in section 5. It is taken from their products (s, s), and the cosines of the angles from products with the
    correctives: both are small matrices.
    """
    samples = model.buffer() if samples is None else samples
    k = model.correctives.shape[1]
    if k == 0 or len(samples) <= k:
        return float("nan")
    variances, mixes = np.linalg.eigh((samples @ samples.T).astype(float))
    variances, mixes = variances[-k:], mixes[:, -k:]
    if variances[0] <= 1e-12 * variances[-1]:  # fewer directions than correctives
        return float("nan")
    products = (samples @ model.correctives.astype(samples.dtype)).astype(float)
    cosines = np.linalg.svd(products.T @ (mixes / np.sqrt(variances)), compute_uv=False)
    return float(np.degrees(np.arccos(np.clip(cosines, 0.0, 1.0)).mean()))
