"""Motion within the surface, seen in the colours of the whole face: a term of the Laplacian step that the paper plans.

Depth knows nothing about motion within the surface, and 40 features know it in places. The neutral's colours T_q at samples q
of the surface (:class:`Skin`) say where the skin between the features went. The energy of section 4.3 gets

    w sum_q a_q sum_c rho |I_c(pi(P e_q(v1 + d))) - T_qc|^2 / s_qc^2

with the picture's channels I_c, the pose P, the projection pi and the sample's barycentric row e_q. It is linearised at the
displacement d0 so far, and the row's part along the normal is left out: there depth knows better. With the residual r_qc
and g_qc = (1 - n n^T) P^T (d pi)^T grad I_c a sample adds the matrix M_q = sum_c w_qc g_qc g_qc^T and the pull
M_q e_q d0 - sum_c w_qc r_qc g_qc. M_q says what a sample knows, in both directions of the surface: across an edge much, along
it nothing.

What makes a weight w_qc small: skin that turns away; a channel that light and pose changed in the neutral already; a sample
that fits worse than the others; one without depth of the skin, behind a hand or beside the face; and a picture in which the
neutral's colours are not found again, as it is late, dark or another one: then nothing changes at all.
Blurred pictures reach farther, but show more of the shading, and made every figure worse.
"""

from __future__ import annotations

import cv2
import numpy as np

from ..caches.compiled import compiled
from ..geometry.camera import Camera
from ..geometry.frame import RgbdFrame
from ..geometry.mesh import transform_points
from ..model.appearance import channels
from ..model.skin import Skin
from ..parameters import SkinParameters
from ..registration.association import Correspondences
from .laplacian import FeatureTerm, LaplacianDeformation
from .region import FrontalRegion
from .skin_term import SkinTerm

#: Cosine between skin and viewing ray: a sample does not count below the first, and fully from the second on.
FACING = (0.35, 0.65)
#: The residuals of so many neighbouring pixels count as one: what a picture cannot explain is no white noise.
CORRELATED = 3.0
#: Share of the neutral's colours' variance that is found again in a picture: it tells nothing below the first, and is fully
#: believed from the second on. Synthetic faces: 0.8 to 0.96; colour three frames late, in motion: -1.6 to 0.4; no light: -20.
EXPLAINED = (0.3, 0.6)
#: px beside the samples in which the picture is prepared: blurs and shifts reach so far.
_BORDER = 16


class DenseSkin:
    """Follows one actor's ``skin`` with the ``deformation`` of section 4.3."""

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

    def deform(
        self,
        frame: RgbdFrame,
        pose: np.ndarray,
        vertices: np.ndarray,
        start: np.ndarray,
        depth: tuple[Correspondences, np.ndarray],
        features: FeatureTerm,
    ) -> np.ndarray:
        """Displacement (n, 3) of the frontal ``vertices`` (n, 3) of v1 towards depth, features and colours, mm.

        ``start`` (n, 3): the displacement so far, which is returned where no colour tells anything; ``depth``: the matches,
        and their normals (n, 3) in the head frame.
        """
        displacement, measured = start, depth[0].weights > 0
        window = None if frame.colour is None else self._window(frame, pose, vertices + start)
        if frame.colour is None or window is None:
            return start
        u, v, right, bottom = window
        picture, origin = channels(frame.colour[v:bottom, u:right], 0.0), np.array([u, v], float)
        along_u, along_v = (cv2.Scharr(picture, cv2.CV_32F, *axis) / 32.0 for axis in ((1, 0), (0, 1)))
        for _ in range(self.parameters.rounds):
            placed = transform_points(pose, vertices + displacement)
            rows = self._rows((picture, along_u, along_v), origin, frame.camera, placed, pose, measured)
            if not rows[0].any():
                break
            term = SkinTerm.about(self._corners, self._skin.weights, *rows, displacement)
            displacement = self.deformation.deform(*depth, features, displacement, self.parameters.cg_iterations, term)
        return displacement

    def _window(self, frame: RgbdFrame, pose: np.ndarray, vertices: np.ndarray) -> tuple[int, int, int, int] | None:
        """Left, top, right and bottom of the part of the picture that holds the face; None where that is too little."""
        placed = transform_points(pose, vertices)
        if placed[:, 2].min() < 50.0:
            return None
        pixels = frame.camera.project(placed)
        u, v = np.maximum(pixels.min(axis=0).astype(int) - _BORDER, 0)
        right, bottom = np.minimum(pixels.max(axis=0).astype(int) + _BORDER, [frame.camera.width, frame.camera.height])
        return None if min(right - u, bottom - v) < 2 * _BORDER else (int(u), int(v), int(right), int(bottom))

    def _rows(
        self,
        images: tuple[np.ndarray, np.ndarray, np.ndarray],
        origin: np.ndarray,
        camera: Camera,
        placed: np.ndarray,
        pose: np.ndarray,
        measured: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray]:
        """M (Q, 3, 3) and -sum_c w_qc r_qc g_qc (Q, 3), both in the head frame, where vertices are ``placed`` (n, 3)."""
        skin, lens = self._skin, (camera.fx, camera.fy, camera.cx - origin[0], camera.cy - origin[1])
        carried = _carry(placed, self._corners, skin.weights, measured, camera.fx * self.parameters.spacing)
        turn = np.ascontiguousarray(pose[:3, :3])
        return _normal_equations(images, *carried, skin.colours, self._variances, turn, lens, self.parameters.weight)


