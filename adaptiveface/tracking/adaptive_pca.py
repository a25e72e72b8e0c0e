"""The adaptive PCA model (sections 4.3 and 5): anchor shapes, corrective shapes, incremental EM-PCA (Roweis 1998).

Vectors are displacements of the n frontal vertices from the neutral, flattened to 3n, in millimetres.
Outside the frontal region nothing is learned: anchors are combinations of the blendshapes and continue there as the same
combinations, and a corrective (a displacement minus its anchor part) continues as minus that anchor part, so that the
projected mesh has no seam.
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

#: The paper's thresholds hold for centimetres and this many vertices.
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
    """(3n, k) Q of the factorisation basis = Q R, through a Cholesky factor of the Gram matrix: cheap for tall matrices.

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
    """``steps`` EM iterations with M = S Z kept as Z, so that they cost nothing in 3n.

    gram (s, s) = S^T S; coefficients (k, s): the first E-step's Y for the current orthonormal M. Returns Z (s, k).
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
    """(n,) lengths of ``vectors`` (n, 3), in one pass."""
    out = np.empty(len(vectors))
    for i in range(len(vectors)):
        out[i] = np.sqrt(vectors[i, 0] ** 2 + vectors[i, 1] ** 2 + vectors[i, 2] ** 2)
    return out


#: (gram (s, s), coefficients (k, s), steps) -> Z (s, k).
EmIterations = Callable[[np.ndarray, np.ndarray, int], np.ndarray]


@dataclass(frozen=True)
class Parts:
    """What a displacement d (3n,) is made of: ``anchor`` + ``corrective`` + what the model does not know.

    in_anchors (a,) = M_A^T d and anchor (3n,) = M_A M_A^T d; residual (3n,) = d - anchor, the sample s of section 5;
    products (count,) = S^T s; in_correctives (k,) = M_K^T d and corrective (3n,) = M_K M_K^T d.
    """

    in_anchors: np.ndarray
    anchor: np.ndarray
    residual: np.ndarray
    products: np.ndarray
    in_correctives: np.ndarray
    corrective: np.ndarray

    def distances(self) -> tuple[float, float]:
        """Figure 11: mean vertex distance (mm) of d from the anchor and from the adaptive space, as they were when it came."""
        rest = self.residual - self.corrective
        return float(_lengths(self.residual.reshape(-1, 3)).mean()), float(_lengths(rest.reshape(-1, 3)).mean())


class AdaptiveModel:
    """M = [M_A, M_K]: projection (section 4.3) and learning (section 5).

    The corrective shapes are kept as combinations of the samples in the buffer, M_K = S Z: an EM step then is made of small
    matrices, and a frame reads the buffer twice, for S^T s and for the combination of samples that M_K M_K^T s is.

    Learned state: ``mix`` (S, k <= K), Z with orthonormal S Z; ``count`` samples in the buffer, of ``seen`` valid ones in
    all; ``ages`` (S,), the numbers of those in the buffer among all; ``updates``.
    ``em``: the EM iterations of one update, as :func:`em_in_sample_space` makes them.
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
        # In single precision: half the memory to stream, 1e-6 of a displacement.
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
        # Samples in float32: half the memory traffic of the two passes over S, far below the sensor's noise.
        self._samples = np.zeros((s, self._size), np.float32)
        self._gram = np.zeros((s, s))
        self.ages = np.zeros(s, int)
        self._coordinates = np.zeros((s, 0))
        self._sample_anchors = np.zeros((s, self.anchors.shape[1]))
        self._corrective_anchors = np.zeros((self.anchors.shape[1], 0))
        self._shared = False

    def copy(self) -> Self:
        """A model that goes its own way; the samples are copied when one of the two learns."""
        out = copy.copy(self)
        self._shared = out._shared = True
        return out

    @property
    def correctives(self) -> np.ndarray:
        """M_K (3n, k) orthonormal and orthogonal to ``anchors`` (3n, a), computed when asked for."""
        if self._correctives is None:
            self._correctives = self._combined()
        return self._correctives

    def _combined(self) -> np.ndarray:
        if self.mix.shape[1] == 0:
            return np.zeros((self._size, 0))
        shapes = (self.mix[: self.count].T.astype(np.float32) @ self._samples[: self.count]).astype(float)
        # Samples are orthogonal to the anchors up to their float32 storage; make it exact. The correction is 1e-7 of
        # the correctives, so that its own single precision does not show.
        shapes -= (shapes @ self.anchors).astype(np.float32) @ self._anchor_rows
        return orthonormalise(shapes.T)

    # ---- projection ------------------------------------------------------------------------------------------------
    def parts(self, displacement: np.ndarray) -> Parts:
        """Take v2 - b0 (3n,) or, equally, v2 - v1 apart: they differ by v1 - b0, which the anchors span."""
        samples, mix = self._samples[: self.count], self.mix[: self.count]
        in_anchors = self._anchor_rows @ displacement.astype(np.float32)
        anchor = in_anchors @ self._anchor_rows
        residual = displacement - anchor
        products = samples @ residual.astype(np.float32)
        in_correctives = products @ mix
        corrective = (mix @ in_correctives).astype(np.float32) @ samples
        return Parts(in_anchors.astype(float), anchor, residual, products, in_correctives, corrective)

    def project(self, parts: Parts) -> tuple[np.ndarray, np.ndarray]:
        """M M^T d: of the frontal vertices (3n,), and of the others (3 (N - n),), mm.

        v3 - b0 = M M^T (v2 - b0) is v3 - v1 = M M^T (v2 - v1), as the anchors span v1 - b0. Outside the frontal region
        v2 - v1 is zero at the border, and so is what is added there.
        """
        continued = parts.in_anchors - self._corrective_anchors @ parts.in_correctives
        return parts.anchor + parts.corrective, (continued @ self._anchor_mix).astype(np.float32) @ self._outside

    def energy(self, sample: np.ndarray) -> float:
        """||s||^2 of a sample (3n,) in mm, in the units of valid_min and valid_max: cm^2 over a mesh of the paper's size."""
        return float(sample @ sample) / self._unit

    # ---- learning --------------------------------------------------------------------------------------------------
    def classify(self, parts: Parts) -> SampleState:
        """Validity of a sample by its energy."""
        energy = self.energy(parts.residual)
        if not np.isfinite(energy) or energy >= self.parameters.valid_max:
            return SampleState.OUTLIER
        return SampleState.LEARNED if energy > self.parameters.valid_min else SampleState.IN_ANCHOR_SPACE

    def learn(self, parts: Parts) -> SampleState:
        """One incremental update from a displacement, taken apart just now; only valid samples change the model.

        For the continuation outside the frontal region take the ``parts`` of v2 - v1: it vanishes at the border, so that its
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
        """(count, 3n) the displacements in the buffer, the oldest first."""
        order = np.argsort(self.ages[: self.count])
        return self._samples[order] + self._sample_anchors[order].astype(np.float32) @ self._anchor_rows

    def buffer(self) -> np.ndarray:
        """(count, 3n) S^T, the samples in the buffer without their part in the anchor space, in no order; not a copy."""
        return self._samples[: self.count]

    def learn_all(self, displacements: np.ndarray) -> None:
        """Start over from displacements (m, 3n): the correctives to which EM on the valid ones that are kept converges."""
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
        # As many correctives as there are independent samples; the buffer's single precision hides the others.
        keep = np.flatnonzero(variances > 1e-4 * variances[-1])[::-1][: self.parameters.K]
        self._take(directions[:, keep])

    def _store(self, parts: Parts) -> None:
        """Put a sample into the buffer (one leaves where that is full) and keep S^T S and M_K^T S up to date."""
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
        """Where a new sample goes: the next free row, else that of the oldest sample or of the most redundant one."""
        if self.count < self.parameters.S:
            return self.count
        if self.parameters.buffer == "newest":
            return int(self.ages.argmin())
        square = float(parts.residual @ parts.residual)
        return int(redundant_sample(self._gram, self.ages, parts.products, square))

    def _grow(self) -> None:
        """Until K shapes exist, make the newest sample's own direction one of them: (s - M_K M_K^T s) / length.

        S samples have no more than S directions: with more shapes than that EM could never run.
        """
        if self.mix.shape[1] >= min(self.parameters.K, self.parameters.S):
            return
        row = self._newest
        known, square = self._coordinates[row], self._gram[row, row]
        length = np.sqrt(max(square - known @ known, 0.0))
        # A near-duplicate of what is there has no direction of its own: keep the sample, not the rank deficiency.
        if length < 1e-2 * np.sqrt(square):
            return
        in_own = (self._gram[row] - self._coordinates @ known) / length
        self._coordinates = np.column_stack([self._coordinates, in_own])
        # Of a sample that has just left, M_K^T S still knows and Z does not: EM follows then, and makes Z anew.
        own = (np.eye(self.parameters.S)[row] - self.mix @ known) / length
        self._keep(np.column_stack([self.mix, own]))

    def _ready(self) -> bool:
        """The paper updates once the buffer is full; the default from the first sample on."""
        return self.parameters.startup == "growing" or self.count == self.parameters.S

    def _update(self) -> None:
        """EM on the buffer, then QR: the correctives become the leading principal directions of the samples."""
        gram, coordinates = self._gram[: self.count, : self.count], self._coordinates[: self.count].T
        reached, directions = np.linalg.eigh(coordinates @ coordinates.T)
        lost = reached <= LEAST_SHARE * np.trace(gram)
        if lost.any():  # directions that no sample has any more, and that would make Y Y^T singular
            coordinates = directions[:, ~lost].T @ coordinates
        self._take(self._em(gram, coordinates, self.parameters.em_steps))
        self.updates += 1

    def _take(self, mix: np.ndarray) -> None:
        """The correctives become Q of the factorisation S ``mix`` = Q R, mix (count, k), through S^T S."""
        products = self._gram[: self.count, : self.count] @ mix
        inverse = np.linalg.inv(np.linalg.cholesky(mix.T @ products)).T
        whole, coordinates = np.zeros((2, self.parameters.S, mix.shape[1]))
        whole[: self.count], coordinates[: self.count] = mix @ inverse, products @ inverse
        self._coordinates = coordinates
        self._keep(whole)

    def _keep(self, mix: np.ndarray) -> None:
        self.mix, self._correctives = mix, None
        self._corrective_anchors = self._sample_anchors.T @ mix
