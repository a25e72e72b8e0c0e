"""Store a sparse triangular factor in the order in which a solve reads it.

Most of a solve's time is spent waiting for the factor. It is read twice in every frame, and other stages push it out of the
processor's nearer caches meanwhile. The forward pass eliminates up to four neighbouring columns with the same rows below them
(a part of a supernode) at once, with their values side by side and their row numbers stored once. For the backward pass, the
columns are in the order of the substitution. A vertex's three coordinates and a zero are one vector of the processor. Every sum
is still taken column by column, so that no result changes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from ..caches.compiled import compiled
from .lanes import LANES, less, put, row


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
        self._single_values = forward.astype(np.float32)
        self._single_inverse_diagonal = self._inverse_diagonal.astype(np.float32)

    def __len__(self) -> int:
        """Number of entries of G below its diagonal."""
        return len(self._values[0])

    def solve(self, right: np.ndarray, single: bool = False) -> np.ndarray:
        """Solve A x = b for b (n, 3). ``single`` uses the factor in single precision, which is faster to read."""
        at = self.layout
        if single:
            y = _permuted(right, self._order, np.float32(0.0))
            _forward(at.widths, at.block_rows, at.block_values, at.rows, self._single_values, y)
            _backward_blocks(
                at.widths, at.block_rows, at.block_values, at.rows, self._single_values, self._single_inverse_diagonal, y
            )
            return _permuted_back(y, self._order)
        forward, backward = self._values
        y = _permuted(right, self._order, 0.0)
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
def _permuted(right: np.ndarray, order: np.ndarray, zero: float | np.float32) -> np.ndarray:
    """P b, (n, 3) and a column of zeros, in the precision of ``zero``."""
    y = np.full((len(right), LANES), zero)
    for i in range(len(order)):
        for k in range(3):
            y[order[i], k] = right[i, k]
    return y


@compiled
def _permuted_back(y: np.ndarray, order: np.ndarray) -> np.ndarray:
    """P^T y, (n, 3), in double precision, of y (n, 4)."""
    out = np.empty((len(y), 3))
    for i in range(len(order)):
        for k in range(3):
            out[i, k] = y[order[i], k]
    return out


#: Unsigned numbers: numba tests each signed index for being negative, which costs as much as the sums.
_1, _2, _3, _4 = (np.uint64(number) for number in (1, 2, 3, 4))


@compiled
def _forward(
    widths: np.ndarray, first_row: np.ndarray, first_value: np.ndarray, rows: np.ndarray, values: np.ndarray, y: np.ndarray
) -> None:
    """G^-1 y in place, y (n, 4); the coordinates share one pass over the factor."""
    j = np.uint64(0)
    for block in range(len(widths)):
        width, place = np.uint64(widths[block]), np.uint64(first_value[block])
        for p in range(j, j + width):  # the block's own triangle
            for q in range(p + _1, j + width):
                put(y, q, less(row(y, q), values[place], row(y, p)))
                place += _1
        begin, end = np.uint64(first_row[block]), np.uint64(first_row[block + 1])
        if width == _4:
            a, b, c, d = row(y, j), row(y, j + _1), row(y, j + _2), row(y, j + _3)
            for k in range(begin, end):
                left = less(less(row(y, rows[k]), values[place], a), values[place + _1], b)
                put(y, rows[k], less(less(left, values[place + _2], c), values[place + _3], d))
                place += _4
        elif width == _2:
            a, b = row(y, j), row(y, j + _1)
            for k in range(begin, end):
                put(y, rows[k], less(less(row(y, rows[k]), values[place], a), values[place + _1], b))
                place += _2
        else:
            a = row(y, j)
            for k in range(begin, end):
                put(y, rows[k], less(row(y, rows[k]), values[place], a))
                place += _1
        j += width


@compiled
def _backward(starts: np.ndarray, rows: np.ndarray, values: np.ndarray, inverse_diagonal: np.ndarray, y: np.ndarray) -> None:
    """G^-T D^-1 y in place, y (n, 4)."""
    n = len(inverse_diagonal)
    for number in range(n):
        j = n - 1 - number
        for k in range(3):
            y[j, k] *= inverse_diagonal[j]
        left = row(y, j)
        for k in range(starts[number], starts[number + 1]):
            left = less(left, values[k], row(y, rows[k]))
        put(y, j, left)


@compiled
def _backward_blocks(
    widths: np.ndarray,
    first_row: np.ndarray,
    first_value: np.ndarray,
    rows: np.ndarray,
    values: np.ndarray,
    inverse_diagonal: np.ndarray,
    y: np.ndarray,
) -> None:
    """G^-T D^-1 y in place from the forward pass's values: the columns of a block share one pass over the rows below it."""
    j, zeros, below = np.uint64(len(inverse_diagonal)), np.zeros((1, LANES), y.dtype), np.zeros((4, LANES), y.dtype)
    for block in range(len(widths) - 1, -1, -1):
        width = np.uint64(widths[block])
        j -= width
        place = np.uint64(first_value[block]) + width * (width - _1) // _2
        begin, end = np.uint64(first_row[block]), np.uint64(first_row[block + 1])
        a = row(zeros, 0)
        b, c, d = a, a, a
        if width == _4:
            for k in range(begin, end):
                known = row(y, rows[k])
                a, b = less(a, values[place], known), less(b, values[place + _1], known)
                c, d = less(c, values[place + _2], known), less(d, values[place + _3], known)
                place += _4
        elif width == _2:
            for k in range(begin, end):
                known = row(y, rows[k])
                a, b = less(a, values[place], known), less(b, values[place + _1], known)
                place += _2
        else:
            for k in range(begin, end):
                a = less(a, values[place], row(y, rows[k]))
                place += _1
        put(below, 0, a)
        put(below, 1, b)
        put(below, 2, c)
        put(below, 3, d)
        place = np.uint64(first_value[block]) + width * (width - _1) // _2
        for number in range(width):  # the block's own triangle, the last column first
            p = width - _1 - number
            place -= number
            for k in range(3):
                value = y[j + p, k] * inverse_diagonal[j + p] + below[p, k]
                for q in range(number):
                    value -= values[place + q] * y[j + p + _1 + q, k]
                y[j + p, k] = value
