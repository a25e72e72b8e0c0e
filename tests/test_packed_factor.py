"""The packed factor's solves against SciPy's, and rows as vectors against plain numbers."""

import numpy as np
import pytest
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from adaptiveface.caches.compiled import compiled
from adaptiveface.tracking.lanes import LANES, less, put, row
from adaptiveface.tracking.packed_factor import PackedFactor


def grid_matrix(side: int) -> sp.csc_matrix:
    """L^T L + 0.1 of a grid, whose factor has columns alone, in pairs and in fours."""
    path = sp.diags([-1.0, 2.0, -1.0], [-1, 0, 1], shape=(side, side))
    laplacian = sp.kronsum(path, path)
    return (laplacian.T @ laplacian + 0.1 * sp.eye(side**2)).tocsc()


@pytest.mark.parametrize("single, tolerance", [(False, 1e-11), (True, 2e-4)])
def test_solutions_are_those_of_scipy(single, tolerance):
    matrix, right = grid_matrix(25), np.random.default_rng(0).normal(size=(625, 3))
    factor = splu(matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
    packed = PackedFactor(factor.L, factor.U.diagonal(), factor.perm_r)
    assert set(packed.layout.widths) == {1, 2, 4}
    np.testing.assert_allclose(packed.solve(right, single), factor.solve(right), atol=tolerance)


@compiled
def _subtract_products(array: np.ndarray, i: int, j: int, k: int) -> None:
    put(array, i, less(row(array, i), row(array, j), row(array, k)))


@compiled
def _subtract_row(array: np.ndarray, i: int, factor: float, j: int) -> None:
    put(array, i, less(row(array, i), factor, row(array, j)))


@pytest.mark.parametrize("precision", [np.float32, np.float64])
def test_rows_are_rounded_as_plain_numbers(precision):
    rng = np.random.default_rng(1)
    array = rng.normal(size=(7, LANES)).astype(precision)
    factor, expected = precision(rng.normal()), array.copy()
    expected[5] -= factor * expected[2]
    _subtract_row(array, 5, factor, 2)
    np.testing.assert_array_equal(array, expected)
    expected[0] -= expected[1] * expected[6]
    _subtract_products(array, 0, 1, 6)
    np.testing.assert_array_equal(array, expected)
