"""Compare what the adaptive model has learned with a batch PCA of its samples (section 5)."""

from __future__ import annotations

import numpy as np

from ..tracking.adaptive_pca import AdaptiveModel


def singular_values(model: AdaptiveModel) -> np.ndarray:
    """Singular values (k,) of the buffer's samples within the k correctives, as the rms displacement of a vertex, mm."""
    samples = model.buffer()
    if len(samples) == 0 or model.correctives.shape[1] == 0:
        return np.zeros(0)
    values = np.linalg.svd(samples @ model.correctives, compute_uv=False)
    return values / np.sqrt(samples.size / 3)


def angle_to_batch(model: AdaptiveModel, samples: np.ndarray | None = None) -> float:
    """Compare the k correctives with the k leading directions of a batch PCA.

    The batch PCA is a singular value decomposition of all samples at once, through the origin as in section 5. It is computed
    from the products of the samples (s, s), and the angles from their products with the correctives. Both matrices are small.

    Parameters
    ----------
    model : AdaptiveModel
        Has the correctives.
    samples : (s, 3n), optional
        Displacements of the frontal vertices, mm; those of the model's buffer by default.

    Returns
    -------
    float
        Mean principal angle, degrees. NaN if there are fewer directions than correctives.
    """
    samples = model.buffer() if samples is None else samples
    k = model.correctives.shape[1]
    if k == 0 or len(samples) <= k:
        return float("nan")
    variances, mixes = np.linalg.eigh((samples @ samples.T).astype(float))
    variances, mixes = variances[-k:], mixes[:, -k:]
    if variances[0] <= 1e-12 * variances[-1]:  # there are fewer directions than correctives
        return float("nan")
    products = (samples @ model.correctives.astype(samples.dtype)).astype(float)
    cosines = np.linalg.svd(products.T @ (mixes / np.sqrt(variances)), compute_uv=False)
    return float(np.degrees(np.arccos(np.clip(cosines, 0.0, 1.0)).mean()))
