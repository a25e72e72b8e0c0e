"""Move patches of skin to their places in the picture: the compiled steps of ``feature_refinement.py``.

All rounds are one call. In NumPy, the small systems took more time than the samples, and kept Python's interpreter from the
other threads.
"""

from __future__ import annotations

import numpy as np

from ..caches.compiled import compiled

#: Deviations of the gain and the offset (percent) of a patch's brightness from one and zero.
GAIN, OFFSET = 0.3, 20.0
#: Longest step of a round, px.
_LONGEST = 1.5
_ONE = np.uint32(1)


@compiled(nogil=True)
def align_patches(
    images: tuple[np.ndarray, np.ndarray, np.ndarray],
    pixels: np.ndarray,
    weights: np.ndarray,
    colours: np.ndarray,
    starts: np.ndarray,
    seen: np.ndarray,
    shift: np.ndarray,
    detected: np.ndarray,
    precision: np.ndarray,
    rounds: int,
    floor: float,
    stride: int = 1,
) -> tuple[np.ndarray, np.ndarray]:
    """Align patches with a picture by Gauss-Newton.

    Parameters
    ----------
    images : three (H, W, 3) float32
        Channels of the picture, their gradients along u, and their gradients along v.
    pixels, weights, colours : (Q, 2), (Q,), (Q, 3)
        Samples of the neutral. Those of patch f are ``starts[f]`` to ``starts[f + 1]``.
    starts : (P + 1,)
        Where the samples of each patch begin.
    seen : (n,)
        Numbers of the patches to align.
    shift : (n, 2)
        First shifts, px.
    detected, precision : (n, 2), (n, n)
        Detected shifts, px, and their precision along u and along v, px^-2.
    rounds : int
        Number of rounds.
    floor : float
        Least variance of a channel.
    stride : int
        Every so many samples of a patch stand for all of them.

    Returns
    -------
    shift : (n, 2)
        Of the patches, px.
    variance : (n,)
        That remains of each shift, px^2.
    """
    n = len(seen)
    shift, light = shift.copy(), np.zeros((n, 2))
    light[:, 0] = 1.0
    gains, rests = np.zeros((n, 2, 2)), np.zeros((n, 2))  # of the brightness: per unit of shift, and without a shift
    whole = np.zeros((2 * n, 2 * n))
    first = _first_columns(precision)
    for _ in range(rounds):
        right = (precision @ (detected - shift)).ravel()
        _set_detected(whole, precision, first)
        for i in range(n):
            a, b = starts[seen[i]], starts[seen[i] + 1]
            part = slice(a, b, stride)
            h, g = _normal_equations(images, pixels[part], weights[part], colours[part], shift[i], light[i], floor)
            h, g = stride * h, stride * g
            _eliminate_light(h, g, light[i], gains[i], rests[i])
            for k in range(2):
                right[2 * i + k] += g[k]
                for m in range(2):
                    whole[2 * i + k, 2 * i + m] += h[k, m]
        _factorise(whole, first)
        _move(shift, light, _solve(whole, first, right), gains, rests)
    diagonal = _inverse_diagonal(whole, first)
    variance = 0.5 * (diagonal[0::2] + diagonal[1::2])
    return shift, variance


