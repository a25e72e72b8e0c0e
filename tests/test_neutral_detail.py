"""The smooth detail that no identity mode holds, as a prior of the fit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from test_neutral_skin import scan_of

from adaptiveface.evaluation import metrics
from adaptiveface.geometry.camera import Camera
from adaptiveface.geometry.mesh import transform_points, vertex_normals
from adaptiveface.model.face_model import embedded_face_model
from adaptiveface.neutral.capture import fit_to_skin
from adaptiveface.neutral.detail import detail_fields, fit_detail
from adaptiveface.neutral.fit import fit_identity
from adaptiveface.parameters import Parameters
from adaptiveface.synthetic.fields import smooth_field

MODEL = embedded_face_model()
FACE = MODEL.frontal & MODEL.depth_valid


def off_along_the_skin(vertices: np.ndarray, truth: np.ndarray) -> float:
    """Mean distance within the surface, mm, of vertices (V, 3) of the face from the true ones."""
    _, along = metrics.split_by_normal(vertices - truth, vertex_normals(truth, MODEL.triangles))
    return float(along[FACE].mean())


def test_a_person_beyond_the_modes_slides_less_along_the_skin():
    fit, kept = Parameters().fit, {}
    for share in (0.0, fit.detail):
        off = []
        for seed in range(3):
            rng = np.random.default_rng(seed)
            truth = MODEL.neutral(0.9 * rng.normal(size=len(MODEL.identity_modes)))
            truth = truth + sum(size * smooth_field(rng, truth, wave, 3) for wave, size in ((140.0, 0.25), (60.0, 0.3)))
            scan = scan_of(truth, np.zeros(len(MODEL.triangles)), noise=0.05)
            _, found, _ = fit_to_skin(scan, MODEL, replace(fit, detail=share, hair=0.0))
            off.append(off_along_the_skin(transform_points(found.scan_from_head, found.vertices), truth))
        kept[share] = np.mean(off)
    assert kept[fit.detail] < 0.9 * kept[0.0], kept


def test_the_fields_are_smooth_of_unit_size_and_die_out_behind():
    fields = detail_fields(MODEL)
    variance = (fields**2).sum(axis=0)
    assert 0.8 < variance[MODEL.frontal].mean() < 1.01
    assert variance[MODEL.mean[:, 2] < MODEL.mean[:, 2].min() + 40.0].max() < 0.05


def test_modes_alone_where_there_is_no_detail():
    paper, scan = Parameters.paper().fit, scan_of(MODEL.mean, np.zeros(len(MODEL.triangles)))
    fit = fit_identity(scan, MODEL, replace(paper, modes=6, iterations=6))
    assert paper.detail == 0 and fit_detail(scan, MODEL, fit, paper) is fit
    assert fit_detail(replace(scan, noise=5.0), MODEL, fit, Parameters().fit) is fit


@pytest.mark.parametrize("modes", [0, 6])
def test_the_identity_stays_that_of_the_modes(modes):
    scan = scan_of(MODEL.mean + [0.0, 0.0, 0.3], np.zeros(len(MODEL.triangles)), noise=0.3)
    parameters = replace(Parameters().fit, modes=modes, iterations=8)
    fit = fit_identity(scan, MODEL, parameters)
    assert fit_detail(scan, MODEL, fit, parameters).identity.shape == (modes,)


@pytest.mark.parametrize(
    ("mm", "focal", "stray"), [(1.0, 540.0, False), (5.8, 540.0, True), (5.3, 230.0, False), (2.5, 1000.0, False)]
)
def test_features_of_another_picture_bend_no_detail(mm, focal, stray):
    """Features 20 px beside a TrueDepth scan lie 5.8 mm off; on a Kinect v2 at 0.6 m, 5.3 mm are two pixels."""
    scan = scan_of(MODEL.mean + [0.0, 0.0, 0.3], np.zeros(len(MODEL.triangles)), noise=0.3)
    pose = np.diag([1.0, -1.0, -1.0, 1.0])
    pose[2, 3] = 600.0
    scan = replace(scan, cameras=(Camera(640, 480, focal, focal, 320.0, 240.0),), poses=pose[None], features=(None,))
    parameters = replace(Parameters().fit, modes=4, iterations=6)
    fit = replace(fit_identity(scan, MODEL, parameters), feature_rms=np.full(40, mm), residual=1.0)
    assert (fit_detail(scan, MODEL, fit, parameters) is fit) == stray
