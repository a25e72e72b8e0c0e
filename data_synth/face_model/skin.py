"""The part of MakeHuman's body that is tracked: the head's skin, with openings at eyes, mouth and neck.

Edge loops are followed straight across vertices of valence four, starting from a vertex known by its number.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass

import numpy as np

from .makehuman import MakeHuman

# Base vertices that name the loops.
NOSE_TIP, LIP_OUTER, LIP_INNER, MOUTH_OPENING, NECK = 297, 455, 474, 520, 809
LEFT_LID = 6785  # the lid margin's front edge: the shelf behind it is thinner than the tracking mesh can hold
LIP_CORNER = 7162
FOREHEAD_TOP, CHIN = 251, 5296


@dataclass(frozen=True)
class Skin:
    """``quads`` (Q, 4) of the base mesh; the loops as ordered base vertices; ``left_lid`` is the subject's left eye."""

    quads: np.ndarray
    lip_outer: list[int]
    lip_inner: list[int]
    mouth: list[int]
    neck: list[int]
    left_lid: list[int]


class LoopFinder:
    """Adjacency of a quad mesh."""

    def __init__(self, quads: np.ndarray, vertices: np.ndarray):
        self.vertices = vertices
        self.neighbours: dict[int, set] = defaultdict(set)
        self.quads_of: dict[int, set] = defaultdict(set)
        for number, quad in enumerate(quads.tolist()):
            for k in range(4):
                self.neighbours[quad[k]] |= {quad[k - 1], quad[(k + 1) % 4]}
                self.quads_of[quad[k]].add(number)

    def _straight(self, before: int, at: int) -> int | None:
        ahead = [x for x in self.neighbours[at] if x != before and not (self.quads_of[x] & self.quads_of[before])]
        return ahead[0] if len(self.neighbours[at]) == 4 and len(ahead) == 1 else None

    def loop(self, start: int, limit: int = 80) -> list[int]:
        """The closed edge loop through ``start``, first step towards the subject's left (+x)."""
        for first in sorted(self.neighbours[start], key=lambda x: -self.vertices[x, 0]):
            path = [start, first]
            while len(path) < limit:
                following = self._straight(path[-2], path[-1])
                if following is None:
                    break
                if following == start:
                    return path
                path.append(following)
        raise ValueError(f"no closed edge loop through base vertex {start}")


def head_skin(base: MakeHuman) -> Skin:
    """Cut the head out of the body along the neck, mouth and lid loops."""
    body = base.faces("body")
    finder = LoopFinder(body, base.vertices)
    mouth, neck, left_lid = finder.loop(MOUTH_OPENING), finder.loop(NECK), finder.loop(LEFT_LID)
    walls = {frozenset(edge) for loop in (mouth, neck, left_lid) for edge in closed_edges(loop)}
    walls |= {frozenset(edge) for edge in closed_edges([int(base.mirror[x]) for x in left_lid])}
    quads = body[sorted(_flood(body, finder, walls))]
    return Skin(quads, finder.loop(LIP_OUTER), finder.loop(LIP_INNER), mouth, neck, left_lid)


def closed_edges(loop: list[int]) -> list[tuple[int, int]]:
    """Edges of a closed loop."""
    return list(zip(loop, loop[1:] + loop[:1], strict=True))


def _flood(quads: np.ndarray, finder: LoopFinder, walls: set) -> set[int]:
    """Quads reached from the nose tip without crossing a wall edge."""
    sides: dict[frozenset, list[int]] = defaultdict(list)
    for number, quad in enumerate(quads.tolist()):
        for edge in closed_edges(quad):
            sides[frozenset(edge)].append(number)
    stack = [min(finder.quads_of[NOSE_TIP])]
    reached = set(stack)
    while stack:
        for edge in closed_edges(quads[stack.pop()].tolist()):
            if frozenset(edge) in walls:
                continue
            for other in sides[frozenset(edge)]:
                if other not in reached:
                    reached.add(other)
                    stack.append(other)
    return reached
