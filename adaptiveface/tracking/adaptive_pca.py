"""Adapt a PCA model while tracking (sections 4.3 and 5): anchors, correctives, incremental EM-PCA (Roweis 1998).

Vectors are displacements of the n frontal vertices from the neutral, flattened to 3n, in millimetres.
Nothing is learned outside the frontal region. Anchors are combinations of the blendshapes and continue there as the same
combinations. A corrective, which is a displacement minus its anchor part, continues there as minus that anchor part. Therefore
the projected mesh has no seam.
"""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import dataclass
from typing import Self

import numpy as np

from ..caches.compiled import compiled
from ..model.actor import Actor
from ..parameters import AdaptivePcaParameters
from .sample_buffer import redundant_sample
from .types import SampleState

#: Number of vertices for which the paper's thresholds hold, in centimetres.
PAPER_VERTICES, MM_PER_CM = 3480, 10.0

#: A corrective with less than this share of the samples' energy is lost in the buffer's single precision.
LEAST_SHARE = 1e-7


def anchor_shapes(blendshapes: np.ndarray, tolerance: float = 1e-6) -> tuple[np.ndarray, np.ndarray]:
    """Principal components of the blendshapes, B B^T = M_A D M_A^T (section 5).

    B (A, 3n) one blendshape per row -> M_A (3n, a) orthonormal and C (a, A) with M_A = B^T C^T. Directions with less than
    ``tolerance`` of the largest singular value are left out.
    """
    u, s, vt = np.linalg.svd(blendshapes, full_matrices=False)
    keep = s > tolerance * s[0]
    return np.ascontiguousarray(vt[keep].T), (u[:, keep] / s[keep]).T


def orthonormalise(basis: np.ndarray) -> np.ndarray:
    """Q (3n, k) of the factorisation basis = Q R, from a Cholesky factor of the Gram matrix, which is fast for tall matrices.

    Its error grows with the squared condition number, so ill-conditioned bases get a second pass (CholeskyQR2, Yamamoto
    et al. 2015). Q is stored shape by shape (Fortran order).
    """
    lower = np.linalg.cholesky(basis.T @ basis)
    rows = np.linalg.inv(lower) @ basis.T
    scale = np.abs(np.diag(lower))
    if scale.max() >= 30.0 * scale.min():
        rows = np.linalg.inv(np.linalg.cholesky(rows @ rows.T)) @ rows
    q: np.ndarray = rows.T
    return q


def e_step(correctives: np.ndarray, samples: np.ndarray) -> np.ndarray:
    """Y = (M^T M)^-1 M^T S (section 5, step 1): M (3n, k), S (3n, s) -> Y (k, s)."""
    return np.linalg.solve(correctives.T @ correctives, correctives.T @ samples)


def m_step(samples: np.ndarray, coefficients: np.ndarray) -> np.ndarray:
    """M = S Y^T (Y Y^T)^-1 (section 5, step 2): S (3n, s), Y (k, s) -> M (3n, k)."""
    return np.linalg.solve(coefficients @ coefficients.T, coefficients @ samples.T).T


def em_in_sample_space(gram: np.ndarray, coefficients: np.ndarray, steps: int) -> np.ndarray:
    """Run ``steps`` EM iterations with M = S Z stored as Z, so that no step has a cost in 3n.

    ``gram`` (s, s) is S^T S, and ``coefficients`` (k, s) are the first E-step's Y for the current orthonormal Z is (s, k).
    With M = S Z, the E-step is Y = (Z^T G Z)^-1 Z^T G and the M-step Z = Y^T (Y Y^T)^-1: the same iterates as
    :func:`e_step` and :func:`m_step` (a test compares them).
    """
    y = coefficients
    z = y.T @ np.linalg.inv(y @ y.T)
    for _ in range(steps - 1):
        products = z.T @ gram
        y = np.linalg.inv(products @ z) @ products
        z = y.T @ np.linalg.inv(y @ y.T)
    return z


