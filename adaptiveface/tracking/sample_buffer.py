"""Which sample leaves the full buffer of section 5 when a new one comes."""

from __future__ import annotations

import numpy as np

from ..caches.compiled import compiled


@compiled
def redundant_sample(gram: np.ndarray, ages: np.ndarray, products: np.ndarray, square: float) -> int:
    """The sample that the others can best do without: the older one of the closest pair, the new sample s among them.

    Distances come from what is there anyway, |a - b|^2 = a^T a - 2 a^T b + b^T b. The new sample is never the older one,
    so that it always enters; of pairs as close as each other the oldest counts.

    Parameters
    ----------
    gram : (S, S)
        S^T S of the samples in the buffer, mm^2.
    ages : (S,) int
        When each of them came, counted in samples.
    products, square : (S,), float
        S^T s and s^T s, mm^2.

    Returns
    -------
    int
        Its row.
    """
    nearest, row = np.inf, 0
    for i in range(len(gram)):
        distance = gram[i, i] - 2.0 * products[i] + square
        for j in range(len(gram)):
            if ages[j] > ages[i]:
                distance = min(distance, gram[i, i] - 2.0 * gram[i, j] + gram[j, j])
        if distance < nearest or (distance == nearest and ages[i] < ages[row]):
            nearest, row = distance, i
    return row
