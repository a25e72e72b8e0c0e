"""The tracking mesh: half a head remeshed in a pose with the jaw half open, mirrored, as a linear map of the base mesh.

The reference surface is two Catmull-Clark steps of the head's skin. Every tracking vertex is a fixed sparse
combination of base vertices, so one operator carries the mean, every identity and every expression.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import scipy.sparse as sp
from scipy.spatial import cKDTree

from adaptiveface.geometry.mesh import vertex_normals

from .makehuman import MakeHuman
from .reference import Polyline, ReferenceSurface
from .remesher import Remesher
from .skin import CHIN, FOREHEAD_TOP, LIP_CORNER, NOSE_TIP, Skin, head_skin
from .subdivision import catmull_clark, quad_edges

JAW_POSE = 0.5  # keeps the lips apart while remeshing
ITERATIONS = 14
CLOSED = 1e-4  # mm: a base vertex this close to x = 0 lies on the midline


@dataclass(frozen=True)
class TrackingMesh:
    """``operator`` (V, N) sparse: base to tracking vertices; ``triangles`` (T, 3); ``mirror`` (V,) the vertex opposite;
    ``n_frontal`` frontal vertices come first; ``curves``: name -> ordered vertices of the left half (x >= 0)."""

    operator: sp.csr_matrix
    triangles: np.ndarray
    mirror: np.ndarray
    n_frontal: int
    curves: dict[str, np.ndarray]

    def both(self, *names: str) -> np.ndarray:
        """Sorted vertices of some curves on both sides."""
        left = np.concatenate([self.curves[name] for name in names])
        return np.union1d(left, self.mirror[left])


def build_tracking_mesh(base: MakeHuman, rest: np.ndarray) -> TrackingMesh:
    """``rest`` (N, 3) mm: the mean adult on the base mesh, symmetric. Deterministic."""
    half = _HalfHead(base, head_skin(base), rest)
    remesher = Remesher(
        half.vertices,
        half.triangles,
        half.curve_of,
        list(half.polylines.values()),
        half.fixed,
        half.surface,
        _Sizing(base, rest, half),
    )
    points, triangles, curve_of = remesher.run(ITERATIONS)
    operator, on_midline = half.operator(points, triangles, curve_of)
    names = list(half.polylines)
    curves = {
        name: _ordered(half.polylines[name], points, [e for e, c in curve_of.items() if names[c] == name]) for name in names
    }
    return _mirrored(operator, triangles, on_midline, curves, base.mirror, rest)


def frontness(points: np.ndarray, rest: np.ndarray) -> np.ndarray:
    """(n,) negative inside the frontal region, about mm outside: 68 degrees to each side, hairline to chin."""
    axis = rest[NOSE_TIP, 2] - 105
    yaw = np.degrees(np.arctan2(np.abs(points[:, 0]), points[:, 2] - axis))
    above, below = points[:, 1] - rest[FOREHEAD_TOP, 1] - 18, rest[CHIN, 1] - 6 - points[:, 1]
    return np.maximum.reduce([(yaw - 68) * 1.3, above, below, axis + 15 - points[:, 2]])


class _HalfHead:
    """The left half (x >= 0) of the head in the remeshing pose: start mesh, fine surface and kept curves."""

    def __init__(self, base: MakeHuman, skin: Skin, rest: np.ndarray):
        self.rest = rest
        self._subdivide(base, skin)
        quads = skin.quads[rest[skin.quads, 0].mean(axis=1) > 0]
        self.base_ids = np.unique(quads)
        self._local = {int(a): i for i, a in enumerate(self.base_ids)}
        self.vertices = self.fine_points[self.base_ids]
        self.triangles = np.vectorize(self._local.get)(_shorter_diagonals(quads, self.fine_points))
        self.polylines: dict[str, Polyline] = {}
        self.curve_of: dict[tuple, int] = {}
        self.fixed: set[int] = set()
        self._add_curves(skin, quads)

    def _subdivide(self, base: MakeHuman, skin: Skin) -> None:
        first, quads1 = catmull_clark(len(base.vertices), skin.quads)
        second, quads2 = catmull_clark(first.shape[0], quads1)
        self.to_fine = (second @ first).tocsr()
        self._middles = [_middle_of_edge(skin.quads, len(base.vertices)), _middle_of_edge(quads1, first.shape[0])]
        self.fine_points = self.to_fine @ (self.rest + JAW_POSE * base.face_unit("jawOpen"))
        left = quads2[self.fine_points[quads2].mean(axis=1)[:, 0] > 0]
        self.fine_ids, compact = np.unique(left, return_inverse=True)
        compact = compact.reshape(left.shape)
        triangles = np.concatenate([compact[:, [0, 1, 2]], compact[:, [0, 2, 3]]])
        self.surface = ReferenceSurface(self.fine_points[self.fine_ids], triangles)
        self._compact = np.full(len(self.fine_points), -1)
        self._compact[self.fine_ids] = np.arange(len(self.fine_ids))

    def _add_curve(self, name: str, base_chain: list[int]) -> None:
        fine = [base_chain[0]]
        for a, b in pairwise(base_chain):
            middle = self._middles[0][min(a, b), max(a, b)]
            quarters = [self._middles[1][min(x, middle), max(x, middle)] for x in (a, b)]
            fine += [quarters[0], middle, quarters[1], b]
        for a, b in pairwise(base_chain):
            self.curve_of[tuple(sorted((self._local[a], self._local[b])))] = len(self.polylines)
        self.polylines[name] = Polyline(self._compact[fine], self.surface.vertices)
        self.fixed |= {self._local[base_chain[0]], self._local[base_chain[-1]]}

    def _add_curves(self, skin: Skin, quads: np.ndarray) -> None:
        for number, chain in enumerate(self._midline_chains(quads)):
            self._add_curve(f"midline_{number}", chain)
        self._add_curve("neck", self._left_half(skin.neck))
        for name, loop in (("mouth", skin.mouth), ("lip_outer", skin.lip_outer), ("lip_inner", skin.lip_inner)):
            chain = self._left_half(loop)
            corner = LIP_CORNER if LIP_CORNER in chain else max(chain, key=lambda a: self.rest[a, 0])
            at = chain.index(corner)
            parts = {"upper": chain[: at + 1][::-1], "lower": chain[at:]}
            if self.rest[chain[0], 1] < self.rest[chain[-1], 1]:
                parts = {"upper": chain[at:], "lower": chain[: at + 1][::-1]}
            for lip, part in parts.items():  # from the corner to the midline
                self._add_curve(f"{name}_{lip}", part)
        self._add_lid_curves(skin.left_lid)

    def _add_lid_curves(self, loop: list[int]) -> None:
        """Both margins from the outer to the inner canthus."""
        inner, outer = (pick(loop, key=lambda a: self.rest[a, 0]) for pick in (min, max))
        start = loop.index(outer)
        rolled = loop[start:] + loop[:start]
        at = rolled.index(inner)
        sides = [rolled[: at + 1], [outer, *rolled[at:][::-1]]]
        sides.sort(key=lambda chain: self.rest[chain, 1].mean())
        self._add_curve("lid_lower", sides[0])
        self._add_curve("lid_upper", sides[1])

    def _left_half(self, loop: list[int]) -> list[int]:
        """The part with x >= 0 of a closed loop that crosses the midline twice, as an open chain."""
        left = [self.rest[a, 0] > -CLOSED for a in loop]
        start = next(i for i in range(len(loop)) if left[i] and not left[i - 1])
        rolled = loop[start:] + loop[:start]
        return [a for a in rolled if self.rest[a, 0] > -CLOSED]

    def _midline_chains(self, quads: np.ndarray) -> list[list[int]]:
        """The half's border along x = 0: forehead to upper lip and lower lip to neck, and round the back."""
        edges, _, count = quad_edges(quads)
        border = edges[count == 1]
        border = border[(np.abs(self.rest[border, 0]) < CLOSED).all(axis=1)]
        neighbours = defaultdict(list)
        for a, b in border.tolist():
            neighbours[a].append(b)
            neighbours[b].append(a)
        chains, ends = [], sorted(a for a in neighbours if len(neighbours[a]) == 1)
        while ends:
            chain = [ends.pop(0)]
            while following := [a for a in neighbours[chain[-1]] if a not in chain[-2:]]:
                chain.append(following[0])
            ends.remove(chain[-1])
            chains.append(chain)
        return chains

    def operator(self, points: np.ndarray, triangles: np.ndarray, curve_of: dict) -> tuple[sp.csr_matrix, np.ndarray]:
        """(V, N) base vertices -> remeshed half, and (V,) bool: on the midline (there x stays exactly 0)."""
        names = list(self.polylines)
        curves = defaultdict(set)
        for edge, curve in sorted(curve_of.items()):
            for a in edge:
                curves[a].add(curve)
        triangle, weights = self.surface.locate(points, vertex_normals(points, triangles))
        corners = self.surface.triangles[triangle]
        for a, numbers in curves.items():
            middle = [c for c in sorted(numbers) if names[c].startswith("midline")]
            polyline = self.polylines[names[middle[0] if middle else min(numbers)]]
            i, t = polyline.locate(points[a])
            corners[a] = [polyline.ids[i], polyline.ids[i + 1], polyline.ids[i]]
            weights[a] = [1 - t, t, 0]
        rows = np.arange(len(points)).repeat(3)
        columns = self.fine_ids[corners].ravel()
        from_fine = sp.csr_matrix((weights.ravel(), (rows, columns)), (len(points), len(self.fine_points)))
        on_midline = np.array([any(names[c].startswith("midline") for c in curves.get(a, ())) for a in range(len(points))])
        return (from_fine @ self.to_fine).tocsr(), on_midline


