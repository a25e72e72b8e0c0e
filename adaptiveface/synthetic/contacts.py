"""Make lids and lips touch instead of crossing, which a sum of expressions cannot guarantee."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from scipy.spatial import cKDTree

from ..geometry.mesh import adjacency, edges


def rings(loop: np.ndarray, triangles: np.ndarray, n_vertices: int, count: int) -> list[np.ndarray]:
    """Return the loop and the next ``count - 1`` rings of vertices around it."""
    joined = adjacency(triangles, n_vertices)
    inside = np.zeros(n_vertices, bool)
    inside[loop] = True
    out = [loop]
    for _ in range(count - 1):
        wider = inside | (joined @ inside.astype(float) > 0)
        out.append(np.flatnonzero(wider & ~inside))
        inside = wider
    return out


@dataclass(frozen=True)
class Contact:
    """The upper and the lower rim of an opening, in n pairs.

    Attributes
    ----------
    upper : (n,) array
        Vertices of the upper rim.
    lower : (n, V) sparse
        Weights of the point of the lower rim under each of them.
    slack : (n,) array
        The gap at rest where it is already negative, mm, and 0 elsewhere.
    spread_up, spread_down : (V, n) sparse
        How a push spreads over the upper and the lower skin.
    share : float
        Part of the push that the upper side takes.
    """

    upper: np.ndarray
    lower: sp.csr_matrix
    slack: np.ndarray
    spread_up: sp.csr_matrix
    spread_down: sp.csr_matrix
    share: float

    def gap(self, vertices: np.ndarray) -> np.ndarray:
        """Return the (n,) heights of the upper rim above the lower one, mm. They are negative where the rims cross."""
        return vertices[self.upper, 1] - self.lower @ vertices[:, 1]

    def push(self, vertices: np.ndarray, opening: np.ndarray) -> None:
        """Open the gaps by ``opening`` (n,) mm, in place. The skin around them follows smoothly."""
        vertices[:, 1] += self.spread_up @ (self.share * opening) - self.spread_down @ ((1 - self.share) * opening)

    def resolve(self, vertices: np.ndarray) -> None:
        """Undo crossings, in place."""
        for _ in range(2):
            crossing = np.maximum(self.slack - self.gap(vertices), 0.0)
            if not crossing.any():
                return
            self.push(vertices, crossing)


def sides(neutral: np.ndarray, triangles: np.ndarray, loop: np.ndarray) -> np.ndarray:
    """Return (V,) numbers: +1 for skin that belongs to the upper half of an opening, -1 for the lower half.

    The loop is cut at its two ends in x. Every other vertex belongs to the half that is nearer along the edges. The height of
    a vertex is not enough, because the rolled-in lips interlock at rest.
    """
    x = neutral[loop, 0]
    i, j = sorted((int(x.argmin()), int(x.argmax())))
    halves = [loop[i:j], np.concatenate([loop[j:], loop[:i]])]
    halves.sort(key=lambda half: neutral[half, 1].mean())
    pairs = edges(triangles)
    lengths = np.linalg.norm(neutral[pairs[:, 0]] - neutral[pairs[:, 1]], axis=1)
    graph = sp.coo_matrix((lengths, pairs.T), (len(neutral), len(neutral))).tocsr()
    low, high = (sp.csgraph.dijkstra(graph, directed=False, indices=half, min_only=True) for half in halves)
    return np.where(high < low, 1, -1)


def make_contact(
    neutral: np.ndarray, side: np.ndarray, rim: np.ndarray, region: np.ndarray, reach: float, share: float
) -> Contact:
    """Pair the upper half of a rim with the lower half.

    Parameters
    ----------
    neutral : (V, 3) array
        The face at rest, mm.
    side : (V,) array
        Half of each vertex, from :func:`sides`.
    rim : array
        Vertices of the rim.
    region : array
        Vertices that may follow a push.
    reach : float
        How far a push spreads, as a standard deviation in mm.
    share : float
        Part of a push that the upper side takes.
    """
    upper, lower = (rim[side[rim] == s] for s in (1, -1))
    upper, lower = upper[np.argsort(neutral[upper, 0])], lower[np.argsort(neutral[lower, 0])]
    under = _interpolation(neutral[lower, 0], neutral[upper, 0], lower, len(neutral))
    rest = neutral[upper, 1] - under @ neutral[:, 1]
    up = _spread(neutral, region[side[region] == 1], neutral[upper], reach)
    down = _spread(neutral, region[side[region] == -1], under @ neutral, reach)
    return Contact(upper, under, np.minimum(rest, 0.0), up, down, share)


def _interpolation(knots: np.ndarray, at: np.ndarray, columns: np.ndarray, n: int) -> sp.csr_matrix:
    right = np.clip(np.searchsorted(knots, at), 1, len(knots) - 1)
    t = np.clip((at - knots[right - 1]) / np.maximum(knots[right] - knots[right - 1], 1e-9), 0, 1)
    rows = np.arange(len(at))
    values, cols = np.concatenate([1 - t, t]), np.concatenate([columns[right - 1], columns[right]])
    return sp.csr_matrix((values, (np.concatenate([rows, rows]), cols)), (len(at), n))


def _spread(neutral: np.ndarray, region: np.ndarray, sources: np.ndarray, reach: float) -> sp.csr_matrix:
    """Return (V, n) weights. Each vertex of the region follows its three nearest sources, and less if they are far away."""
    k = min(3, len(sources))
    distance, nearest = cKDTree(sources).query(neutral[region], k=k)
    distance, nearest = distance.reshape(len(region), k), nearest.reshape(len(region), k)
    weight = 1 / (distance + 0.05)
    weight *= np.exp(-0.5 * (distance[:, :1] / reach) ** 2) / weight.sum(axis=1, keepdims=True)
    keep = np.repeat(distance[:, 0] < 3 * reach, k)
    rows = np.repeat(region, k)[keep]
    return sp.csr_matrix((weight.ravel()[keep], (rows, nearest.ravel()[keep])), (len(neutral), len(sources)))


@dataclass(frozen=True)
class EyeballContact:
    """Makes lids slide over the eyeball: ``vertices`` (n,) stay at least ``radii`` (n,) mm away from ``centre`` (3,)."""

    vertices: np.ndarray
    radii: np.ndarray
    centre: np.ndarray

    def resolve(self, vertices: np.ndarray) -> None:
        """Push lid skin out of the eyeball, in place."""
        arm = vertices[self.vertices] - self.centre
        distance = np.linalg.norm(arm, axis=1)
        factor = np.maximum(self.radii / np.maximum(distance, 1e-9), 1.0)
        vertices[self.vertices] = self.centre + arm * factor[:, None]


def make_eyeball_contact(neutral: np.ndarray, centre: np.ndarray, radius: float, thickness: float) -> EyeballContact:
    """Choose the skin in front of one eyeball. It may come as close as ``thickness`` mm, or as it is at rest."""
    arm = neutral - centre
    distance = np.linalg.norm(arm, axis=1)
    near = np.flatnonzero((distance < radius + 8.0) & (arm[:, 2] > 0))
    return EyeballContact(near, np.minimum(distance[near], radius + thickness), centre)
