"""The adaptive PCA model (sections 4.3 and 5): anchor shapes, corrective shapes, incremental EM-PCA (Roweis 1998).

Vectors are displacements of the n frontal vertices from the neutral, flattened to 3n, in millimetres.
Outside the frontal region nothing is learned: anchors are combinations of the blendshapes and continue there as the same
combinations, and a corrective (a displacement minus its anchor part) continues as minus that anchor part, so that the
projected mesh has no seam.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..caches.compiled import compiled
from ..model.actor import Actor
from ..parameters import AdaptivePcaParameters
from .types import SampleState

#: The paper's thresholds hold for centimetres and this many vertices.
PAPER_VERTICES, MM_PER_CM = 3480, 10.0


def anchor_shapes(blendshapes: np.ndarray, tolerance: float = 1e-6) -> tuple[np.ndarray, np.ndarray]:
    """Principal components of the blendshapes, B B^T = M_A D M_A^T (section 5).

    B (A, 3n) one blendshape per row -> M_A (3n, a) orthonormal and C (a, A) with M_A = B^T C^T. Directions with less than
    ``tolerance`` of the largest singular value are left out.
    """
    u, s, vt = np.linalg.svd(blendshapes, full_matrices=False)
    keep = s > tolerance * s[0]
    return np.ascontiguousarray(vt[keep].T), (u[:, keep] / s[keep]).T


def orthonormalise(basis: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """QR factorisation basis = Q R through a Cholesky factor of the Gram matrix: cheap for tall matrices.

    Its error grows with the squared condition number, so ill-conditioned bases get a second pass (CholeskyQR2, Yamamoto
    et al. 2015). Returns Q (3n, k), stored shape by shape (Fortran order), and R (k, k).
    """
    lower = np.linalg.cholesky(basis.T @ basis)
    rows = np.linalg.inv(lower) @ basis.T
    scale = np.abs(np.diag(lower))
    if scale.max() < 30.0 * scale.min():
        return rows.T, lower.T
    again = np.linalg.cholesky(rows @ rows.T)
    return (np.linalg.inv(again) @ rows).T, (lower @ again).T


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
    z = np.linalg.solve(coefficients @ coefficients.T, coefficients).T
    for _ in range(steps - 1):
        products = z.T @ gram
        y = np.linalg.solve(products @ z, products)
        z = np.linalg.solve(y @ y.T, y).T
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


class AdaptiveModel:
    """M = [M_A, M_K]: projection (section 4.3) and learning (section 5).

    Learned state: ``correctives`` (3n, k <= K) orthonormal and orthogonal to ``anchors`` (3n, a); ``updates``; ``mix`` (s, k),
    the combinations of the samples in the buffer that the correctives are a basis of, None while they grow.
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
        self.correctives = np.zeros((self._size, 0))
        self.updates = 0
        self.count = 0
        self._next = 0
        self.mix: np.ndarray | None = None
        # Samples in float32: half the memory traffic of the two passes over S, far below the sensor's noise.
        self._samples = np.zeros((s, self._size), np.float32)
        self._gram = np.zeros((s, s))
        self._coordinates = np.zeros((s, 0))
        self._sample_anchors = np.zeros((s, self.anchors.shape[1]))
        self._corrective_anchors = np.zeros((self.anchors.shape[1], 0))

    # ---- projection ------------------------------------------------------------------------------------------------
    def project(self, displacement: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """v3 - b0 = M M^T (v2 - b0): displacement (3n,) -> (frontal (3n,), the other vertices (3 (N - n),))."""
        in_anchors, anchor_part = self._on_anchors(displacement)
        in_correctives = self.correctives.T @ displacement
        frontal = anchor_part + self.correctives @ in_correctives
        continued = in_anchors - self._corrective_anchors @ in_correctives
        return frontal, (continued @ self._anchor_mix).astype(np.float32) @ self._outside

    def _on_anchors(self, displacement: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """M_A^T d (a,) and M_A M_A^T d (3n,) in single precision: half the memory to stream, 1e-6 of d."""
        coefficients = self._anchor_rows @ displacement.astype(np.float32)
        return coefficients.astype(float), coefficients @ self._anchor_rows

    def distances(self, displacement: np.ndarray) -> tuple[float, float]:
        """Figure 11: mean vertex distance (mm) of v2 - b0 (3n,), or of v2 - v1, from the anchor and the adaptive space.

        To be asked before that frame is learned from: afterwards a new expression is known already.
        """
        residual = displacement - self.anchors @ (self.anchors.T @ displacement)
        anchor = float(_lengths(residual.reshape(-1, 3)).mean())
        residual = residual - self.correctives @ (self.correctives.T @ residual)
        return anchor, float(_lengths(residual.reshape(-1, 3)).mean())

    def energy(self, sample: np.ndarray) -> float:
        """||s||^2 of a sample (3n,) in mm, in the units of valid_min and valid_max: cm^2 over a mesh of the paper's size."""
        return float(sample @ sample) / self._unit

    # ---- learning --------------------------------------------------------------------------------------------------
    def classify(self, displacement: np.ndarray) -> tuple[SampleState, np.ndarray, np.ndarray]:
        """Validity of a sample v2 - b0 (3n,): (state, s = its residual to the anchor space, its anchor coefficients)."""
        in_anchors, anchor_part = self._on_anchors(displacement)
        residual = displacement - anchor_part
        energy = self.energy(residual)
        if not np.isfinite(energy) or energy >= self.parameters.valid_max:
            return SampleState.OUTLIER, residual, in_anchors
        state = SampleState.LEARNED if energy > self.parameters.valid_min else SampleState.IN_ANCHOR_SPACE
        return state, residual, in_anchors

    def learn(self, displacement: np.ndarray) -> SampleState:
        """One incremental update from v2 - b0 (3n,) or, equally, from v2 - v1; only valid samples change the model.

        The two differ by v1 - b0, which the anchors span. For the continuation outside the frontal region pass v2 - v1:
        it vanishes at the border, so that its residual there is minus its anchor part.
        """
        state, residual, in_anchors = self.classify(displacement)
        if state is SampleState.LEARNED and self.parameters.K:
            self._store(residual, in_anchors)
            if self._start_up() and self._ready():
                self._update()
        return state

    def samples(self) -> np.ndarray:
        """(count, 3n) the displacements in the buffer, the oldest first."""
        order = (np.arange(self.count) + (self._next if self.count == self.parameters.S else 0)) % self.parameters.S
        return self._samples[order] + self._sample_anchors[order].astype(np.float32) @ self._anchor_rows

    def learn_all(self, displacements: np.ndarray) -> None:
        """Start over from displacements (m, 3n): the correctives to which EM on their newest S valid ones converges."""
        self.reset()
        if not self.parameters.K:
            return
        for displacement in displacements[-self.parameters.S :]:
            state, residual, in_anchors = self.classify(displacement)
            if state is SampleState.LEARNED:
                self._store(residual, in_anchors)
        if self.count == 0 or not self._ready():
            return
        variances, directions = np.linalg.eigh(self._gram[: self.count, : self.count])
        # As many correctives as there are independent samples; the buffer's single precision hides the others.
        keep = np.flatnonzero(variances > 1e-4 * variances[-1])[::-1][: self.parameters.K]
        self._coordinates = np.zeros((self.parameters.S, len(keep)))
        self._take(directions[:, keep])

    def _store(self, sample: np.ndarray, in_anchors: np.ndarray) -> None:
        """Put a sample into the buffer (the oldest one leaves) and keep S^T S and M_K^T S up to date."""
        row = self._next
        self._next = (row + 1) % self.parameters.S
        self.count = min(self.count + 1, self.parameters.S)
        self._samples[row] = sample
        products = self._samples[: self.count] @ self._samples[row]
        self._gram[row, : self.count] = self._gram[: self.count, row] = products
        self._sample_anchors[row] = in_anchors
        self._coordinates[row] = sample @ self.correctives
        self._newest = row

    def _start_up(self) -> bool:
        """Grow the basis by the newest sample's own direction until K shapes exist; True when EM may run.

        S samples have no more than S directions: with more shapes than that EM could never run.
        """
        k = self.correctives.shape[1]
        if k >= min(self.parameters.K, self.parameters.S):
            return True
        sample = self._samples[self._newest].astype(float)
        rest = sample - self.correctives @ (self.correctives.T @ sample)
        rest -= self.anchors @ (self.anchors.T @ rest)
        length = np.linalg.norm(rest)
        # A near-duplicate of what is there has no direction of its own: keep the sample, not the rank deficiency.
        if length < 1e-2 * np.linalg.norm(sample):
            return k > 0
        self.mix = None
        self.correctives = np.column_stack([self.correctives, rest / length])
        self.correctives, _ = orthonormalise(self.correctives)
        self._coordinates = self._samples @ self.correctives
        own = self._sample_anchors[self._newest][:, None]
        mixed = own - self._corrective_anchors @ self._coordinates[self._newest, :k][:, None]
        self._corrective_anchors = np.column_stack([self._corrective_anchors, mixed / length])
        return True

    def _ready(self) -> bool:
        """The paper updates once the buffer is full; the default from the first sample on."""
        return self.parameters.startup == "growing" or self.count == self.parameters.S

    def _update(self) -> None:
        """EM on the buffer, then QR: the correctives become the leading principal directions of the samples."""
        gram, coordinates = self._gram[: self.count, : self.count], self._coordinates[: self.count]
        # Samples that do not reach every corrective make Y Y^T singular: wait for more of them.
        if np.linalg.eigvalsh(coordinates.T @ coordinates)[0] <= 1e-12 * np.trace(gram):
            return
        self._take(self._em(gram, coordinates.T, self.parameters.em_steps))
        self.updates += 1

    def combined(self, mix: np.ndarray, samples: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The orthonormal basis (3n, k) of the combinations S ``mix`` (s, k) of samples (s, 3n), and its triangle (k, k)."""
        shapes = (mix.T.astype(np.float32) @ samples).astype(float)
        # Samples are orthogonal to the anchors up to their float32 storage; make it exact. The correction is 1e-7 of
        # the correctives, so that its own single precision does not show.
        shapes -= (shapes @ self.anchors).astype(np.float32) @ self._anchor_rows
        return orthonormalise(shapes.T)

    def _take(self, mix: np.ndarray) -> None:
        """The orthonormal basis of the combinations S ``mix`` (count, k) of the samples becomes the correctives."""
        self.mix = mix
        self.correctives, triangle = self.combined(mix, self._samples[: self.count])
        mix = mix @ np.linalg.inv(triangle)
        self._coordinates[: self.count] = self._gram[: self.count, : self.count] @ mix
        self._corrective_anchors = self._sample_anchors[: self.count].T @ mix
