"""Isotropic remeshing with kept curves: split, collapse, Delaunay flip, tangential relaxation, re-projection.

After Botsch & Kobbelt 2004 with a sizing field; boundary and feature curves are kept: their vertices slide along
their own polyline only. Small meshes (some thousand vertices) in half a minute of plain Python.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable

import numpy as np
from tqdm import tqdm

from adaptiveface.geometry.mesh import vertex_normals

from .reference import Polyline, ReferenceSurface

SPLIT_ABOVE, COLLAPSE_BELOW, NEVER_ABOVE = 1.33, 0.75, 1.4  # in target edge lengths
RELAXATION, CURVE_RELAXATION = 0.7, 0.35


class Remesher:
    """Edits ``vertices`` (V, 3) and ``triangles`` (T, 3) in place; :meth:`run` returns the result.

    ``curve_of`` maps an edge (a, b), a < b, to the number of its ``polylines`` entry; ``fixed`` vertices never move.
    ``size`` gives the wanted edge length (n,) mm at points (n, 3).
    """

    def __init__(
        self,
        vertices,
        triangles,
        curve_of: dict,
        polylines: list[Polyline],
        fixed: set[int],
        surface: ReferenceSurface,
        size: Callable[[np.ndarray], np.ndarray],
    ):
        self.points = [np.array(p, float) for p in vertices]
        self.faces = {i: tuple(f) for i, f in enumerate(np.asarray(triangles).tolist())}
        self.next_face = len(self.faces)
        self.faces_of: dict[int, set] = defaultdict(set)
        for number, face in self.faces.items():
            for a in face:
                self.faces_of[a].add(number)
        self.curve_of = dict(curve_of)
        self.curve_edges: dict[int, set] = defaultdict(set)
        for edge in self.curve_of:
            for a in edge:
                self.curve_edges[a].add(edge)
        self.polylines, self.fixed, self.surface, self.size = polylines, set(fixed), surface, size
        self._size_at: dict[int, float] = {}

    def run(self, iterations: int) -> tuple[np.ndarray, np.ndarray, dict]:
        """(V, 3) vertices, (T, 3) triangles and the curve number of every kept edge (a, b), a < b."""
        for _ in tqdm(range(iterations), desc="remeshing"):
            self._split_long_edges()
            self._collapse_short_edges()
            for _ in range(3):
                self._flip_edges()
            for _ in range(3):
                self._relax()
            self._size_at.clear()
        used, vertices, triangles = self._compact()
        number = {a: i for i, a in enumerate(used)}
        curves = {tuple(sorted(number[a] for a in edge)): c for edge, c in self.curve_of.items()}
        return vertices, triangles, curves

    # -- small questions ------------------------------------------------------------------------------------------

    def _edges(self) -> list[tuple[int, int]]:
        return sorted({_edge(f[k], f[k - 1]) for f in self.faces.values() for k in range(3)})

    def _length(self, a: int, b: int) -> float:
        return float(np.linalg.norm(self.points[a] - self.points[b]))

    def _target(self, a: int, b: int) -> float:
        for x in (a, b):
            if x not in self._size_at:
                self._size_at[x] = float(self.size(self.points[x][None])[0])
        return 0.5 * (self._size_at[a] + self._size_at[b])

    # -- small edits ----------------------------------------------------------------------------------------------

    def _add_face(self, face: tuple) -> None:
        self.faces[self.next_face] = face
        for a in face:
            self.faces_of[a].add(self.next_face)
        self.next_face += 1

    def _remove_face(self, number: int) -> tuple:
        face = self.faces.pop(number)
        for a in face:
            self.faces_of[a].discard(number)
        return face

    def _add_curve_edge(self, a: int, b: int, curve: int) -> None:
        edge = _edge(a, b)
        self.curve_of[edge] = curve
        self.curve_edges[a].add(edge)
        self.curve_edges[b].add(edge)

    def _remove_curve_edge(self, edge: tuple) -> int:
        for a in edge:
            self.curve_edges[a].discard(edge)
        return self.curve_of.pop(edge)

    # -- split ----------------------------------------------------------------------------------------------------

    def _split_long_edges(self) -> None:
        for _, a, b in sorted(((self._length(a, b), a, b) for a, b in self._edges()), reverse=True):
            if self._length(a, b) >= SPLIT_ABOVE * self._target(a, b):
                self._split(a, b)

    def _split(self, a: int, b: int) -> None:
        shared = sorted(self.faces_of[a] & self.faces_of[b])
        middle = len(self.points)
        self.points.append(0.5 * (self.points[a] + self.points[b]))
        if (a, b) in self.curve_of:
            curve = self._remove_curve_edge((a, b))
            self.points[middle] = self.polylines[curve].closest(self.points[middle])
            self._add_curve_edge(a, middle, curve)
            self._add_curve_edge(middle, b, curve)
        for number in shared:
            face = self._remove_face(number)
            for replaced in (a, b):
                self._add_face(tuple(middle if x == replaced else x for x in face))

    # -- collapse -------------------------------------------------------------------------------------------------

    def _collapse_short_edges(self) -> None:
        for _, a, b in sorted((self._length(a, b), a, b) for a, b in self._edges()):
            if self.faces_of[a] & self.faces_of[b] and self._length(a, b) <= COLLAPSE_BELOW * self._target(a, b):
                self._try_collapse(a, b)

    def _removable(self, a: int, along_curve: bool) -> bool:
        """Free vertices may go; vertices of one curve only along it; ends and crossings of curves stay."""
        n = len(self.curve_edges[a])
        return a not in self.fixed and (n == 0 or (along_curve and n == 2))

    def _try_collapse(self, a: int, b: int) -> None:
        curve = self.curve_of.get((a, b))
        free_a, free_b = (self._removable(x, curve is not None) for x in (a, b))
        if not (free_a or free_b):
            return
        if free_a and (not free_b or len(self.curve_edges[a]) <= len(self.curve_edges[b])):
            a, b = b, a  # b goes, a stays
        merged = self.points[a]
        if free_a and free_b and len(self.curve_edges[a]) == len(self.curve_edges[b]):
            merged = 0.5 * (self.points[a] + self.points[b])
            if curve is not None:
                merged = self.polylines[curve].closest(merged)
        if self._collapse_is_safe(a, b, merged):
            self._collapse(a, b, merged)

    def _collapse_is_safe(self, a: int, b: int, merged: np.ndarray) -> bool:
        shared = self.faces_of[a] & self.faces_of[b]
        ring_a, ring_b = ({x for f in self.faces_of[y] for x in self.faces[f]} - {y} for y in (a, b))
        if len(ring_a & ring_b) != len(shared):  # link condition: the result stays a manifold
            return False
        for number in sorted((self.faces_of[a] | self.faces_of[b]) - shared):
            face = self.faces[number]
            before = [self.points[x] for x in face]
            after = [merged if x in (a, b) else self.points[x] for x in face]
            n0, n1 = _normal(*before), _normal(*after)
            if n0 @ n1 < 0.5 * np.linalg.norm(n0) * np.linalg.norm(n1) or np.linalg.norm(n1) < 1e-6:
                return False
            if any(
                np.linalg.norm(after[k] - after[k - 1]) > NEVER_ABOVE * self._target(face[k], face[k - 1]) for k in range(3)
            ):
                return False
        return True

    def _collapse(self, a: int, b: int, merged: np.ndarray) -> None:
        if _edge(a, b) in self.curve_of:
            self._remove_curve_edge(_edge(a, b))
            for edge in sorted(self.curve_edges[b]):
                curve = self._remove_curve_edge(edge)
                self._add_curve_edge(a, edge[0] if edge[1] == b else edge[1], curve)
        for number in sorted(self.faces_of[b]):
            face = self._remove_face(number)
            if a not in face:
                self._add_face(tuple(a if x == b else x for x in face))
        self.points[a] = merged
        self._size_at.pop(a, None)

    # -- flip -----------------------------------------------------------------------------------------------------

    def _flip_edges(self) -> None:
        for a, b in self._edges():
            shared = sorted(self.faces_of[a] & self.faces_of[b])
            if len(shared) == 2 and (a, b) not in self.curve_of:
                self._try_flip(a, b, shared)

    def _try_flip(self, a: int, b: int, shared: list[int]) -> None:
        first, second = (self.faces[f] for f in shared)
        c, d = (next(x for x in face if x not in (a, b)) for face in (first, second))
        if c == d or self.faces_of[c] & self.faces_of[d] or min(len(self.faces_of[a]), len(self.faces_of[b])) <= 3:
            return
        if self._angle(c, a, b) + self._angle(d, a, b) <= np.pi + 1e-3:
            return
        if first[(first.index(a) + 1) % 3] != b:
            a, b = b, a
        flipped = ((c, a, d), (d, b, c))
        mean = sum(_normal(*(self.points[x] for x in face)) for face in (first, second))
        for face in flipped:
            normal = _normal(*(self.points[x] for x in face))
            if normal @ mean < 0.3 * np.linalg.norm(normal) * np.linalg.norm(mean):
                return
        for number, face in zip(shared, flipped, strict=True):
            self._remove_face(number)
            self._add_face(face)

    def _angle(self, at: int, p: int, q: int) -> float:
        u, v = self.points[p] - self.points[at], self.points[q] - self.points[at]
        return float(np.arctan2(np.linalg.norm(np.cross(u, v)), u @ v))

    # -- relax ----------------------------------------------------------------------------------------------------

    def _compact(self) -> tuple[list[int], np.ndarray, np.ndarray]:
        used = sorted(a for a, faces in self.faces_of.items() if faces)
        number = {a: i for i, a in enumerate(used)}
        triangles = np.array([[number[a] for a in face] for face in self.faces.values()])
        return used, np.array([self.points[a] for a in used]), triangles

    def _relax(self) -> None:
        """Move free vertices to the size-weighted centroid of their triangles, in the surface; slide curve vertices."""
        used, points, triangles = self._compact()
        normals = vertex_normals(points, triangles)
        centres = points[triangles].mean(axis=1)
        a, b, c = (points[triangles[:, k]] for k in range(3))
        weight = np.linalg.norm(np.cross(b - a, c - a), axis=1) / self.size(centres) ** 2
        total = np.bincount(triangles.ravel(), weight.repeat(3), len(points))
        centroid = (
            np.stack(
                [np.bincount(triangles.ravel(), (weight * centres[:, k]).repeat(3), len(points)) for k in range(3)], axis=1
            )
            / total[:, None]
        )
        step = centroid - points
        step -= (step * normals).sum(axis=1, keepdims=True) * normals
        free = np.array([x not in self.fixed and not self.curve_edges[x] for x in used])
        moved = points + RELAXATION * step
        moved[free] = self.surface.closest(moved[free], normals[free])
        for i, x in enumerate(used):
            if free[i]:
                self.points[x] = moved[i]
            elif x not in self.fixed and len(self.curve_edges[x]) == 2:
                self._slide(x)

    def _slide(self, x: int) -> None:
        """Shift a curve vertex so that its two edges agree with the sizing field."""
        edges = sorted(self.curve_edges[x])
        ends = [e[0] if e[1] == x else e[1] for e in edges]
        scaled = [self._length(x, end) / self._target(end, end) for end in ends]
        balance = CURVE_RELAXATION * (scaled[0] - scaled[1]) / (scaled[0] + scaled[1] + 1e-9)
        towards = self.points[ends[0 if balance > 0 else 1]] - self.points[x]
        self.points[x] = self.polylines[self.curve_of[edges[0]]].closest(self.points[x] + abs(balance) * towards)


def _edge(a: int, b: int) -> tuple[int, int]:
    return (a, b) if a < b else (b, a)


def _normal(p, q, r) -> np.ndarray:
    return np.cross(q - p, r - p)
