"""Solve bounded linear least squares on small normal equations (section 4.2; Sugimoto, Fukushima & Ibaraki 1995)."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..caches.compiled import compiled

#: (H (A, A), g (A,), lower (A,), upper (A,), start (A,) or None) -> x (A,), as :func:`bounded_least_squares`.
BoundedSolver = Callable[[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray | None], np.ndarray]


@compiled
def _sparse_relaxation(
    h: np.ndarray,
    g: np.ndarray,
    penalty: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
    x: np.ndarray,
    relaxation: float,
    sweeps: int,
    tolerance: float,
) -> int:
    for sweep in range(sweeps):
        change = 0.0
        for i in range(len(x)):
            rest = g[i]
            for j in range(len(x)):
                rest -= h[i, j] * x[j]
            pull = rest + h[i, i] * x[i]
            best = max(abs(pull) - penalty[i], 0.0) / h[i, i] * (1.0 if pull > 0.0 else -1.0)
            new = x[i] + relaxation * (best - x[i])
            if new * best <= 0.0:  # not beyond the kink at zero
                new = best
            new = min(max(new, lower[i]), upper[i])
            change = max(change, abs(new - x[i]))
            x[i] = new
        if change < tolerance:
            return sweep + 1
    return sweeps


@compiled
def _projected_relaxation(
    h: np.ndarray,
    g: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
    x: np.ndarray,
    relaxation: float,
    sweeps: int,
    tolerance: float,
) -> int:
    for sweep in range(sweeps):
        change = 0.0
        for i in range(len(x)):
            step = g[i]
            for j in range(len(x)):
                step -= h[i, j] * x[j]
            new = min(max(x[i] + relaxation * step / h[i, i], lower[i]), upper[i])
            change = max(change, abs(new - x[i]))
            x[i] = new
        if change < tolerance:
            return sweep + 1
    return sweeps


def bounded_least_squares(
    h: np.ndarray,
    g: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
    start: np.ndarray | None = None,
    relaxation: float = 1.3,
    sweeps: int = 500,
    tolerance: float = 1e-8,
) -> np.ndarray:
    """Minimise x^T H x / 2 - g^T x subject to lower <= x <= upper.

    Parameters
    ----------
    h : (A, A)
        Symmetric positive definite.
    g : (A,)
        Right-hand side.
    lower, upper : (A,)
        Bounds.
    start : (A,), optional
        A first guess; zeros without.
    relaxation, sweeps, tolerance : float, int, float
        Over-relaxation, largest number of sweeps over the coefficients, and the change below which they end.

    Returns
    -------
    (A,)
        The minimum.

    Notes
    -----
    This is Gauss-Seidel with over-relaxation, in which every update is projected onto its interval. It is a relaxation method
    for box-constrained quadratic programs like that of Sugimoto et al. 1995, which updates in parallel and not in sequence.
    It would be wrong to clip the unbounded solution instead. Coefficients interact, so that the others must compensate for a
    clipped one.
    """
    x: np.ndarray = np.clip(np.zeros(len(g)) if start is None else np.array(start, float), lower, upper)
    _projected_relaxation(np.ascontiguousarray(h), g, lower, upper, x, relaxation, sweeps, tolerance)
    return x


def sparse_least_squares(
    h: np.ndarray,
    g: np.ndarray,
    penalty: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
    start: np.ndarray | None = None,
    relaxation: float = 1.3,
    sweeps: int = 500,
    tolerance: float = 1e-8,
) -> np.ndarray:
    """Minimise x^T H x / 2 - g^T x + sum_i penalty_i |x_i| subject to lower <= x <= upper: a lasso within bounds.

    Parameters
    ----------
    penalty : (A,)
        Weights of the coefficients' absolute values, not negative.
    h, g, lower, upper, start, relaxation, sweeps, tolerance
        As in :func:`bounded_least_squares`.

    Returns
    -------
    (A,)
        The minimum.

    Notes
    -----
    The iteration is that of :func:`bounded_least_squares`, except that each update is soft-thresholded on both sides of zero
    (coordinate descent, Friedman et al. 2007).
    """
    x: np.ndarray = np.clip(np.zeros(len(g)) if start is None else np.array(start, float), lower, upper)
    _sparse_relaxation(np.ascontiguousarray(h), g, penalty, lower, upper, x, relaxation, sweeps, tolerance)
    return x
