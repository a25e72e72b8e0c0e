"""Make lids and lips touch instead of crossing, which a sum of expressions cannot guarantee."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from scipy.spatial import cKDTree

from ..geometry.mesh import adjacency, edges


def rings(loop: np.ndarray, triangles: np.ndarray, n_vertices: int, count: int) -> list[np.ndarray]:
    """The loop and the next ``count - 1`` rings of vertices around it."""
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

    upper (n,) vertices; lower (n, V) sparse: the point of the lower rim under each of them; slack (n,) mm: the gap at
    rest where it is negative already; spread_up, spread_down (V, n) sparse: how a push spreads over upper and lower
    skin; share: part of the push that the upper side takes.
    """

    upper: np.ndarray
    lower: sp.csr_matrix
    slack: np.ndarray
    spread_up: sp.csr_matrix
    spread_down: sp.csr_matrix
    share: float

    def gap(self, vertices: np.ndarray) -> np.ndarray:
        """(n,) mm by which the upper rim lies above the lower one; negative where they cross."""
        return vertices[self.upper, 1] - self.lower @ vertices[:, 1]

    def push(self, vertices: np.ndarray, opening: np.ndarray) -> None:
        """Open the gaps by ``opening`` (n,) mm, in place; the skin around follows smoothly."""
        vertices[:, 1] += self.spread_up @ (self.share * opening) - self.spread_down @ ((1 - self.share) * opening)

    def resolve(self, vertices: np.ndarray) -> None:
        """Undo crossings, in place."""
        for _ in range(2):
            crossing = np.maximum(self.slack - self.gap(vertices), 0.0)
            if not crossing.any():
                return
            self.push(vertices, crossing)


def sides(neutral: np.ndarray, triangles: np.ndarray, loop: np.ndarray) -> np.ndarray:
    """(V,) +1 for skin that belongs to the upper half of an opening, -1 for the lower half.

    The loop is cut at its two ends in x; other vertices belong to the half that is nearer along the edges. Height alone
    does not tell: at rest the rolled-in lips interlock.
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
    """Pair the upper with the lower half of a rim.

    neutral (V, 3) mm; side (V,): see :func:`sides`; rim: its vertices; region: vertices that may follow a push; reach:
    how far it spreads, mm (standard deviation); share: part of a push that the upper side takes.
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
    """(V, n): each vertex of the region follows its three nearest sources, less with distance."""
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
    """Lids slide over the eyeball: vertices (n,) stay at least ``radii`` (n,) mm from ``centre`` (3,)."""

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
    """Skin in front of one eyeball; it may come as close as ``thickness`` mm, or as it is at rest."""
    arm = neutral - centre
    distance = np.linalg.norm(arm, axis=1)
    near = np.flatnonzero((distance < radius + 8.0) & (arm[:, 2] > 0))
    return EyeballContact(near, np.minimum(distance[near], radius + thickness), centre)