@compiled
def _lengths(vectors: np.ndarray) -> np.ndarray:
    """Lengths (n,) of ``vectors`` (n, 3), in one pass."""
    out = np.empty(len(vectors))
    for i in range(len(vectors)):
        out[i] = np.sqrt(vectors[i, 0] ** 2 + vectors[i, 1] ** 2 + vectors[i, 2] ** 2)
    return out


#: (gram (s, s), coefficients (k, s), steps) -> Z (s, k).
EmIterations = Callable[[np.ndarray, np.ndarray, int], np.ndarray]


@dataclass(frozen=True)
class Parts:
    """A displacement d (3n,) as the sum of ``anchor``, ``corrective`` and a rest that the model does not know.

    Attributes
    ----------
    in_anchors, anchor : (a,), (3n,)
        M_A^T d and M_A M_A^T d.
    residual : (3n,)
        d - anchor, the sample s of section 5.
    products : (count,)
        S^T s.
    in_correctives, corrective : (k,), (3n,)
        M_K^T d and M_K M_K^T d.
    """

    in_anchors: np.ndarray
    anchor: np.ndarray
    residual: np.ndarray
    products: np.ndarray
    in_correctives: np.ndarray
    corrective: np.ndarray

    def distances(self) -> tuple[float, float]:
        """Mean distance of d's vertices from the anchor space and from the adaptive space before learning (figure 11), mm."""
        rest = self.residual - self.corrective
        return float(_lengths(self.residual.reshape(-1, 3)).mean()), float(_lengths(rest.reshape(-1, 3)).mean())