class _Sizing:
    """Wanted edge length: 4.25 mm in front, growing to 7.2 behind; finer at lips, lids, nostrils and ears."""

    def __init__(self, base: MakeHuman, rest: np.ndarray, half: _HalfHead):
        self.rest = rest
        pose = half.fine_points
        lips = np.concatenate([p.points for n, p in half.polylines.items() if n.startswith("lip")])
        lids = np.concatenate([p.points for n, p in half.polylines.items() if n.startswith("lid")])
        at = rest[half.base_ids]
        nose = half.base_ids[(np.abs(at - rest[NOSE_TIP] - [0, -10, -10]) < [23, 16, 20]).all(axis=1)]
        ear = np.linalg.norm(base.target("ears/l-ear-scale-incr")[half.base_ids], axis=1) > 3
        self.fine = [
            (cKDTree(lips), 2.2, 0.12),
            (cKDTree(lids), 2.0, 0.12),
            (cKDTree(pose[nose]), 2.6, 0.12),
            (cKDTree(pose[half.base_ids[ear]]), 3.5, 0.20),
        ]

    def __call__(self, points: np.ndarray) -> np.ndarray:
        size = np.minimum(4.25 + 0.10 * np.clip(frontness(points, self.rest), 0, None), 7.2)
        for tree, finest, growth in self.fine:
            size = np.minimum(size, finest + growth * tree.query(points)[0])
        return size


