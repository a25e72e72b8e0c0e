"""Section 3, between fit and shrink-wrap: what no identity mode holds, as a prior of its own.

Nobody is a mixture of a model's identity modes. Where a scan tells more than the modes can follow, a fit of modes alone
bends them, and the mesh slides along the skin. So the head is fitted once more, and may leave the modes by a smooth random
field: a Gaussian process of zero mean, which makes more modes of a statistical model (Lüthi et al. 2018, "Gaussian process
morphable models"). Its size is what the fit of the modes left between head and scan.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..model.face_model import FaceModel
from ..parameters import FitParameters
from .fit import Head, IdentityFit, fit_head
from .fuse import FusedScan

#: The field's correlation: lengths, mm, and the share that each has in its variance.
LENGTHS, SHARES = (35.0, 15.0), (0.43, 0.57)
#: Share of the variance that the kept fields hold; distance between the points on the face that carry them, mm.
KEPT, SPACING = 0.96, 11.0
#: Rounds of the second fit. It expects distances from the scan of this many times the fields' size and the scan's noise, at
#: least the last number of mm: shorter waves than the fields' are left to the shrink-wrap.
ROUNDS, LOOSE, FINEST = 8, 1.5, 0.15
#: Median distance of the features from the head of the modes beyond which there is no detail: mm, and pixels of the depth map.
STRAY_MM, STRAY_PIXELS = 3.0, 3.0
#: Standard deviation of a normal distribution over its median absolute value.
NORMAL = 1.4826


def detail_fields(model: FaceModel) -> np.ndarray:
    """(K, V) smooth fields over the head: a standard normal mixture of them is the random field of unit size on the face.

    The largest parts (Nyström's) of the covariance between points on the face. They die out behind it.
    """
    points = model.mean[_spread(model.mean, model.frontal, SPACING)]
    value, vector = np.linalg.eigh(_covariance(points, points))
    value, vector = value[::-1], vector[:, ::-1]
    count = int(np.searchsorted(np.cumsum(value) / value.sum(), KEPT)) + 1
    fields: np.ndarray = (_covariance(model.mean, points) @ (vector[:, :count] / np.sqrt(value[:count]))).T
    return fields


def _covariance(points: np.ndarray, others: np.ndarray) -> np.ndarray:
    square = ((points[:, None] - others) ** 2).sum(axis=2)
    covariance: np.ndarray = np.zeros_like(square)
    for length, share in zip(LENGTHS, SHARES, strict=True):
        covariance += share * np.exp(-square / (2.0 * length**2))
    return covariance


def _spread(points: np.ndarray, region: np.ndarray, spacing: float) -> np.ndarray:
    """Numbers of points (V, 3) in the ``region`` (V,), about ``spacing`` mm apart."""
    free, chosen = region.copy(), []
    for number in np.flatnonzero(region):
        if free[number]:
            chosen.append(number)
            free &= ((points - points[number]) ** 2).sum(axis=1) > spacing**2
    return np.array(chosen, int)


def _features_stray(scan: FusedScan, fit: IdentityFit) -> bool:
    """Whether the 2D features lie so far from the head of the modes that they are of another picture than the depth."""
    away = fit.feature_rms[np.isfinite(fit.feature_rms)]
    if not len(away) or not len(scan.poses):
        return False
    pixels = np.median([camera.fx / pose[2, 3] for camera, pose in zip(scan.cameras, scan.poses, strict=True)])
    return bool(np.median(away) > max(STRAY_MM, STRAY_PIXELS / pixels))


def fit_detail(scan: FusedScan, model: FaceModel, fit: IdentityFit, parameters: FitParameters) -> IdentityFit:
    """Fit the head once more, with the smooth fields as further modes.

    The fit stays as it is for ``parameters.detail`` of 0. It also does where the features stray from it: pictures that are not
    registered to the depth would bend the fields, and nothing would tell of it any more.

    Parameters
    ----------
    scan : FusedScan
        The merged neutral scan.
    model : FaceModel
        Its mean and identity modes.
    fit : IdentityFit
        Where to start, and what the size of the fields is taken from.
    parameters : FitParameters
        Weights and limits.

    Returns
    -------
    IdentityFit
        ``vertices`` hold the fields, ``identity`` does not.
    """
    size = parameters.detail * float(np.sqrt(max((NORMAL * fit.residual) ** 2 - scan.noise**2, 0.0)))
    if size == 0.0 or _features_stray(scan, fit):
        return fit
    known = len(fit.identity)
    fields = detail_fields(model)
    # A field along each axis is a mode; its standard deviation is the size.
    modes = np.zeros((3, *fields.shape, 3))
    for axis in range(3):
        modes[axis, :, :, axis] = size * fields
    modes = np.concatenate([model.identity_modes[:known], modes.reshape(-1, *model.mean.shape)])
    start = Head(fit.scan_from_head, np.concatenate([fit.identity, np.zeros(len(modes) - known)]), fit.expression)
    closer = replace(parameters, iterations=ROUNDS, scan_sigma=max(LOOSE * float(np.hypot(size, scan.noise)), FINEST))
    found = fit_head(scan, replace(model, identity_modes=modes), closer, start)
    return replace(found, identity=found.identity[:known], history=np.concatenate([fit.history, found.history]))