@compiled(nogil=True)
def _set_detected(whole: np.ndarray, precision: np.ndarray, first: np.ndarray) -> None:
    """Set the matrix (2 n, 2 n) to the ``precision`` (n, n) of the detected shifts, along u and along v, in place."""
    for i in range(len(precision)):
        for j in range(first[2 * i] // 2, i + 1):  # the lower triangle is enough
            for k in range(2):
                whole[2 * i + k, 2 * j + k] = precision[i, j]
                whole[2 * i + k, 2 * j + 1 - k] = 0.0


@compiled(nogil=True)
def _move(shift: np.ndarray, light: np.ndarray, step: np.ndarray, gains: np.ndarray, rests: np.ndarray) -> None:
    """Move every patch by its part of ``step`` (2 n,), at most ``_LONGEST``, and let its light follow, in place."""
    for i in range(len(shift)):
        for k in range(2):
            step[2 * i + k] = min(max(step[2 * i + k], -_LONGEST), _LONGEST)
            shift[i, k] += step[2 * i + k]
        for k in range(2):
            light[i, k] += rests[i, k] - gains[i, k, 0] * step[2 * i] - gains[i, k, 1] * step[2 * i + 1]


@compiled(nogil=True)
def _normal_equations(
    images: tuple[np.ndarray, np.ndarray, np.ndarray],
    pixels: np.ndarray,
    weights: np.ndarray,
    colours: np.ndarray,
    shift: np.ndarray,
    light: np.ndarray,
    floor: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Normal equations H (4, 4) and g (4,) of one patch in (shift u, shift v, gain, offset), with Cauchy's weights.

    A channel's scale is its weighted mean square residual in the patch, at least ``floor``. Only the brightness has a gain
    and an offset.
    """
    values = np.empty((len(pixels), 3, 3))
    total, scale0, scale1, scale2 = _compare(images, pixels, weights, colours, shift, light, values)
    if total == 0.0:
        return np.zeros((4, 4)), np.zeros(4)
    scale = max(scale0 / total, floor), max(scale1 / total, floor), max(scale2 / total, floor)
    # Sums in arrays would be written to memory and read again for every sample.
    uu, uv, vv, u_gain, v_gain, u_offset, v_offset = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    gains, both, offsets, gu, gv, g_gain, g_offset = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for q in range(len(pixels)):
        if weights[q] == 0.0:
            continue
        for c in range(3):
            residual, du, dv = values[q, 0, c], values[q, 1, c], values[q, 2, c]
            weight = weights[q] / (scale[c] + 0.25 * residual**2)
            along, across = weight * du, weight * dv
            uu, uv, vv = uu + along * du, uv + along * dv, vv + across * dv
            gu, gv = gu - along * residual, gv - across * residual
            if c == 0:
                colour = colours[q, 0]
                u_gain, v_gain = u_gain - along * colour, v_gain - across * colour
                u_offset, v_offset = u_offset - along, v_offset - across
                gains, both, offsets = gains + weight * colour * colour, both + weight * colour, offsets + weight
                g_gain, g_offset = g_gain + weight * colour * residual, g_offset + weight * residual
    h, g = np.empty((4, 4)), np.empty(4)
    h[0, 0], h[0, 1], h[0, 2], h[0, 3], g[0] = uu, uv, u_gain, u_offset, gu
    h[1, 0], h[1, 1], h[1, 2], h[1, 3], g[1] = uv, vv, v_gain, v_offset, gv
    h[2, 0], h[2, 1], h[2, 2], h[2, 3], g[2] = u_gain, v_gain, gains, both, g_gain
    h[3, 0], h[3, 1], h[3, 2], h[3, 3], g[3] = u_offset, v_offset, both, offsets, g_offset
    return h, g


@compiled(nogil=True)
def _compare(
    images: tuple[np.ndarray, np.ndarray, np.ndarray],
    pixels: np.ndarray,
    weights: np.ndarray,
    colours: np.ndarray,
    shift: np.ndarray,
    light: np.ndarray,
    values: np.ndarray,
) -> tuple[float, float, float, float]:
    """Fill ``values`` (Q, 3, 3): each channel's residual at a sample, and its gradients along u and along v.

    Returns the sum of the weights, and each channel's sum of weighted squared residuals.
    """
    picture, along_u, along_v = images
    height, width = picture.shape[:2]
    total = 0.0
    scale0, scale1, scale2 = 0.0, 0.0, 0.0
    for q in range(len(pixels)):
        if weights[q] == 0.0:
            continue
        x = min(max(pixels[q, 0] + shift[0], 0.0), width - 1.001)
        y = min(max(pixels[q, 1] + shift[1], 0.0), height - 1.001)
        i, j = np.uint32(y), np.uint32(x)  # unsigned: numba tests each signed index for being negative
        b, a = np.float32(y - i), np.float32(x - j)
        for c in range(3):
            values[q, 0, c] = _bilinear(picture, i, j, b, a, c)
            values[q, 1, c] = _bilinear(along_u, i, j, b, a, c)
            values[q, 2, c] = _bilinear(along_v, i, j, b, a, c)
        values[q, 0, 0] -= light[0] * colours[q, 0] + light[1]
        values[q, 0, 1] -= colours[q, 1]
        values[q, 0, 2] -= colours[q, 2]
        scale0 += weights[q] * values[q, 0, 0] ** 2
        scale1 += weights[q] * values[q, 0, 1] ** 2
        scale2 += weights[q] * values[q, 0, 2] ** 2
        total += weights[q]
    return total, scale0, scale1, scale2


@compiled(inline="always")
def _bilinear(image: np.ndarray, i: np.uint32, j: np.uint32, b: np.float32, a: np.float32, c: int) -> float:
    """Channel c of an image (H, W, 3) at row i + b and column j + a."""
    above = image[i, j, c] + a * (image[i, j + _ONE, c] - image[i, j, c])
    below = image[i + _ONE, j, c] + a * (image[i + _ONE, j + _ONE, c] - image[i + _ONE, j, c])
    value: float = above + b * (below - above)
    return value


@compiled(nogil=True)
def _eliminate_light(h: np.ndarray, g: np.ndarray, light: np.ndarray, gains: np.ndarray, rests: np.ndarray) -> None:
    """Reduce H and g to the shift, in place. Gain and offset, with their priors, then are ``rests - gains @ step``."""
    prior_gain, prior_offset = GAIN**-2, OFFSET**-2
    h_gain, h_offset, h_both = h[2, 2] + prior_gain, h[3, 3] + prior_offset, h[2, 3]
    g_gain, g_offset = g[2] + (1.0 - light[0]) * prior_gain, g[3] - light[1] * prior_offset
    determinant = h_gain * h_offset - h_both * h_both
    rests[0] = (h_offset * g_gain - h_both * g_offset) / determinant
    rests[1] = (h_gain * g_offset - h_both * g_gain) / determinant
    for k in range(2):
        gains[0, k] = (h_offset * h[2, k] - h_both * h[3, k]) / determinant
        gains[1, k] = (h_gain * h[3, k] - h_both * h[2, k]) / determinant
    for k in range(2):
        g[k] -= h[2, k] * rests[0] + h[3, k] * rests[1]
        for m in range(2):
            h[k, m] -= h[2, k] * gains[0, m] + h[3, k] * gains[1, m]


@compiled(nogil=True)
def _first_columns(precision: np.ndarray) -> np.ndarray:
    """(2 n,) the first column that is not zero in each row of the whole matrix: regions err on their own."""
    first = np.zeros(2 * len(precision), np.int64)
    for i in range(len(precision)):
        j = 0
        while j < i and precision[i, j] == 0.0:
            j += 1
        first[2 * i] = first[2 * i + 1] = 2 * j
    return first


@compiled(nogil=True)
def _factorise(matrix: np.ndarray, first: np.ndarray) -> None:
    """The lower Cholesky factor in place, of rows that begin at the columns ``first`` (2 n,)."""
    for i in range(len(matrix)):
        for j in range(first[i], i + 1):
            total = matrix[i, j]
            for k in range(max(first[i], first[j]), j):
                total -= matrix[i, k] * matrix[j, k]
            matrix[i, j] = np.sqrt(total) if i == j else total / matrix[j, j]


@compiled(nogil=True)
def _solve(factor: np.ndarray, first: np.ndarray, right: np.ndarray) -> np.ndarray:
    """x (2 n,) of L L^T x = right."""
    x = right.copy()
    for i in range(len(x)):
        for j in range(first[i], i):
            x[i] -= factor[i, j] * x[j]
        x[i] /= factor[i, i]
    for i in range(len(x) - 1, -1, -1):
        x[i] /= factor[i, i]
        for j in range(first[i], i):
            x[j] -= factor[i, j] * x[i]
    return x


@compiled(nogil=True)
def _inverse_diagonal(factor: np.ndarray, first: np.ndarray) -> np.ndarray:
    """(2 n,) the diagonal of (L L^T)^-1: squared lengths of the columns of L^-1."""
    count = len(factor)
    diagonal, inverse = np.zeros(count), np.zeros((count, count))
    for i in range(count):
        for k in range(first[i], i):
            for j in range(first[k], k + 1):
                inverse[i, j] -= factor[i, k] * inverse[k, j]
        inverse[i, i] = 1.0
        for j in range(first[i], i + 1):
            inverse[i, j] /= factor[i, i]
            diagonal[j] += inverse[i, j] ** 2
    return diagonal
