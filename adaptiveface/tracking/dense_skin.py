"""Motion within the surface, seen in the colours of the whole face: a term of the Laplacian step that the paper plans.

Depth knows nothing about motion within the surface, and 40 features know it in places. The neutral's colours T_q at samples q
of the surface (:class:`Skin`) say where the skin between the features went. The energy of section 4.3 gets

    w sum_q a_q sum_c rho |I_c(pi(P e_q(v1 + d))) - T_qc|^2 / s_qc^2

with the picture's channels I_c, the pose P, the projection pi and the sample's barycentric row e_q. T is taken as the light of
the picture shows it (skin_light.py). The energy is linearised at the last frame's displacement d0, and the row's part along the
normal is left out: there depth knows better. With the residual r_qc and g_qc = (1 - n n^T) P^T (d pi)^T grad I_c a sample
adds the matrix M_q = sum_c w_qc g_qc g_qc^T and the pull M_q e_q d0 - sum_c w_qc r_qc g_qc. M_q says what a sample knows, in
both directions of the surface: across an edge much, along it nothing.

What makes a weight w_qc small: skin that turns away; a channel that light and pose changed in the neutral already; a sample
that fits worse than the others; one without depth of the skin, behind a hand or beside the face; and a picture in which the
neutral's colours are not found again, as it is late, dark or another one: then nothing changes at all. Blurred pictures reach
farther, but show more of the shading, and made every figure worse.
"""

from __future__ import annotations

import cv2
import numpy as np

from ..geometry.frame import RgbdFrame
from ..geometry.mesh import transform_points
from ..model.appearance import channels
from ..model.skin import Skin
from ..parameters import SkinParameters
from .laplacian import LaplacianDeformation
from .region import FrontalRegion
from .skin_light import fit_light, in_light, robust, trust
from .skin_samples import CORRELATED, carry, look_up, normal_equations
from .skin_term import SkinTerm

#: px beside the samples in which the picture is prepared: blurs and shifts reach so far.
_BORDER = 16


class DenseSkin:
    """The rows of one actor's ``skin``; ``deformation``: that of section 4.3, bounded for them."""

    def __init__(
        self, skin: Skin, region: FrontalRegion, deformation: LaplacianDeformation, parameters: SkinParameters
    ) -> None:
        self.parameters = parameters
        self._skin = skin = skin.first(parameters.samples)
        self._corners = np.ascontiguousarray(region.local[skin.triangles])
        self._variances = parameters.noise**2 + skin.deviations**2
        known = parameters.weight / CORRELATED * skin.detail / self._variances.mean(axis=1)
        at_vertices = np.bincount(self._corners.ravel(), (skin.weights * known[:, None]).ravel(), minlength=len(region))
        self.deformation = deformation.bounded(at_vertices)

    def term(
        self, frame: RgbdFrame, pose: np.ndarray, vertices: np.ndarray, displacement: np.ndarray, measured: np.ndarray
    ) -> SkinTerm | None:
        """The rows for the frontal ``vertices`` (n, 3) of v1, linearised at a ``displacement`` (n, 3), mm.

        ``measured`` (n,) bool: depth was found there. None where no colour tells anything.
        """
        placed = transform_points(pose, vertices + displacement)
        window = None if frame.colour is None else self._window(frame, placed)
        if frame.colour is None or window is None:
            return None
        u, v, right, bottom = window
        picture = channels(frame.colour[v:bottom, u:right], 0.0)
        along_u, along_v = (cv2.Scharr(picture, cv2.CV_32F, *axis) / 32.0 for axis in ((1, 0), (0, 1)))
        lens = frame.camera.fx, frame.camera.fy, frame.camera.cx - u, frame.camera.cy - v
        matrices, forces = self._rows((picture, along_u, along_v), lens, placed, pose, measured)
        if not matrices.any():
            return None
        return SkinTerm.about(self._corners, self._skin.weights, matrices, forces, displacement)

    def _window(self, frame: RgbdFrame, placed: np.ndarray) -> tuple[int, int, int, int] | None:
        """Left, top, right and bottom of the part of the picture that holds the face; None where that is too little."""
        if placed[:, 2].min() < 50.0:
            return None
        pixels = frame.camera.project(placed)
        u, v = np.maximum(pixels.min(axis=0).astype(int) - _BORDER, 0)
        right, bottom = np.minimum(pixels.max(axis=0).astype(int) + _BORDER, [frame.camera.width, frame.camera.height])
        return None if min(right - u, bottom - v) < 2 * _BORDER else (int(u), int(v), int(right), int(bottom))

    def _rows(
        self,
        images: tuple[np.ndarray, np.ndarray, np.ndarray],
        lens: tuple[float, float, float, float],
        placed: np.ndarray,
        pose: np.ndarray,
        measured: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray]:
        """M (Q, 3, 3) and -sum_c w_qc r_qc g_qc (Q, 3), both in the head frame, where vertices are ``placed`` (n, 3)."""
        skin, reach = self._skin, lens[0] * self.parameters.spacing
        points, normals, counts = carry(placed, self._corners, skin.weights, measured, reach)
        values, along_u, along_v = look_up(images, points, lens, counts)
        known = counts[:, None] / self._variances
        expected = in_light(fit_light(values, skin.colours, normals, known), skin.colours, normals)
        residuals = values - expected
        misfit = (known * residuals**2).sum(axis=0) / max(counts.sum(), 1e-12)
        variances = np.maximum(misfit, 1.0) * self._variances
        believed = self.parameters.weight * trust(residuals, expected, known)
        weights = believed * counts[:, None] / variances * robust(residuals, variances)
        turn = np.ascontiguousarray(pose[:3, :3])
        return normal_equations(residuals, weights, along_u, along_v, points, normals, turn, lens)