@compiled(nogil=True)
def _carry(
    vertices: np.ndarray, triangles: np.ndarray, corners: np.ndarray, measured: np.ndarray, reach: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Samples on vertices (n, 3) in the camera frame: points (Q, 3), unit normals (Q, 3), and how much each counts (Q,).

    Nothing where a corner was not ``measured`` (n,), less where the skin turns away, and at most as the independent pixels
    that a sample stands for; ``reach``: the distance between samples times the focal length, mm px.
    """
    points, normals, counts = np.empty((len(triangles), 3)), np.empty((len(triangles), 3)), np.zeros(len(triangles))
    for q in range(len(triangles)):
        a, b, c = triangles[q]
        along, length, distance = 0.0, 0.0, 0.0
        for k in range(3):
            i, j = (k + 1) % 3, (k + 2) % 3
            points[q, k] = corners[q, 0] * vertices[a, k] + corners[q, 1] * vertices[b, k] + corners[q, 2] * vertices[c, k]
            first = (vertices[b, i] - vertices[a, i]) * (vertices[c, j] - vertices[a, j])
            normals[q, k] = first - (vertices[b, j] - vertices[a, j]) * (vertices[c, i] - vertices[a, i])
            along += normals[q, k] * points[q, k]
            length += normals[q, k] ** 2
            distance += points[q, k] ** 2
        length = max(np.sqrt(length), 1e-12)
        for k in range(3):
            normals[q, k] /= length
        if measured[a] and measured[b] and measured[c]:
            facing = (-along / (length * np.sqrt(distance)) - FACING[0]) / (FACING[1] - FACING[0])
            counts[q] = min(max(facing, 0.0), 1.0) * min((reach / points[q, 2]) ** 2, 1.0) / CORRELATED
    return points, normals, counts


@compiled(nogil=True)
def _normal_equations(
    images: tuple[np.ndarray, np.ndarray, np.ndarray],
    points: np.ndarray,
    normals: np.ndarray,
    counts: np.ndarray,
    colours: np.ndarray,
    variances: np.ndarray,
    rotation: np.ndarray,
    lens: tuple[float, float, float, float],
    strength: float,
) -> tuple[np.ndarray, np.ndarray]:
    """M (Q, 3, 3) and -sum_c w_qc r_qc g_qc (Q, 3) of every sample in the head frame; see the module.

    images, three (H, W, 3) float32: the picture's channels, their gradients along u, and along v. points, normals (Q, 3) in the
    camera frame, counts (Q,); colours and variances (Q, 3) of the neutral; rotation (3, 3) head to camera; lens: fx, fy, cx
    and cy of the picture.
    """
    fx, fy, cx, cy = lens
    height, width = images[0].shape[:2]
    values = np.zeros((len(points), 3, 3))
    misfit, known, squares, certain = np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(3)
    for q in range(len(points)):
        if counts[q] == 0.0:
            continue
        x = fx * points[q, 0] / points[q, 2] + cx
        y = fy * points[q, 1] / points[q, 2] + cy
        if not (0.0 <= x < width - 1 and 0.0 <= y < height - 1):
            counts[q] = 0.0
            continue
        i, j = int(y), int(x)
        b, a = y - i, x - j
        for k in range(3):
            image = images[k]
            for c in range(3):
                above = (1 - a) * image[i, j, c] + a * image[i, j + 1, c]
                below = (1 - a) * image[i + 1, j, c] + a * image[i + 1, j + 1, c]
                values[q, k, c] = (1 - b) * above + b * below
        for c in range(3):
            values[q, 0, c] -= colours[q, c]
            weight = counts[q] / variances[q, c]
            misfit[c] += weight * values[q, 0, c] ** 2
            known[c] += weight * colours[q, c]
            squares[c] += weight * colours[q, c] ** 2
            certain[c] += weight
    matrices, pulls = np.zeros((len(points), 3, 3)), np.zeros((len(points), 3))
    total = counts.sum()
    if total == 0.0:
        return matrices, pulls
    trust = _trust(misfit, squares - known**2 / certain)
    misfit = np.maximum(misfit / total, 1.0)
    row, turned = np.empty(3), np.empty(3)
    for q in range(len(points)):
        if counts[q] == 0.0:
            continue
        for c in range(3):
            if trust[c] == 0.0:
                continue
            variance = misfit[c] * variances[q, c]
            residual, du, dv = values[q, 0, c], values[q, 1, c] * fx / points[q, 2], values[q, 2, c] * fy / points[q, 2]
            row[0], row[1] = du, dv
            row[2] = -(du * points[q, 0] + dv * points[q, 1]) / points[q, 2]
            along = row[0] * normals[q, 0] + row[1] * normals[q, 1] + row[2] * normals[q, 2]
            for k in range(3):
                row[k] -= along * normals[q, k]
            for k in range(3):
                turned[k] = rotation[0, k] * row[0] + rotation[1, k] * row[1] + rotation[2, k] * row[2]
            weight = strength * trust[c] * counts[q] / (variance * (1.0 + residual**2 / (3.0 * variance)) ** 2)
            for k in range(3):
                pulls[q, k] -= weight * residual * turned[k]
                for m in range(3):
                    matrices[q, k, m] += weight * turned[k] * turned[m]
    return matrices, pulls


@compiled(nogil=True)
def _trust(misfit: np.ndarray, variation: np.ndarray) -> np.ndarray:
    """(3,) in [0, 1]: how far the channels are believed, by what is left (3,) of the variation (3,) of the neutral's colours.

    Each by itself, and all of them by the sum: a colour that changes little over the face fits where all is displaced, too.
    """
    whole = _share(misfit.sum(), variation.sum())
    return np.array([whole * _share(misfit[c], variation[c]) for c in range(3)])


@compiled(nogil=True)
def _share(left: float, variation: float) -> float:
    explained = 1.0 - left / max(variation, 1e-12)
    return min(max((explained - EXPLAINED[0]) / (EXPLAINED[1] - EXPLAINED[0]), 0.0), 1.0)