def _middle_of_edge(quads: np.ndarray, n_vertices: int) -> dict[tuple[int, int], int]:
    """Edge (a, b), a < b, -> the subdivided mesh's vertex in its middle."""
    return {(a, b): n_vertices + i for i, (a, b) in enumerate(quad_edges(quads)[0].tolist())}


def _shorter_diagonals(quads: np.ndarray, points: np.ndarray) -> np.ndarray:
    length = [np.linalg.norm(points[quads[:, k]] - points[quads[:, k + 2]], axis=1) for k in (0, 1)]
    first, second = quads[length[0] <= length[1]], quads[length[0] > length[1]]
    return np.concatenate([first[:, [0, 1, 2]], first[:, [0, 2, 3]], second[:, [0, 1, 3]], second[:, [1, 2, 3]]])


def _ordered(polyline: Polyline, points: np.ndarray, edges: list[tuple]) -> np.ndarray:
    """Vertices of a curve in the order of its polyline."""
    vertices = sorted({a for edge in edges for a in edge})
    return np.array(sorted(vertices, key=lambda a: sum(polyline.locate(points[a]))))


def _mirrored(half, triangles, on_midline, curves, base_mirror, rest) -> TrackingMesh:
    """Both halves, exactly symmetric, frontal vertices first."""
    n = half.shape[0]
    swap = sp.csr_matrix((np.ones(len(base_mirror)), (np.arange(len(base_mirror)), base_mirror)))
    right = np.flatnonzero(~on_midline)
    mirror = np.arange(n)
    mirror[right] = n + np.arange(len(right))
    operator = sp.vstack([half, (half @ swap)[right]]).tocsr()
    triangles = np.concatenate([triangles, mirror[triangles][:, ::-1]])
    mirror = np.concatenate([mirror, right])
    operator = 0.5 * (operator + (operator @ swap)[mirror])
    operator.data[np.abs(operator.data) < 1e-7] = 0
    operator.eliminate_zeros()
    frontal = frontness(operator @ rest, rest) < 0
    order = np.argsort(~frontal, kind="stable")
    rank = np.argsort(order)
    return TrackingMesh(
        operator.tocsr()[order],
        rank[triangles],
        rank[mirror][order],
        int(frontal.sum()),
        {name: rank[chain] for name, chain in curves.items()},
    )