class AdaptiveModel:
    """M = [M_A, M_K]: projection (section 4.3) and learning (section 5).

    The corrective shapes are stored as combinations of the samples in the buffer, M_K = S Z. An EM step then only uses small
    matrices. A frame reads the buffer twice: for S^T s, and for M_K M_K^T s, which is a combination of the samples.

    Attributes
    ----------
    mix : (S, k <= K)
        Z, for which S Z is orthonormal.
    count, seen : int
        Number of samples in the buffer, and of all valid samples so far.
    ages : (S,)
        Numbers of the buffer's samples among all.
    updates : int
        Number of updates so far.
    em : callable
        Runs the EM iterations of one update, as :func:`em_in_sample_space` does.
    """

    def __init__(
        self,
        actor: Actor,
        blendshapes: np.ndarray,
        parameters: AdaptivePcaParameters,
        em: EmIterations = em_in_sample_space,
    ) -> None:
        self.parameters, self._em = parameters, em
        self.frontal = actor.frontal
        self.anchors, self._anchor_mix = anchor_shapes(blendshapes[:, self.frontal].reshape(len(blendshapes), -1))
        # Single precision halves the memory to stream, with errors of 1e-6 of a displacement.
        self._anchor_rows = np.ascontiguousarray(self.anchors.T, np.float32)
        self._outside = blendshapes[:, ~self.frontal].reshape(len(blendshapes), -1).astype(np.float32)
        n = int(self.frontal.sum())
        # The paper's squared norms are in cm^2 and grow with the number of vertices.
        self._unit = MM_PER_CM**2 * n / PAPER_VERTICES
        self._size = 3 * n
        self.reset()

    def reset(self) -> None:
        """Forget every corrective and every sample."""
        s = self.parameters.S
        self.updates = 0
        self.count = 0
        self.seen = 0
        self.mix = np.zeros((s, 0))
        self._correctives: np.ndarray | None = None
        # float32 halves the memory traffic of the two passes over S, with errors far below the sensor's noise.
        self._samples = np.zeros((s, self._size), np.float32)
        self._gram = np.zeros((s, s))
        self.ages = np.zeros(s, int)
        self._coordinates = np.zeros((s, 0))
        self._sample_anchors = np.zeros((s, self.anchors.shape[1]))
        self._corrective_anchors = np.zeros((self.anchors.shape[1], 0))
        self._shared = False

    def copy(self) -> Self:
        """Return an independent model. The samples are copied when one of the two learns."""
        out = copy.copy(self)
        self._shared = out._shared = True
        return out

    @property
    def correctives(self) -> np.ndarray:
        """M_K (3n, k), orthonormal and orthogonal to ``anchors`` (3n, a), computed on request."""
        if self._correctives is None:
            self._correctives = self._combined()
        return self._correctives

    def _combined(self) -> np.ndarray:
        if self.mix.shape[1] == 0:
            return np.zeros((self._size, 0))
        shapes = (self.mix[: self.count].T.astype(np.float32) @ self._samples[: self.count]).astype(float)
        # Samples are orthogonal to the anchors up to the rounding to float32. This makes it exact. The correction is 1e-7 of
        # the correctives, so that its own rounding is negligible.
        shapes -= (shapes @ self.anchors).astype(np.float32) @ self._anchor_rows
        return orthonormalise(shapes.T)

    # ---- projection ------------------------------------------------------------------------------------------------
    def parts(self, displacement: np.ndarray) -> Parts:
        """Split v2 - b0 (3n,) or, equally, v2 - v1 into parts. The two differ by v1 - b0, which the anchors span."""
        samples, mix = self._samples[: self.count], self.mix[: self.count]
        in_anchors = self._anchor_rows @ displacement.astype(np.float32)
        anchor = in_anchors @ self._anchor_rows
        residual = displacement - anchor
        products = samples @ residual.astype(np.float32)
        in_correctives = products @ mix
        corrective = (mix @ in_correctives).astype(np.float32) @ samples
        return Parts(in_anchors.astype(float), anchor, residual, products, in_correctives, corrective)

    def project(self, parts: Parts) -> tuple[np.ndarray, np.ndarray]:
        """Project the displacement: M M^T d of the frontal vertices (3n,) and of the others (3 (N - n),), mm.

        v3 - b0 = M M^T (v2 - b0) equals v3 - v1 = M M^T (v2 - v1), because the anchors span v1 - b0. At the border of the
        frontal region v2 - v1 is zero, and so is the continuation outside of it.
        """
        continued = parts.in_anchors - self._corrective_anchors @ parts.in_correctives
        return parts.anchor + parts.corrective, (continued @ self._anchor_mix).astype(np.float32) @ self._outside

    def energy(self, sample: np.ndarray) -> float:
        """||s||^2 of a sample (3n,) mm in the units of valid_min and valid_max: cm^2 over a mesh of the paper's size."""
        return float(sample @ sample) / self._unit

    # ---- learning --------------------------------------------------------------------------------------------------
    def classify(self, parts: Parts) -> SampleState:
        """Tell by its energy whether a sample is valid."""
        energy = self.energy(parts.residual)
        if not np.isfinite(energy) or energy >= self.parameters.valid_max:
            return SampleState.OUTLIER
        return SampleState.LEARNED if energy > self.parameters.valid_min else SampleState.IN_ANCHOR_SPACE

    def learn(self, parts: Parts) -> SampleState:
        """Update the model from the parts of a displacement. Only valid samples change it.

        Pass the ``parts`` of v2 - v1, because that displacement vanishes at the border of the frontal region, so that its
        residual there is minus its anchor part.
        """
        state = self.classify(parts)
        if state is SampleState.LEARNED and self.parameters.K:
            self._store(parts)
            self._grow()
            if self._ready():
                self._update()
        return state

    def samples(self) -> np.ndarray:
        """The displacements (count, 3n) in the buffer, the oldest first, mm."""
        order = np.argsort(self.ages[: self.count])
        return self._samples[order] + self._sample_anchors[order].astype(np.float32) @ self._anchor_rows

    def buffer(self) -> np.ndarray:
        """S^T (count, 3n): the samples in the buffer without their anchor parts, in no order. This is not a copy."""
        return self._samples[: self.count]

    def learn_all(self, displacements: np.ndarray) -> None:
        """Start over with displacements (m, 3n) mm. EM runs on the valid ones that are kept until it converges."""
        self.reset()
        if not self.parameters.K:
            return
        for displacement in displacements[-self.parameters.S :] if self.parameters.buffer == "newest" else displacements:
            parts = self.parts(displacement)
            if self.classify(parts) is SampleState.LEARNED:
                self._store(parts)
        if self.count == 0 or not self._ready():
            return
        variances, directions = np.linalg.eigh(self._gram[: self.count, : self.count])
        # There are as many correctives as independent samples. Others would be lost in the buffer's single precision.
        keep = np.flatnonzero(variances > 1e-4 * variances[-1])[::-1][: self.parameters.K]
        self._take(directions[:, keep])

    def _store(self, parts: Parts) -> None:
        """Put a sample into the buffer, drop another one if it is full, and update S^T S and M_K^T S."""
        if self._shared:
            self._samples, self._gram = self._samples.copy(), self._gram.copy()
            self._coordinates, self._sample_anchors = self._coordinates.copy(), self._sample_anchors.copy()
            self._shared = False
        row, known = self._free_row(parts), self.count
        self.count = min(known + 1, self.parameters.S)
        self.ages = np.where(np.arange(self.parameters.S) == row, self.seen, self.ages)
        self.seen += 1
        self._samples[row] = parts.residual
        self._gram[row, :known] = self._gram[:known, row] = parts.products
        self._gram[row, row] = self._samples[row] @ self._samples[row]
        self._sample_anchors[row] = parts.in_anchors
        self._coordinates[row] = parts.in_correctives
        self._newest = row

    def _free_row(self, parts: Parts) -> int:
        """Row for a new sample: the next free one, or else that of the oldest or of the most redundant sample."""
        if self.count < self.parameters.S:
            return self.count
        if self.parameters.buffer == "newest":
            return int(self.ages.argmin())
        square = float(parts.residual @ parts.residual)
        return int(redundant_sample(self._gram, self.ages, parts.products, square))

    def _grow(self) -> None:
        """Until K shapes exist, add the newest sample's own direction (s - M_K M_K^T s) / length as a shape.

        S samples have at most S directions. With more shapes, EM could not run.
        """
        if self.mix.shape[1] >= min(self.parameters.K, self.parameters.S):
            return
        row = self._newest
        known, square = self._coordinates[row], self._gram[row, row]
        length = np.sqrt(max(square - known @ known, 0.0))
        # A near-duplicate has no direction of its own. The sample is kept, but no shape that would make M rank-deficient.
        if length < 1e-2 * np.sqrt(square):
            return
        in_own = (self._gram[row] - self._coordinates @ known) / length
        self._coordinates = np.column_stack([self._coordinates, in_own])
        # A sample that has just left is still in M_K^T S, but not in Z. EM then runs next and makes Z again.
        own = (np.eye(self.parameters.S)[row] - self.mix @ known) / length
        self._keep(np.column_stack([self.mix, own]))

    def _ready(self) -> bool:
        """Whether to update now. The paper waits until the buffer is full; the default begins with the first sample."""
        return self.parameters.startup == "growing" or self.count == self.parameters.S

    def _update(self) -> None:
        """Run EM on the buffer, then QR, so that the correctives become the leading principal directions of the samples."""
        gram, coordinates = self._gram[: self.count, : self.count], self._coordinates[: self.count].T
        reached, directions = np.linalg.eigh(coordinates @ coordinates.T)
        lost = reached <= LEAST_SHARE * np.trace(gram)
        if lost.any():  # no sample has these directions any more, and they would make Y Y^T singular
            coordinates = directions[:, ~lost].T @ coordinates
        self._take(self._em(gram, coordinates, self.parameters.em_steps))
        self.updates += 1

    def _take(self, mix: np.ndarray) -> None:
        """Make the correctives Q of the factorisation S ``mix`` = Q R, with ``mix`` (count, k), from S^T S."""
        products = self._gram[: self.count, : self.count] @ mix
        inverse = np.linalg.inv(np.linalg.cholesky(mix.T @ products)).T
        whole, coordinates = np.zeros((2, self.parameters.S, mix.shape[1]))
        whole[: self.count], coordinates[: self.count] = mix @ inverse, products @ inverse
        self._coordinates = coordinates
        self._keep(whole)

    def _keep(self, mix: np.ndarray) -> None:
        self.mix, self._correctives = mix, None
        self._corrective_anchors = self._sample_anchors.T @ mix
