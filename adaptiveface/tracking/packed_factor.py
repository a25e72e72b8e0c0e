"""Store a sparse triangular factor in the order in which a solve reads it.

Most of a solve's time is spent waiting for the factor. It is read twice in every frame, and other stages push it out of the
processor's nearer caches meanwhile. The forward pass eliminates up to four neighbouring columns with the same rows below them
(a part of a supernode) at once, with their values side by side and their row numbers stored once. For the backward pass, the
columns are in the order of the substitution. Every sum is still taken column by column, so that no result changes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from ..caches.compiled import compiled


@dataclass(frozen=True)
class Layout:
    """Layout of the b blocks of the forward pass and the n columns of the backward pass.

    Attributes
    ----------
    widths : (b,)
        4, 2 or 1 columns.
    block_rows, block_values : (b + 1,)
        Where the blocks begin in ``rows`` and in the values.
    rows : int array
        Row numbers below each block's own triangle.
    column_starts, column_rows : (n + 1,), int array
        The same for the columns of the backward pass, the last column first.
    """

    widths: np.ndarray
    block_rows: np.ndarray
    block_values: np.ndarray
    rows: np.ndarray
    column_starts: np.ndarray
    column_rows: np.ndarray


class PackedFactor:
    """G and D of A = P^T G D G^T P with G unit lower triangular.

    Parameters
    ----------
    lower : (n, n) sparse, compressed columns
        G, including its unit diagonal.
    diagonal : (n,)
        The diagonal of D.
    order : (n,) int
        Vertex i is row ``order[i]`` of G.
    """

    def __init__(self, lower: sp.csc_matrix, diagonal: np.ndarray, order: np.ndarray) -> None:
        lower.sort_indices()
        below = np.ones(lower.nnz, bool)
        below[lower.indptr[:-1]] = False  # each column begins with its unit diagonal, which is not stored
        starts = (lower.indptr - np.arange(len(lower.indptr))).astype(np.int32)
        rows, values = lower.indices[below].astype(np.int32), lower.data[below]
        self._inverse_diagonal, self._order = 1.0 / diagonal, order.astype(np.uint32)
        widths = _block_widths(starts, rows)
        block_rows, block_values, shared, forward = _pack_forward(starts, rows, values, widths)
        column_starts, column_rows, backward = _pack_backward(starts, rows, values)
        self.layout = Layout(widths, block_rows, block_values, shared, column_starts, column_rows)
        self._values = forward, backward
        self._single_values = forward.astype(np.float32), backward.astype(np.float32)

    def __len__(self) -> int:
        """Number of entries of G below its diagonal."""
        return len(self._values[0])

    def solve(self, right: np.ndarray, single: bool = False) -> np.ndarray:
        """Solve A x = b for b (n, 3). ``single`` uses the factor in single precision, which is faster to read."""
        forward, backward = self._single_values if single else self._values
        y = _permuted(right, self._order)
        at = self.layout
        _forward(at.widths, at.block_rows, at.block_values, at.rows, forward, y)
        _backward(at.column_starts, at.column_rows, backward, self._inverse_diagonal, y)
        return _permuted_back(y, self._order)


@compiled
def _block_widths(starts: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Numbers (b,) of neighbouring columns that are eliminated together."""
    n = len(starts) - 1
    alike = np.ones(n, np.int32)  # how many columns from each one on have the same rows below their own triangle
    for j in range(n - 2, -1, -1):
        first, second, end = starts[j], starts[j + 1], starts[j + 2]
        same = second - first == end - second + 1 and rows[first] == j + 1
        for k in range(end - second):
            same = same and rows[first + 1 + k] == rows[second + k]
        if same:
            alike[j] = alike[j + 1] + 1
    widths = np.empty(n, np.int32)
    j, count = 0, 0
    while j < n:
        widths[count] = 4 if alike[j] >= 4 else (2 if alike[j] >= 2 else 1)
        j += widths[count]
        count += 1
    return widths[:count].copy()


