"""What the notebooks 00 to 04 show beside their texts: numbers against known truths, and what a lost head looks like."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

pytest.importorskip("ipywidgets", reason="the extra 'notebooks' is not installed")
pytest.importorskip("pyvista", reason="the extra 'notebooks' is not installed")

from scenes import coefficients, exact_actor, head_pose, posed_shape, render_frame  # noqa: E402

from adaptiveface import views  # noqa: E402
from adaptiveface.evaluation import GroundTruth, TruthFrame  # noqa: E402
from adaptiveface.geometry.mesh import transform_points  # noqa: E402
from adaptiveface.model.face_model import embedded_face_model  # noqa: E402
from adaptiveface.studies import closest as closest_study
from adaptiveface.studies import fit, icp
from adaptiveface.studies.session import Session  # noqa: E402
from adaptiveface.views import fit_study, neutral_study  # noqa: E402


def jaw(index: int) -> float:
    return 0.12 * index


@pytest.fixture(scope="module")
def session() -> Session:
    """Six frames of an opening jaw with their truth, and the rig they were rendered from."""
    actor = exact_actor()
    shapes = [posed_shape(actor, coefficients(actor, **{actor.expression_names[0]: jaw(i)})) for i in range(6)]
    poses = [head_pose((0, 0.01 * i, 0)) for i in range(6)]
    frames = [render_frame(actor, shapes[i], poses[i], i, noise=0.3, pixel_noise=0.2) for i in range(6)]
    truth = GroundTruth(actor.neutral, lambda i: TruthFrame(transform_points(poses[i], shapes[i]), poses[i], 0), 6)
    return Session("jaw", frames[0].camera, frames[:2], frames, truth, _actor=actor)


def test_the_closest_expression_is_the_one_that_was_performed(session):
    closest = closest_study.closest_expression(session)
    expected = np.zeros(len(session.actor.blendshapes))
    expected[0] = jaw(5)
    assert closest.index == 5, "the jaw is open widest in the last frame"
    np.testing.assert_allclose(closest.coefficients, expected, atol=1e-3)
    assert np.nanmax(closest.remaining) < 0.05
    assert (np.isnan(closest.remaining) == ~session.actor.frontal).all()


def test_the_distance_to_the_truth_ignores_where_the_head_frame_lies():
    head = embedded_face_model().neutral(np.array([1.0, -0.5]))
    truth = GroundTruth(head, lambda i: None, 0)
    assert closest_study.distance_to_truth(transform_points(head_pose((0.1, 0.2, 0.0)), head), truth).max() < 1e-3
    assert np.median(closest_study.distance_to_truth(1.02 * head, truth)) > 0.3


def test_pose_errors_are_small_where_the_rig_is_exact(session):
    errors = icp.pose_errors(session)
    assert errors.shape == (6, 2)
    assert np.median(errors, axis=0) == pytest.approx([0.0, 0.0], abs=0.5)
    assert len(icp.pose_errors(session, rigid__max_residual=0.1)) < 6, "lost frames have none"


def test_a_lost_head_has_no_error_to_show(session):
    measures, result = views.Measures(session), views.Replay(session.frames, session.actor).run()[3]
    assert np.isfinite(measures.error(result, session.frames[3])).any()
    assert np.isnan(measures.error(dataclasses.replace(result, tracked=False), session.frames[3])).all()


def test_the_chart_of_coefficients_follows_the_jaw_and_the_number_of_expressions(session):
    replay = views.Replay(session.frames, session.actor)
    results = replay.run()
    chosen = fit.liveliest(fit.fitted_coefficients(results), 2)
    assert chosen[0] == 0
    _, lines = fit_study.coefficient_chart(session, [0, len(session.actor.blendshapes) - 1])
    jaws, last = lines(replay).values()
    np.testing.assert_allclose(jaws, [jaw(i) for i in range(6)], atol=0.1)
    assert np.isfinite(last).all()
    fewer = views.Replay(session.frames, session.actor, views.Parameters().replace(blendshapes__A=5))
    fewer.run()
    jaws, last = lines(fewer).values()
    assert np.isfinite(jaws).all() and np.isnan(last).all()


def test_the_camera_view_shows_the_depth_map_where_it_is_asked_for(session):
    view = views.CameraView((100, 120), depth=True)
    view.show(session.frames[0])
    first = view._depth.value
    view.show(dataclasses.replace(session.frames[0], depth=0 * session.frames[0].depth))
    assert len(first) > len(view._depth.value) > 0, "nothing measured is plain black"


def test_the_scan_study_tells_how_many_frames_were_merged(session):
    study = neutral_study.ScanStudy(session)
    assert study.note.startswith("1 frame merged")
    study.frames.value = 2
    assert study.note.startswith("2 frames merged")
    study.close()
