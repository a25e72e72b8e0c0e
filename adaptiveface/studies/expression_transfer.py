"""Follow deformation transfer: correspondence, the matrix and its factor, and what is not transferred (section 3)."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from ..geometry.mesh import surface_points, triangle_normals
from ..model.actor import Actor
from ..model.blendshapes import STILL, deformation_gradients, gradient_operator
from ..model.face_model import FaceModel, embedded_face_model

#: Numbers of the features in the middle of the upper and the lower lid of each eye.
LIDS = {"eyeBlinkRight": ((9, 13), (10, 12)), "eyeBlinkLeft": ((15, 19), (16, 18))}


@dataclass(frozen=True)
class System:
    """The linear system of deformation transfer over the n vertices that move.

    Attributes
    ----------
    matrix : (n, n) sparse
        G^T A G.
    order : (n,)
        The solver's order of the vertices, which reduces the fill.
    factor : (n, n) sparse
        The lower factor in that order.
    factorising, substituting : float
        Time for the factor, and for x, y and z of all expressions, s.
    """

    matrix: sp.csr_matrix
    order: np.ndarray
    factor: sp.csc_matrix
    factorising: float
    substituting: float


class ExpressionTransfer:
    """Deformation transfer of the average head's expressions to an actor's head.

    Parameters
    ----------
    actor : Actor
        Has the head to which the expressions are transferred, with the model's triangles.
    model : FaceModel, optional
        Has the expressions; the embedded model by default.
    """

    def __init__(self, actor: Actor, model: FaceModel | None = None) -> None:
        self.actor, self.model = actor, model or embedded_face_model()
        self.names = list(self.model.generic_names)

    def change(self, name: str) -> np.ndarray:
        """(T, 3, 3) deformation gradients S of the average head's triangles in an expression."""
        model = self.model
        return deformation_gradients(model.mean, model.mean + self.shape(name), model.triangles)

    def turned(self, name: str) -> np.ndarray:
        """(T,) angle of every triangle's rotation in an expression, degrees."""
        rotation = np.linalg.svd(self.change(name))
        trace = np.trace(rotation[0] @ rotation[2], axis1=1, axis2=2)
        return np.degrees(np.arccos(np.clip((trace - 1) / 2, -1, 1)))

    def telling_triangle(self, name: str) -> int:
        """Number of the triangle that changes most in an expression, among the larger ones that face the front."""
        triangles = self.model.triangles
        normal = triangle_normals(self.model.mean, triangles)
        size = np.linalg.norm(normal, axis=1)
        frontal = self.actor.frontal[triangles].all(axis=1)
        shown = frontal & (normal[:, 2] > 0.7 * size) & (size > np.median(size[frontal]))
        change = np.linalg.norm(self.change(name) - np.eye(3), axis=(1, 2))
        return int(np.where(shown, change, -1.0).argmax())

    def system(self) -> System:
        """Factorise the matrix of the transfer to this head, without the anchor of ``model/blendshapes.py``."""
        shapes = self.model.generic_expressions
        moving = np.flatnonzero(np.linalg.norm(shapes, axis=2).max(axis=0) > STILL)
        touched = self.model.triangles[np.isin(self.model.triangles, moving).any(axis=1)]
        gradient, area = gradient_operator(self.actor.neutral, touched)
        matrix = (gradient.T @ sp.diags(np.repeat(area, 3)) @ gradient)[moving][:, moving].tocsc()
        start = time.perf_counter()
        solver = splu(matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
        middle = time.perf_counter()
        solver.solve(np.ones((len(moving), 3 * len(shapes))))
        order = np.argsort(solver.perm_c)
        return System(matrix.tocsr(), order, solver.L, middle - start, time.perf_counter() - middle)

    def gap(self, name: str, transferred: bool = True) -> tuple[float, float]:
        """Measure the gap between the lids in a blink.

        Parameters
        ----------
        name : str
            One of ``LIDS``.
        transferred : bool
            False copies the average head's displacements vertex by vertex instead of transferring them.

        Returns
        -------
        (float, float)
            The gaps of the average head and of this one, mm.
        """
        shape = self.actor.blendshapes[self.names.index(name)] if transferred else self.shape(name)
        heads = self.model.mean + self.shape(name), self.actor.neutral + shape
        at = self.model.feature_triangles, self.model.feature_weights
        average, own = (surface_points(head, *at) for head in heads)
        return _gap(average, name), _gap(own, name)

    def shape(self, name: str) -> np.ndarray:
        """(V, 3) displacements of the average head in an expression, mm."""
        return self.model.generic_expressions[self.names.index(name)]


def _gap(marks: np.ndarray, name: str) -> float:
    """Mean distance between the lids of an eye, mm, given the features (40, 3) mm; ``name`` is one of ``LIDS``."""
    return float(np.mean([np.linalg.norm(marks[a] - marks[b]) for a, b in LIDS[name]]))
