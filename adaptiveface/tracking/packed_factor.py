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
    """P b, (n, 3), in the precision of ``zero``."""
    y = np.full(right.shape, zero)
    for i in range(len(order)):
        for k in range(3):
            y[order[i], k] = right[i, k]
    return y


@compiled
def _permuted_back(y: np.ndarray, order: np.ndarray) -> np.ndarray:
    """P^T y, (n, 3), in double precision."""
    out = np.empty(y.shape)
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
    """G^-1 y in place; the three coordinates share one pass over the factor."""
    j = np.uint64(0)
    for block in range(len(widths)):
        width, place = np.uint64(widths[block]), np.uint64(first_value[block])
        for p in range(j, j + width):  # the block's own triangle
            for q in range(p + _1, j + width):
                for k in range(3):
                    y[q, k] -= values[place] * y[p, k]
                place += _1
        begin, end = np.uint64(first_row[block]), np.uint64(first_row[block + 1])
        if width == _4:
            _eliminate_four(rows, begin, end, values, place, y, j)
        elif width == _2:
            _eliminate_two(rows, begin, end, values, place, y, j)
        else:
            a, b, c = y[j, 0], y[j, 1], y[j, 2]
            for k in range(begin, end):
                i, value = rows[k], values[place]
                y[i, 0] -= value * a
                y[i, 1] -= value * b
                y[i, 2] -= value * c
                place += _1
        j += width


@compiled(inline="always")
def _eliminate_two(
    rows: np.ndarray, begin: np.uint64, end: np.uint64, values: np.ndarray, place: np.uint64, y: np.ndarray, j: np.uint64
) -> None:
    """Subtract columns j and j + 1 from the rows ``begin`` to ``end``."""
    a0, b0, c0 = y[j, 0], y[j, 1], y[j, 2]
    a1, b1, c1 = y[j + _1, 0], y[j + _1, 1], y[j + _1, 2]
    for k in range(begin, end):
        i, v0, v1 = rows[k], values[place], values[place + _1]
        y[i, 0] = y[i, 0] - v0 * a0 - v1 * a1
        y[i, 1] = y[i, 1] - v0 * b0 - v1 * b1
        y[i, 2] = y[i, 2] - v0 * c0 - v1 * c1
        place += _2


@compiled(inline="always")
def _eliminate_four(
    rows: np.ndarray, begin: np.uint64, end: np.uint64, values: np.ndarray, place: np.uint64, y: np.ndarray, j: np.uint64
) -> None:
    """Subtract columns j to j + 3 from the rows ``begin`` to ``end``."""
    a0, b0, c0 = y[j, 0], y[j, 1], y[j, 2]
    a1, b1, c1 = y[j + _1, 0], y[j + _1, 1], y[j + _1, 2]
    a2, b2, c2 = y[j + _2, 0], y[j + _2, 1], y[j + _2, 2]
    a3, b3, c3 = y[j + _3, 0], y[j + _3, 1], y[j + _3, 2]
    for k in range(begin, end):
        i = rows[k]
        v0, v1, v2, v3 = values[place], values[place + _1], values[place + _2], values[place + _3]
        y[i, 0] = y[i, 0] - v0 * a0 - v1 * a1 - v2 * a2 - v3 * a3
        y[i, 1] = y[i, 1] - v0 * b0 - v1 * b1 - v2 * b2 - v3 * b3
        y[i, 2] = y[i, 2] - v0 * c0 - v1 * c1 - v2 * c2 - v3 * c3
        place += _4


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
    j, below = np.uint64(len(inverse_diagonal)), np.zeros((4, 3), y.dtype)
    for block in range(len(widths) - 1, -1, -1):
        width = np.uint64(widths[block])
        j -= width
        place = np.uint64(first_value[block]) + width * (width - _1) // _2
        begin, end = np.uint64(first_row[block]), np.uint64(first_row[block + 1])
        below[:] = 0.0
        if width == _4:
            _gather_four(rows, begin, end, values, place, y, below)
        elif width == _2:
            _gather_two(rows, begin, end, values, place, y, below)
        else:
            a, b, c = below[0]
            for k in range(begin, end):
                i, value = rows[k], values[place]
                a += value * y[i, 0]
                b += value * y[i, 1]
                c += value * y[i, 2]
                place += _1
            below[0, 0], below[0, 1], below[0, 2] = a, b, c
        place = np.uint64(first_value[block]) + width * (width - _1) // _2
        for number in range(width):  # the block's own triangle, the last column first
            p = width - _1 - number
            place -= number
            for k in range(3):
                value = y[j + p, k] * inverse_diagonal[j + p] - below[p, k]
                for q in range(number):
                    value -= values[place + q] * y[j + p + _1 + q, k]
                y[j + p, k] = value


@compiled(inline="always")
def _gather_two(
    rows: np.ndarray, begin: np.uint64, end: np.uint64, values: np.ndarray, place: np.uint64, y: np.ndarray, out: np.ndarray
) -> None:
    """Add the products of two neighbouring columns with y to ``out`` (4, 3)."""
    a0, b0, c0 = out[0]
    a1, b1, c1 = out[1]
    for k in range(begin, end):
        i, v0, v1 = rows[k], values[place], values[place + _1]
        a, b, c = y[i, 0], y[i, 1], y[i, 2]
        a0, b0, c0 = a0 + v0 * a, b0 + v0 * b, c0 + v0 * c
        a1, b1, c1 = a1 + v1 * a, b1 + v1 * b, c1 + v1 * c
        place += _2
    out[0, 0], out[0, 1], out[0, 2] = a0, b0, c0
    out[1, 0], out[1, 1], out[1, 2] = a1, b1, c1


@compiled(inline="always")
def _gather_four(
    rows: np.ndarray, begin: np.uint64, end: np.uint64, values: np.ndarray, place: np.uint64, y: np.ndarray, out: np.ndarray
) -> None:
    """Add the products of four neighbouring columns with y to ``out`` (4, 3)."""
    a0, b0, c0 = out[0]
    a1, b1, c1 = out[1]
    a2, b2, c2 = out[2]
    a3, b3, c3 = out[3]
    for k in range(begin, end):
        i = rows[k]
        v0, v1, v2, v3 = values[place], values[place + _1], values[place + _2], values[place + _3]
        a, b, c = y[i, 0], y[i, 1], y[i, 2]
        a0, b0, c0 = a0 + v0 * a, b0 + v0 * b, c0 + v0 * c
        a1, b1, c1 = a1 + v1 * a, b1 + v1 * b, c1 + v1 * c
        a2, b2, c2 = a2 + v2 * a, b2 + v2 * b, c2 + v2 * c
        a3, b3, c3 = a3 + v3 * a, b3 + v3 * b, c3 + v3 * c
        place += _4
    out[0, 0], out[0, 1], out[0, 2] = a0, b0, c0
    out[1, 0], out[1, 1], out[1, 2] = a1, b1, c1
    out[2, 0], out[2, 1], out[2, 2] = a2, b2, c2
    out[3, 0], out[3, 1], out[3, 2] = a3, b3, c3
