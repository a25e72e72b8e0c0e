"""How the light of a picture shows the neutral's colours, and how far that picture is believed.

A lamp that moves, a camera that adapts its exposure or its white balance, and a head that turns under the lamp change the
channels T_qc of the neutral (:func:`~adaptiveface.appearance.channels`) smoothly over the face:

    expected_qc = gain_c T_qc + b_c0 + b_c . n_q

with the samples' normals n_q: spherical harmonics of order one (Ramamoorthi & Hanrahan 2001). Brightness against what is around
and shares of colour leave little shading to them. Five numbers a channel are fitted to thousands of samples, so that motion
is not taken for light.
"""

from __future__ import annotations

import numpy as np

#: Deviations of the gain from one and of the offsets (%) from zero.
GAIN, OFFSET = 0.3, 20.0
#: Share of the expected colours' variance that is found again in a picture: it tells nothing below the first, and is fully
#: believed from the second on.
EXPLAINED = (0.3, 0.6)
_ROUNDS = 2


def robust(residuals: np.ndarray, variances: np.ndarray) -> np.ndarray:
    """Weights in (0, 1] of residuals with these variances: a quarter for one of 1.7 standard deviations."""
    weights: np.ndarray = (1.0 + residuals**2 / (3.0 * variances)) ** -2
    return weights


def fit_light(values: np.ndarray, colours: np.ndarray, normals: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """The light (3, 5) of a picture that shows ``values`` (Q, 3) where the neutral has ``colours`` (Q, 3).

    normals (Q, 3) in the camera frame; weights (Q, 3): one over the variances, 0 for what is not seen. Per channel: the gain
    and the four offsets of the module's equation, by least squares with robust weights.
    """
    seen = np.flatnonzero(weights[:, 0])
    values, weights, basis = values[seen], weights[seen], _basis(colours[seen], normals[seen])
    precision = np.diag([GAIN**-2, *[OFFSET**-2] * 4])
    light, before = np.zeros((3, 5)), precision @ [1.0, 0, 0, 0, 0]
    for c, rows in enumerate(basis):
        share = weights[:, c]
        for number in range(_ROUNDS):
            weighted = rows.T * share
            light[c] = np.linalg.solve(weighted @ rows + precision, weighted @ values[:, c] + before)
            if number < _ROUNDS - 1:
                squares = weights[:, c] * (values[:, c] - rows @ light[c]) ** 2
                share = weights[:, c] * robust(np.sqrt(squares), np.maximum(squares.mean(), 1e-12))
    return light


def in_light(light: np.ndarray, colours: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """The neutral's colours (Q, 3) as they are expected in a ``light`` (3, 5)."""
    expected: np.ndarray = colours * light[:, 0] + light[:, 1] + normals @ light[:, 2:].T
    return expected


def _basis(colours: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """(3, Q, 5) rows of every channel: its colour, one, and the normal."""
    offsets = np.broadcast_to(np.column_stack([np.ones(len(normals)), normals]), (3, len(normals), 4))
    return np.concatenate([colours.T[:, :, None], offsets], axis=2)


def trust(residuals: np.ndarray, expected: np.ndarray, weights: np.ndarray, counts: np.ndarray) -> np.ndarray:
    """(3,) in [0, 1]: how far the channels are believed, by what the expected colours (Q, 3) explain of themselves.

    weights (Q, 3): ``counts`` (Q,) over the variances that noise and gloss leave in a fitting picture; so much is not held
    against it. Each by itself, and all of them by the sum: a colour that changes little over the face fits where all is
    displaced, too.
    """
    left = np.maximum((weights * residuals**2).sum(axis=0) - counts.sum(), 0.0)
    middle = (weights * expected).sum(axis=0) / np.maximum(weights.sum(axis=0), 1e-12)
    there = (weights * (expected - middle) ** 2).sum(axis=0)
    explained = 1.0 - np.append(left, left.sum()) / np.maximum(np.append(there, there.sum()), 1e-12)
    share = np.clip((explained - EXPLAINED[0]) / (EXPLAINED[1] - EXPLAINED[0]), 0.0, 1.0)
    believed: np.ndarray = share[3] * share[:3]
    return believed