@compiled
def _pack_forward(
    starts: np.ndarray, rows: np.ndarray, values: np.ndarray, widths: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """The values by block: first those of its own triangle, column by column, then those of each row below it."""
    first_row, first_value = np.zeros(len(widths) + 1, np.int32), np.zeros(len(widths) + 1, np.int32)
    shared, packed = np.empty(len(rows), np.uint32), np.empty(len(values), values.dtype)
    j, row, place = 0, 0, 0
    for block in range(len(widths)):
        width = widths[block]
        for p in range(width):
            for k in range(width - 1 - p):
                packed[place] = values[starts[j + p] + k]
                place += 1
        last = starts[j + width - 1]
        for k in range(starts[j + width] - last):
            shared[row] = rows[last + k]
            row += 1
            for p in range(width):
                packed[place] = values[starts[j + p] + width - 1 - p + k]
                place += 1
        j += width
        first_row[block + 1], first_value[block + 1] = row, place
    return first_row, first_value, shared[:row].copy(), packed


@compiled
def _pack_backward(starts: np.ndarray, rows: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The columns in reversed order, each one unchanged."""
    n = len(starts) - 1
    first, turned, packed = np.zeros(n + 1, np.int32), np.empty(len(rows), np.uint32), np.empty(len(values), values.dtype)
    place = 0
    for number in range(n):
        j = n - 1 - number
        for k in range(starts[j], starts[j + 1]):
            turned[place], packed[place] = rows[k], values[k]
            place += 1
        first[number + 1] = place
    return first, turned, packed


@compiled
def _permuted(right: np.ndarray, order: np.ndarray) -> np.ndarray:
    """P b, (n, 3)."""
    y = np.empty(right.shape)
    for i in range(len(order)):
        for k in range(3):
            y[order[i], k] = right[i, k]
    return y


@compiled
def _permuted_back(y: np.ndarray, order: np.ndarray) -> np.ndarray:
    """P^T y, (n, 3)."""
    out = np.empty(y.shape)
    for i in range(len(order)):
        for k in range(3):
            out[i, k] = y[order[i], k]
    return out


@compiled
def _forward(
    widths: np.ndarray, first_row: np.ndarray, first_value: np.ndarray, rows: np.ndarray, values: np.ndarray, y: np.ndarray
) -> None:
    """G^-1 y in place; the three coordinates share one pass over the factor."""
    j = 0
    for block in range(len(widths)):
        width, place = widths[block], first_value[block]
        for p in range(width):  # the block's own triangle
            for q in range(p + 1, width):
                for k in range(3):
                    y[j + q, k] -= values[place] * y[j + p, k]
                place += 1
        begin, end = first_row[block], first_row[block + 1]
        if width == 4:
            _eliminate_four(rows, begin, end, values, place, y, j)
        elif width == 2:
            _eliminate_two(rows, begin, end, values, place, y, j)
        else:
            a, b, c = y[j, 0], y[j, 1], y[j, 2]
            for k in range(begin, end):
                i, value = rows[k], values[place]
                y[i, 0] -= value * a
                y[i, 1] -= value * b
                y[i, 2] -= value * c
                place += 1
        j += width


@compiled(inline="always")
def _eliminate_two(rows: np.ndarray, begin: int, end: int, values: np.ndarray, place: int, y: np.ndarray, j: int) -> None:
    """Subtract columns j and j + 1 from the rows ``begin`` to ``end``."""
    a0, b0, c0 = y[j, 0], y[j, 1], y[j, 2]
    a1, b1, c1 = y[j + 1, 0], y[j + 1, 1], y[j + 1, 2]
    for k in range(begin, end):
        i, v0, v1 = rows[k], values[place], values[place + 1]
        y[i, 0] = y[i, 0] - v0 * a0 - v1 * a1
        y[i, 1] = y[i, 1] - v0 * b0 - v1 * b1
        y[i, 2] = y[i, 2] - v0 * c0 - v1 * c1
        place += 2


@compiled(inline="always")
def _eliminate_four(rows: np.ndarray, begin: int, end: int, values: np.ndarray, place: int, y: np.ndarray, j: int) -> None:
    """Subtract columns j to j + 3 from the rows ``begin`` to ``end``."""
    a0, b0, c0 = y[j, 0], y[j, 1], y[j, 2]
    a1, b1, c1 = y[j + 1, 0], y[j + 1, 1], y[j + 1, 2]
    a2, b2, c2 = y[j + 2, 0], y[j + 2, 1], y[j + 2, 2]
    a3, b3, c3 = y[j + 3, 0], y[j + 3, 1], y[j + 3, 2]
    for k in range(begin, end):
        i = rows[k]
        v0, v1, v2, v3 = values[place], values[place + 1], values[place + 2], values[place + 3]
        y[i, 0] = y[i, 0] - v0 * a0 - v1 * a1 - v2 * a2 - v3 * a3
        y[i, 1] = y[i, 1] - v0 * b0 - v1 * b1 - v2 * b2 - v3 * b3
        y[i, 2] = y[i, 2] - v0 * c0 - v1 * c1 - v2 * c2 - v3 * c3
        place += 4


@compiled
def _backward(starts: np.ndarray, rows: np.ndarray, values: np.ndarray, inverse_diagonal: np.ndarray, y: np.ndarray) -> None:
    """G^-T D^-1 y in place."""
    n = len(inverse_diagonal)
    for number in range(n):
        j = n - 1 - number
        scale = inverse_diagonal[j]
        a, b, c = y[j, 0] * scale, y[j, 1] * scale, y[j, 2] * scale
        for k in range(starts[number], starts[number + 1]):
            i, value = rows[k], values[k]
            a -= value * y[i, 0]
            b -= value * y[i, 1]
            c -= value * y[i, 2]
        y[j, 0], y[j, 1], y[j, 2] = a, b, c
