"""What of a neutral scan is skin: hair is left out, noise is smoothed away, detail is kept."""

from dataclasses import replace

import numpy as np

from adaptiveface.geometry.mesh import cotangent_laplacian, vertex_normals
from adaptiveface.model.face_model import embedded_face_model
from adaptiveface.neutral.capture import fit_to_skin
from adaptiveface.neutral.fuse import FusedScan, fuse_frames
from adaptiveface.neutral.hair import without_hair
from adaptiveface.neutral.shrink_wrap import shrink_wrap, smoothed
from adaptiveface.parameters import Parameters
from adaptiveface.synthetic.sensor import SyntheticSensor

MODEL = embedded_face_model()
LIMIT = Parameters().fit.hair


def scan_of(vertices: np.ndarray, raised: np.ndarray, noise: float = 0.0) -> FusedScan:
    """A scan that holds the middle of every triangle in front, each ``raised`` (T,) mm above the skin, with white noise."""
    normals = vertex_normals(vertices, MODEL.triangles)[MODEL.triangles].mean(axis=1)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    raised = raised + noise * np.random.default_rng(0).normal(size=len(raised))
    points = vertices[MODEL.triangles].mean(axis=1) + raised[:, None] * normals
    seen = normals[:, 2] > 0.1
    empty = np.zeros(0)
    points, normals = points[seen], normals[seen]
    return FusedScan(points, normals, np.full(len(points), 9.0), empty, np.zeros((0, 4, 4)), empty, (), ())


def middles() -> np.ndarray:
    """(T, 3) middles of the triangles of the average head."""
    return MODEL.mean[MODEL.triangles].mean(axis=1)


def fringe() -> np.ndarray:
    """(T,) mm: hair over the left half of the forehead, and above it."""
    top, at = MODEL.mean[MODEL.frontal][:, 1].max(), middles()
    return np.where((at[:, 1] > top - 25.0) & (at[:, 0] > 0.0) & (at[:, 2] > 0.0), 11.0, 0.0)


def nose() -> np.ndarray:
    """(T,) mm: a tip of the nose that stands out as far."""
    tip = MODEL.mean[MODEL.frontal][MODEL.mean[MODEL.frontal][:, 2].argmax()]
    return np.where(np.linalg.norm(middles() - tip, axis=1) < 12.0, 11.0, 0.0)


def test_hair_is_left_out_and_a_nose_is_not():
    seen = vertex_normals(MODEL.mean, MODEL.triangles)[MODEL.triangles].mean(axis=1)
    seen = seen[:, 2] / np.linalg.norm(seen, axis=1) > 0.1
    scan = scan_of(MODEL.mean, fringe() + nose())
    skin, under = without_hair(scan, MODEL, MODEL.mean, LIMIT)
    left = set(map(tuple, skin.points))
    kept = np.array([tuple(point) in left for point in scan.points])
    hair, stands_out = fringe()[seen] > 0, nose()[seen] > 0
    assert kept[hair].mean() < 0.02 and kept[stands_out].all() and kept[~hair].mean() > 0.97
    assert under[MODEL.mean[:, 1] > MODEL.mean[MODEL.frontal][:, 1].max() - 5.0].any()
    assert not under[MODEL.mean[:, 1] < 0.0].any()


def test_a_scan_without_hair_is_the_same_scan():
    scan = scan_of(MODEL.mean, nose(), noise=0.3)
    assert without_hair(scan, MODEL, MODEL.mean, LIMIT)[0] is scan
    assert without_hair(scan_of(MODEL.mean, fringe()), MODEL, MODEL.mean, 0.0)[1].sum() == 0


def test_the_wrap_keeps_the_forehead_under_hair_that_thins_out():
    at, top = middles(), MODEL.mean[MODEL.frontal][:, 1].max()
    thinning = np.where(at[:, 2] > 0.0, np.clip((at[:, 1] - top + 40.0) / 3.0, 0.0, 11.0), 0.0)
    scan = scan_of(MODEL.mean, thinning, noise=0.7)
    forehead = MODEL.frontal & MODEL.depth_valid & (MODEL.mean[:, 1] > top - 25.0)
    wrap, errors = replace(Parameters().shrink_wrap, iterations=4), {}
    for limit in (0.0, LIMIT):
        skin, hair = without_hair(scan, MODEL, MODEL.mean, limit)
        wrapped = shrink_wrap(skin, MODEL, MODEL.mean, wrap, hair).vertices
        errors[limit] = np.linalg.norm(wrapped - MODEL.mean, axis=1)[forehead].mean()
    assert errors[LIMIT] < 1.0 and errors[LIMIT] < 0.5 * errors[0.0]


def test_the_head_is_fitted_again_without_hair():
    scan, parameters = scan_of(MODEL.mean, fringe()), replace(Parameters().fit, modes=6, iterations=8)
    skin, fit, hair = fit_to_skin(scan, MODEL, parameters)
    assert len(skin.points) < len(scan.points) and hair.any()
    assert np.abs(fit.identity).max() < 0.1
    assert fit_to_skin(scan, MODEL, replace(parameters, hair=0.0))[0] is scan


def bumpiness(vertices: np.ndarray) -> float:
    """Root mean square of the Laplacian of what the face differs by from the average head, mm."""
    off = ((vertices - MODEL.mean) * vertex_normals(MODEL.mean, MODEL.triangles)).sum(axis=1)
    bent = cotangent_laplacian(MODEL.mean, MODEL.triangles, non_negative=True) @ off
    return float(np.sqrt(np.mean(bent[MODEL.frontal & MODEL.depth_valid] ** 2)))


def test_a_noisy_scan_is_smoothed_by_its_noise():
    scan = scan_of(MODEL.mean, np.zeros(len(MODEL.triangles)), noise=0.5)
    p = Parameters().shrink_wrap
    rough, smooth = (
        shrink_wrap(s, MODEL, MODEL.mean, replace(p, iterations=3)).vertices for s in (scan, replace(scan, noise=0.5))
    )
    assert bumpiness(smooth) < 0.3 * bumpiness(rough)
    assert smoothed(p, p.noise) is p and smoothed(replace(p, noise=0.0), 1.0).noise == 0.0


def test_more_frames_leave_less_noise():
    sensor = SyntheticSensor(5, "structured-light", 8, 1, repeats=1, colour=False)
    frames = [sensor.read(k) for k in range(8)]
    one, eight = (fuse_frames(frames[:count], MODEL).noise for count in (1, 8))
    assert 0.25 < one < 1.0 and 0.1 < eight < 0.6 * one


def test_the_papers_parameters_smooth_all_alike_and_know_no_hair():
    paper = Parameters.paper()
    assert paper.fit.hair == 0.0 and paper.shrink_wrap.noise == 0.0
