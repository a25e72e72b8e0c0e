"""How the light of a picture shows the neutral's colours, and how far that picture is believed.

A lamp that moves, a camera that adapts its exposure or its white balance, and a head that turns under the lamp change the
channels T_qc of the neutral (:func:`~adaptiveface.model.appearance.channels`) smoothly over the face:

    expected_qc = gain_c T_qc + b_c0 + b_c . n_q

with the samples' normals n_q: spherical harmonics of order one (Ramamoorthi & Hanrahan 2001). Brightness against what is around
and shares of colour leave little shading to them. Five numbers a channel are fitted to thousands of samples, so that motion
is not taken for light.
"""

from __future__ import annotations

import numpy as np

from ..caches.compiled import compiled

#: Deviations of the gain from one and of the offsets (%) from zero.
GAIN, OFFSET = 0.3, 20.0
#: Share of the expected colours' variance that is found again in a picture: it tells nothing below the first, and is fully
#: believed from the second on.
EXPLAINED = (0.3, 0.6)
_ROUNDS = 2


@compiled(nogil=True)
def row_weights(
    residuals: np.ndarray, counts: np.ndarray, precisions: np.ndarray, shares: np.ndarray, believed: np.ndarray
) -> np.ndarray:
    """Weights (Q, 3) of the colours' rows, from residuals (Q, 3) with ``precisions`` (Q, 3) where a picture fits best.

    A sample counts by its ``counts`` (Q,) and ``shares`` (Q, 3), a channel as far as it is ``believed`` (3,). Where all fit
    worse than these inverse variances say, all of them shrink. A residual of 1.7 standard deviations counts a quarter.
    """
    weights, misfit, total = np.zeros(residuals.shape), np.zeros(3), 1e-12
    for q in range(len(residuals)):
        if counts[q] > 0.0:
            total += counts[q]
            for c in range(3):
                misfit[c] += counts[q] * residuals[q, c] ** 2 * precisions[q, c]
    for c in range(3):
        misfit[c] = 1.0 / max(misfit[c] / total, 1.0)
    for q in range(len(residuals)):
        if counts[q] > 0.0:
            for c in range(3):
                certain = misfit[c] * precisions[q, c]
                robust = 1.0 / (1.0 + residuals[q, c] ** 2 * certain * (1.0 / 3.0))
                weights[q, c] = believed[c] * shares[q, c] * counts[q] * certain * robust * robust
    return weights


@compiled(nogil=True)
def fit_light(values: np.ndarray, colours: np.ndarray, normals: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """The light (3, 5) of a picture that shows ``values`` (Q, 3) where the neutral has ``colours`` (Q, 3).

    normals (Q, 3) in the camera frame; weights (Q, 3): one over the variances, 0 for what is not seen. Per channel: the gain
    and the four offsets of the module's equation, by least squares with robust weights.
    """
    light, row = np.zeros((3, 5)), np.ones(5)
    for c in range(3):
        scale = 0.0  # of the squares in the round before
        for number in range(_ROUNDS):
            matrix, right, squares, seen = np.zeros((5, 5)), np.zeros(5), 0.0, 0
            for k in range(5):
                matrix[k, k] = GAIN**-2 if k == 0 else OFFSET**-2
            right[0] = GAIN**-2
            for q in range(len(values)):
                share = weights[q, c]
                if share == 0.0:
                    continue
                row[0] = colours[q, c]
                for k in range(3):
                    row[2 + k] = normals[q, k]
                if number:
                    left = values[q, c]
                    for k in range(5):
                        left -= row[k] * light[c, k]
                    share *= (1.0 + weights[q, c] * left**2 / (3.0 * scale)) ** -2
                for k in range(5):
                    right[k] += share * row[k] * values[q, c]
                    for m in range(k + 1):
                        matrix[k, m] += share * row[k] * row[m]
            for k in range(5):
                for m in range(k):
                    matrix[m, k] = matrix[k, m]
            light[c] = np.linalg.solve(matrix, right)
            if number < _ROUNDS - 1:
                for q in range(len(values)):
                    if weights[q, c] == 0.0:
                        continue
                    left = values[q, c] - light[c, 0] * colours[q, c] - light[c, 1]
                    for k in range(3):
                        left -= normals[q, k] * light[c, 2 + k]
                    squares += weights[q, c] * left**2
                    seen += 1
                scale = max(squares / max(seen, 1), 1e-12)
    return light


@compiled(nogil=True)
def in_light(light: np.ndarray, colours: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """The neutral's colours (Q, 3) as they are expected in a ``light`` (3, 5)."""
    expected = np.empty(colours.shape)
    for q in range(len(colours)):
        for c in range(3):
            offset = light[c, 1] + normals[q, 0] * light[c, 2] + normals[q, 1] * light[c, 3] + normals[q, 2] * light[c, 4]
            expected[q, c] = light[c, 0] * colours[q, c] + offset
    return expected


@compiled(nogil=True)
def trust(residuals: np.ndarray, expected: np.ndarray, weights: np.ndarray, counts: np.ndarray) -> np.ndarray:
    """(3,) in [0, 1]: how far the channels are believed, by what the expected colours (Q, 3) explain of themselves.

    weights (Q, 3): ``counts`` (Q,) over the variances that noise and gloss leave in a fitting picture; so much is not held
    against it. Each by itself, and all of them by the sum: a colour that changes little over the face fits where all is
    displaced, too.
    """
    left, total, first, second, seen = np.zeros(3), np.full(3, 1e-12), np.zeros(3), np.zeros(3), 0.0
    for q in range(len(counts)):
        if counts[q] == 0.0:
            continue
        seen += counts[q]
        for c in range(3):
            weight = weights[q, c]
            left[c] += weight * residuals[q, c] ** 2
            total[c] += weight
            first[c] += weight * expected[q, c]
            second[c] += weight * expected[q, c] ** 2
    left = np.maximum(left - seen, 0.0)
    there = np.maximum(second - first**2 / total, 0.0)
    explained = np.empty(4)
    for c in range(3):
        explained[c] = 1.0 - left[c] / max(there[c], 1e-12)
    explained[3] = 1.0 - left.sum() / max(there.sum(), 1e-12)
    share = np.minimum(np.maximum((explained - EXPLAINED[0]) / (EXPLAINED[1] - EXPLAINED[0]), 0.0), 1.0)
    believed: np.ndarray = share[3] * share[:3]
    return believed
