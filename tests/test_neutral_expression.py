"""A neutral scan that shows a smile: the smile is told from the person, and taken off."""

from dataclasses import replace

import numpy as np
import pytest
from scenes import CAMERA, head_pose

from adaptiveface.geometry.expression_names import SCORE_NAMES
from adaptiveface.geometry.frame import LANDMARKS, DetectedFace, Features2D
from adaptiveface.geometry.mesh import rigid_alignment, surface_points, transform_points, vertex_normals
from adaptiveface.model.face_model import embedded_face_model
from adaptiveface.neutral.expression import TELLING, ExpressionPrior, expressiveness, without_expression
from adaptiveface.neutral.fit import IdentityFit, fit_identity
from adaptiveface.neutral.fuse import FusedScan
from adaptiveface.parameters import FitParameters, Parameters

MODEL = embedded_face_model()
PARAMETERS = FitParameters(modes=20, iterations=12, contour=False)


def scored(**scores: float) -> DetectedFace:
    """A detected face of which only the scores are told."""
    return DetectedFace(np.zeros((LANDMARKS, 3)), np.array([scores.get(name, 0.0) for name in SCORE_NAMES]))


def expression(**strengths: float) -> np.ndarray:
    return np.array([strengths.get(name, 0.0) for name in MODEL.generic_names])


SMILE = expression(mouthSmileLeft=0.8, mouthSmileRight=0.7)
#: What a detector makes of it: less, and uneven.
SCORES = {"mouthSmileLeft": 0.5, "mouthSmileRight": 0.6}


def scan_of(vertices: np.ndarray, **scores: float) -> FusedScan:
    """The middle of every triangle in front, and the 40 features from three sides, with the detector's scores."""
    normals = vertex_normals(vertices, MODEL.triangles)[MODEL.triangles].mean(axis=1)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    points, seen = vertices[MODEL.triangles].mean(axis=1), normals[:, 2] > 0.1
    poses = np.array([head_pose((0, turn, 0)) for turn in (-0.2, 0.0, 0.2)])
    forty = surface_points(vertices, MODEL.feature_triangles, MODEL.feature_weights)
    pixels = [CAMERA.project(transform_points(pose, forty)) for pose in poses]
    features = tuple(Features2D(p, np.ones(40), scored(**scores) if scores else None) for p in pixels)
    weights = np.full(seen.sum(), 9.0)
    return FusedScan(points[seen], normals[seen], weights, np.arange(3), poses, np.zeros(3), features, (CAMERA,) * 3)


def difference(a: np.ndarray, b: np.ndarray) -> float:
    """Root mean square distance of two faces after alignment, mm."""
    a, b = a[MODEL.frontal], b[MODEL.frontal]
    return float(np.sqrt(((transform_points(rigid_alignment(a, b), a) - b) ** 2).sum(axis=1).mean()))


def neutral_of(fit: IdentityFit) -> np.ndarray:
    return without_expression(MODEL, fit.identity, fit.expression, fit.vertices)


IDENTITY = 0.7 * np.random.default_rng(3).normal(size=12)


@pytest.fixture(scope="module")
def person() -> np.ndarray:
    """(V, 3) a neutral head."""
    return MODEL.neutral(IDENTITY)


@pytest.fixture(scope="module")
def smiling(person) -> FusedScan:
    return scan_of(person + np.tensordot(SMILE, MODEL.generic_expressions, axes=1), **SCORES)


def test_a_smiling_scan_ends_at_the_neutral_head(person, smiling):
    neutral = neutral_of(fit_identity(scan_of(person), MODEL, PARAMETERS))
    fit = fit_identity(smiling, MODEL, PARAMETERS)
    baked_in = fit_identity(smiling, MODEL, replace(PARAMETERS, expression=False))
    apart = difference(neutral_of(fit), neutral)
    assert apart < 0.5 and apart < 0.3 * difference(neutral_of(baked_in), neutral)
    assert np.abs(fit.expression - SMILE).max() < 0.15  # from the scan: the scores told 0.3 less
    assert not baked_in.expression.any()
    assert fit.residual < baked_in.residual


@pytest.mark.parametrize("scores", [{}, {"mouthPucker": 0.9, "browInnerUp": 0.7, "mouthSmileLeft": 0.25}])
def test_a_resting_face_is_fitted_as_before(person, scores):
    """Without scores, or with those of faces at rest: what was found for the identity alone, bit for bit."""
    scan = scan_of(person, **scores)
    brief = replace(PARAMETERS, iterations=6)
    now, before = (fit_identity(scan, MODEL, replace(brief, expression=on)) for on in (True, False))
    assert (now.vertices == before.vertices).all() and not now.expression.any()
    assert without_expression(MODEL, now.identity, now.expression, now.vertices) is now.vertices


def test_what_the_scores_tell(smiling):
    prior = ExpressionPrior.of(smiling, MODEL)
    assert (
        prior.mean[MODEL.generic_names.index("mouthSmileRight")] > prior.mean[MODEL.generic_names.index("mouthSmileLeft")] > 0.3
    )
    assert (prior.deviation >= prior.mean).all() and (prior.deviation > 0).all()
    assert expressiveness(None) == expressiveness(DetectedFace(np.zeros((LANDMARKS, 3)))) == 0.0
    assert expressiveness(scored(mouthPucker=1.0, eyeBlinkLeft=1.0)) == 0.0
    assert expressiveness(scored(jawOpen=0.6, mouthFrownLeft=0.1)) == pytest.approx(0.6 / TELLING["jawOpen"])


def test_what_the_modes_do_not_hold_stays_on_the_neutral(person):
    """A bump on the cheek that was scanned with a smile is on the neutral, where the smile had it."""
    cheek = person[MODEL.feature_triangles[20, 0]] + [15.0, 10.0, 0.0]
    bump = 3.0 * np.exp(-((np.linalg.norm(person - cheek, axis=1) / 12.0) ** 2))
    own = person + bump[:, None] * [0.0, 0.0, 1.0]
    scanned = own + np.tensordot(SMILE, MODEL.generic_expressions, axes=1)
    left, moved = (
        np.linalg.norm(head - own, axis=1)[MODEL.frontal].mean()
        for head in (without_expression(MODEL, IDENTITY, SMILE, scanned), scanned)
    )
    assert left < 0.1 * moved


def test_the_papers_parameters_take_the_scan_as_it_is():
    assert not Parameters.paper().fit.expression and Parameters().fit.expression
