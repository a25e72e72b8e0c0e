"""Exercise of notebook 01: how far the affine maps of a deformation graph are from rotations (Sumner et al. 2007)."""

from __future__ import annotations

import numpy as np

from .grading import Case, Exercise, Mistake, as_array, drawn, switched
from .pairs import close


@drawn(seed=13, count=6)
def cases(rng: np.random.Generator, number: int) -> Case:
    """Maps near and far from rotations."""
    g = int(rng.integers(5, 40))
    rotations = np.linalg.qr(rng.normal(size=(g, 3, 3)))[0]
    return dict(maps=rotations + (0.02 + 0.15 * number) * rng.normal(size=(g, 3, 3)))


def rigidity(maps, rows=False, cross=1.0, length=1.0, square=True, root=False, unit=1.0):
    """The package's answer, and by its switches what goes wrong."""
    gram = maps @ maps.transpose(0, 2, 1) if rows else maps.transpose(0, 2, 1) @ maps
    own = np.einsum("gii->gi", gram)
    own = np.sqrt(own) if root else own
    angles = np.stack([gram[:, 0, 1], gram[:, 0, 2], gram[:, 1, 2]], axis=1)
    power = np.square if square else np.abs
    return cross * power(angles).sum(axis=1) + length * power(unit - own).sum(axis=1)


def parse(answer, case: Case) -> np.ndarray:
    """(g,)."""
    return as_array(answer, (len(case["maps"]),), "the energy")


def _to_polar(maps):
    u, _, vt = np.linalg.svd(maps)
    return ((maps - u @ vt) ** 2).sum(axis=(1, 2))


_by = switched(rigidity)
MISTAKES = (
    Mistake("the rows of the maps are compared: the energy is about their columns", _by(rows=True)),
    Mistake("the angles between the columns do not enter: a sheared map counts as a rotation", _by(cross=0.0)),
    Mistake("the lengths of the columns do not enter: a map that scales counts as a rotation", _by(length=0.0)),
    Mistake("every angle counts twice: |A^T A - I|^2 holds each pair of columns two times", _by(cross=2.0)),
    Mistake("the terms are not squared: absolute values have no slope at the minimum", _by(square=False)),
    Mistake("the lengths enter instead of their squares: 1 - a.a is a polynomial, 1 - |a| needs a root", _by(root=True)),
    Mistake("the 1 is missing: the energy asks for columns of length 0", _by(unit=0.0)),
    Mistake(
        "the distance to the identity is taken: a turned node would be punished",
        lambda maps: ((maps - np.eye(3)) ** 2).sum(axis=(1, 2)),
    ),
    Mistake(
        "the determinant is compared with 1: a map may stretch one way, shrink another, and keep it",
        lambda maps: (1 - np.linalg.det(maps)) ** 2,
    ),
    Mistake("the distance to the nearest rotation is taken: near it, but not this energy", _to_polar),
    Mistake(
        "the energies of all nodes are added up: one value per node is asked for",
        lambda maps: np.full(len(maps), rigidity(maps).sum()),
    ),
)

RIGIDITY_ENERGY = Exercise(
    "rigidity",
    "01_neutral_scan",
    task=(
        "rigidity(maps): (g, 3, 3) affine maps A of g graph nodes, with columns a1, a2, a3 -> (g,) the energy of each, "
        "(a1.a2)^2 + (a1.a3)^2 + (a2.a3)^2 + (1 - a1.a1)^2 + (1 - a2.a2)^2 + (1 - a3.a3)^2. It is zero only for rotations "
        "(and reflections)."
    ),
    hints=(
        "What do the columns of a rotation look like? Their lengths and the angles between them say it all.",
        "A^T A holds the scalar products of the columns. Use each pair once, and the difference from 1 of each length squared.",
        "with G = A^T A: G12^2 + G13^2 + G23^2 + (1 - G11)^2 + (1 - G22)^2 + (1 - G33)^2.",
    ),
    mistakes=MISTAKES,
    cases=cases,
    truth=rigidity,
    parse=parse,
    near=close,
)
