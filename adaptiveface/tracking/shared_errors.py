"""Errors that many of the detector's landmarks share, so that they do not turn the head.

A detector places a whole region too low, or turns its mesh too little. Landmarks with such errors agree with each other, and
least squares with independent errors believe them. So the errors of a frame are e = U z + independent errors. The columns of U
are the most frequent common errors, which ``data_synth/measure_shared_errors.py`` measured on rendered performers, and z is a
standard normal variable. It is eliminated from the fit of a frame, which amounts to generalised least squares with the
covariance U U^T + W^-1.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from importlib.resources import as_file, files

import numpy as np


@lru_cache(maxsize=1)
def measured_errors() -> tuple[np.ndarray, np.ndarray]:
    """Landmark numbers (L,) of the detector, and their common errors (L, 2, K) in mm per standard deviation.

    The errors are across the view, along the picture of the head's x axis and at right angles to it (down).
    """
    with as_file(files("adaptiveface") / "assets" / "shared_errors.npz") as path, np.load(path, allow_pickle=False) as data:
        return data["ids"], data["modes"].astype(float)


def errors_of(ids: np.ndarray) -> np.ndarray:
    """Common errors (F, 2, K) of the detector's landmarks ``ids`` (F,), mm; zeros for those that were not measured."""
    known, modes = measured_errors()
    row = {number: k for k, number in enumerate(known.tolist())}
    out = np.zeros((len(ids), *modes.shape[1:]))
    for k, number in enumerate(ids.tolist()):
        if number in row:
            out[k] = modes[row[number]]
    return out


@dataclass(frozen=True)
class SharedErrors:
    """Common errors of some features in one frame.

    Attributes
    ----------
    modes : (F, 2, K)
        Per standard deviation, in the head's directions as in :func:`measured_errors`, px mm as the rows of the features.
    weight : float
        Weight of z^T z. Rows whose weight is this large have a standard deviation of 1 mm.
    """

    modes: np.ndarray
    weight: float

    def explained(
        self, index: np.ndarray, pose: np.ndarray, jacobian: np.ndarray, target: np.ndarray, weights: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Compute the part of the normal equations that the common errors may explain.

        Parameters
        ----------
        index : (f,)
            The features of the rows.
        pose : (4, 4)
            Head frame to camera frame.
        jacobian : (2 f, n)
            The rows.
        target : (2 f,)
            What the rows should reach.
        weights : (2 f,)
            Of the rows.

        Returns
        -------
        h : (n, n)
            To be subtracted from the matrix.
        g : (n,)
            To be subtracted from the right-hand side.
        """
        across = pose[:2, 0] / np.linalg.norm(pose[:2, 0])
        axes = np.array([across, [-across[1], across[0]]])
        modes = np.einsum("ba,fbk->fak", axes, self.modes[index]).reshape(len(jacobian), -1)
        weighted = modes * weights[:, None]
        inner = weighted.T @ modes + self.weight * np.eye(modes.shape[1])
        cross = weighted.T @ jacobian
        solved = np.linalg.solve(inner, cross)
        return cross.T @ solved, solved.T @ (weighted.T @ target)
