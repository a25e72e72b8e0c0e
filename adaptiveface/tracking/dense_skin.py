"""Motion within the surface, seen in the colours of the whole face: a term of the Laplacian step that the paper plans.

Depth knows nothing about motion within the surface, and 40 features know it in places. The neutral's colours T_q at samples q
of the surface (:class:`Skin`) say where the skin between the features went. The energy of section 4.3 gets

    w sum_q a_q sum_c rho |I_c(pi(P e_q(v1 + d))) - T_qc|^2 / s_qc^2

with the picture's channels I_c (:func:`~adaptiveface.model.skin.skin_channels`), the pose P, the projection pi and the
sample's barycentric row e_q. T is taken as the light of the picture shows it (skin_light.py). The energy is linearised at
a displacement d0 with the neutral's gradients g_qc in place of the picture's (the inverse compositional form of Baker &
Matthews 2004): g_qc lies in the sample's triangle and follows it as it bends. So no noise of the picture is taken for
texture, and a look at it is cheap: d0 is the last frame's displacement at first, and where that leads at the second look,
as skin that moves by more than its texture is fine is not reached by one step. With the residual r_qc a sample adds the
matrix M_q = sum_c w_qc g_qc g_qc^T and the pull M_q e_q d0 - sum_c w_qc r_qc g_qc. M_q says what a sample knows, in both
directions of the surface: across an edge much, along it nothing.

What makes a weight w_qc small: a slope that the neutral's pictures do not show alike, being noise, or gloss that stays
where the lamp is while the head turns (the sample's ``coherence``); skin that turns away; a channel that light and pose
changed in the neutral already; a sample that fits worse than the others; one without depth of the skin, behind a hand or
beside the face; and a picture in which the neutral's colours are not found again, as it is late, dark or another one: then
nothing changes at all.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ..geometry.frame import RgbdFrame
from ..model.skin import PIXELS, Skin, skin_channels
from ..parameters import SkinParameters
from .laplacian import LaplacianDeformation
from .region import FrontalRegion
from .skin_light import fit_light, in_light, row_weights, trust
from .skin_samples import CORRELATED, FACING, carry, look_up, moved, normal_equations
from .slow_modes import SlowModes
from .surface_term import SurfaceTerm

#: px beside the samples in which the picture is prepared: blurs and shifts reach so far.
_BORDER = 16
#: Every so many of the samples tell the light, which has five numbers a channel, and whether the picture is late.
_LIGHT_STRIDE = 4
#: Deviation of a sample that fits, %, where it is asked whether a picture shows the neutral's colours at all, and where it
#: shows them; and how many of its variances a squared residual then counts at most.
_FITS, _OUTLIER = 2.0, 9.0
#: Mean shares of their weights that rows of depth and colour have in a frame: some find no depth, none fits perfectly.
DEPTH_SHARE, COLOUR_SHARE = 0.75, 0.6


class SkinPicture(NamedTuple):
    """The part of a picture around the face: ``channels`` (H, W, 3), and its fx, fy, cx and cy, px."""

    channels: np.ndarray
    lens: tuple[float, float, float, float]


class Seen(NamedTuple):
    """What a picture shows of Q samples: ``values`` (Q, 3), their unit ``normals`` (Q, 3), how much each counts (Q,)."""

    values: np.ndarray
    normals: np.ndarray
    counts: np.ndarray


@dataclass(frozen=True)
class Looks:
    """One picture that is compared with the neutral's colours, look after look.

    Attributes
    ----------
    deformation : LaplacianDeformation
        The Laplacian step that takes the rows.
    first : SurfaceTerm
        The rows at the last frame's displacement.
    again : callable
        The rows at another displacement (n, 3), mm.
    gain : float
        By how much the picture fits there better than where the face was in the frame before, as a mean squared residual in
        units of its variance; 0 without a frame before.
    """

    deformation: LaplacianDeformation
    first: SurfaceTerm
    again: Callable[[np.ndarray], SurfaceTerm]
    gain: float


class DenseSkin:
    """The rows of one actor's ``skin``; ``deformation``: that of section 4.3, bounded for them."""

    def __init__(
        self, skin: Skin, region: FrontalRegion, deformation: LaplacianDeformation, parameters: SkinParameters
    ) -> None:
        self.parameters = parameters
        self._skin = skin = skin.first(parameters.samples)
        self._corners = np.ascontiguousarray(region.local[skin.triangles])
        self._few = self._corners[::_LIGHT_STRIDE].copy(), skin.weights[::_LIGHT_STRIDE].copy()
        self._precisions = 1.0 / (parameters.noise**2 + skin.deviations**2)
        self._fitting = _FITS**2 + skin.deviations**2
        edges = region.neutral[self._corners[:, 1:]] - region.neutral[self._corners[:, :1]]
        inverse = np.linalg.inv(edges @ edges.transpose(0, 2, 1))
        steepness = np.einsum("qce,qef,qcf->qc", skin.slopes, inverse, skin.slopes)
        self._shares = parameters.weight * skin.coherence / PIXELS
        known = (self._shares * steepness * self._precisions / CORRELATED).sum(axis=1)
        at_vertices = np.bincount(self._corners.ravel(), (skin.weights * known[:, None]).ravel(), minlength=len(region))
        self.deformation = deformation.bounded(at_vertices, self._slow_modes(region, deformation, at_vertices, edges))

    def _slow_modes(
        self, region: FrontalRegion, deformation: LaplacianDeformation, bound: np.ndarray, edges: np.ndarray
    ) -> SlowModes:
        """The modes for the rows of the neutral, seen from the front; edges (Q, 2, 3) of the samples' triangles."""
        skin, normals = self._skin, region.normals_at_rest
        depth = deformation.w1 * np.where(normals[:, 2] > FACING[0], DEPTH_SHARE * normals[:, 2], 0.0)
        across = np.cross(edges[:, 0], edges[:, 1])
        facing = (across[:, 2] / np.linalg.norm(across, axis=1) - FACING[0]) / (FACING[1] - FACING[0])
        gradients = np.einsum("qcf,qfk->qck", skin.slopes, np.linalg.pinv(edges).transpose(0, 2, 1))
        weights = COLOUR_SHARE * np.clip(facing, 0.0, 1.0)[:, None] * self._shares * self._precisions / CORRELATED
        return SlowModes.of(
            deformation.system.smoothing,
            deformation.w1 + bound,
            depth[:, None, None] * normals[:, :, None] * normals[:, None, :],
            self._corners,
            skin.weights,
            np.einsum("qc,qck,qcl->qkl", weights, gradients, gradients),
        )

    def look(
        self,
        frame: RgbdFrame,
        pose: np.ndarray,
        vertices: np.ndarray,
        displacement: np.ndarray,
        measured: np.ndarray,
        before: np.ndarray | None = None,
    ) -> Looks | None:
        """Compare the frame's picture with the neutral's colours.

        Parameters
        ----------
        frame : RgbdFrame
            The frame, with or without colour.
        pose : (4, 4)
            Head to camera.
        vertices, displacement : (n, 3)
            The frontal vertices of v1 and how far the skin is displaced from there, head frame, mm.
        measured : (n,) bool
            Where depth was found.
        before : (n, 3), optional
            Where the frontal vertices were in the frame before, camera frame, mm.

        Returns
        -------
        Looks or None
            None where no colour tells anything.
        """
        placed = moved(vertices, displacement, pose)
        picture = self._picture(frame, placed)
        if picture is None:
            return None
        seen = self._see(picture, placed, measured)
        expected, believed = self._expect(seen)
        if not (believed.any() and seen.counts.any()):
            return None

        def rows(placed: np.ndarray, seen: Seen, displacement: np.ndarray) -> SurfaceTerm:
            """The rows about a displacement (n, 3), which puts the vertices at ``placed`` (n, 3), camera frame, mm."""
            residuals = seen.values - expected
            weights = row_weights(residuals, seen.counts, self._precisions, self._shares, believed)
            turn = np.ascontiguousarray(pose[:3, :3])
            matrices, forces = normal_equations(residuals, weights, self._skin.slopes, placed, self._corners, turn)
            return SurfaceTerm(self._corners, self._skin.weights, matrices, forces, displacement)

        def again(displacement: np.ndarray) -> SurfaceTerm:
            """``Looks.again``: the rows about another displacement (n, 3), mm, by the same light."""
            placed = moved(vertices, displacement, pose)
            return rows(placed, self._see(picture, placed, measured), displacement)

        gain = 0.0 if before is None else self._gain(picture, before, measured, seen, expected, believed)
        return Looks(self.deformation, rows(placed, seen, displacement), again, gain)

    def _gain(
        self,
        picture: SkinPicture,
        before: np.ndarray,
        measured: np.ndarray,
        now: Seen,
        expected: np.ndarray,
        believed: np.ndarray,
    ) -> float:
        """By how much a picture fits better what is seen ``now`` than at vertices as they were ``before``: ``Looks.gain``."""
        some = slice(None, None, _LIGHT_STRIDE)
        then = self._see(picture, before, measured, self._few)
        weights = np.minimum(then.counts, now.counts[some])[:, None] * self._shares[some] * believed

        def misfit(values: np.ndarray) -> float:
            """The weighted sum of squared residuals of ``values`` (q, 3), in units of their variances."""
            squares = (values - expected[some]) ** 2 / self._fitting[some]
            return float(np.vdot(weights, np.minimum(squares, _OUTLIER)))

        return (misfit(then.values) - misfit(now.values[some])) / max(float(weights.sum()), 1e-12)

    def _picture(self, frame: RgbdFrame, placed: np.ndarray) -> SkinPicture | None:
        """What a frame shows around the vertices ``placed`` (n, 3), camera frame; None without colour, or too little."""
        outline = placed[::5]  # dense enough to know where the face is
        if frame.colour is None or outline[:, 2].min() < 50.0:
            return None
        pixels, camera = frame.camera.project(outline).T.copy(), frame.camera
        u, v = np.maximum(pixels.min(axis=1).astype(int) - _BORDER, 0)
        right, bottom = np.minimum(pixels.max(axis=1).astype(int) + _BORDER, [camera.width, camera.height])
        if min(right - u, bottom - v) < 2 * _BORDER:
            return None
        lens = camera.fx, camera.fy, camera.cx - float(u), camera.cy - float(v)
        return SkinPicture(skin_channels(frame.colour[v:bottom, u:right]), lens)

    def _see(
        self,
        picture: SkinPicture,
        placed: np.ndarray,
        measured: np.ndarray,
        samples: tuple[np.ndarray, np.ndarray] | None = None,
    ) -> Seen:
        """What the picture shows of all samples, or of some, where vertices are ``placed`` (n, 3), camera frame.

        samples: corners (q, 3) and weights (q, 3) of those.
        """
        corners, shares = samples or (self._corners, self._skin.weights)
        points, normals, counts = carry(placed, corners, shares, measured, picture.lens[0] * self.parameters.spacing)
        return Seen(look_up(picture.channels, points, picture.lens, counts), normals, counts)

    def _expect(self, seen: Seen) -> tuple[np.ndarray, np.ndarray]:
        """Colours (Q, 3) that a picture should show in its light, and how far its channels are believed (3,).

        They serve for all looks at a picture: between two looks the skin moves by less than light changes over the face.
        """
        skin, known, some = self._skin, seen.counts[:, None] / self._fitting, slice(None, None, _LIGHT_STRIDE)
        light = fit_light(seen.values[some], skin.colours[some], seen.normals[some], known[some])
        expected = in_light(light, skin.colours, seen.normals)
        return expected, trust(seen.values - expected, expected, known, seen.counts)
