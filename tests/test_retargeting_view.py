"""The retargeting panel without a browser: modes, sliders, playback, correctives."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("ipywidgets", reason="the extra 'notebooks' is not installed")
pytest.importorskip("pyvista", reason="the extra 'notebooks' is not installed")

from scenes import coefficients, exact_actor, head_pose, posed_shape, render_frame  # noqa: E402

from adaptiveface import views  # noqa: E402
from adaptiveface.studies.session import Session  # noqa: E402
from adaptiveface.views.retargeting_study import (  # noqa: E402
    COMPARED,
    CORRECTIVES,
    INITIAL,
    RESOLVED,
    SLIDERS,
    RetargetingStudy,
)


@pytest.fixture(scope="module")
def study() -> RetargetingStudy:
    """Five frames of an opening jaw."""
    actor = exact_actor()
    frames = [render_frame(actor, posed_shape(actor, coefficients(actor, jawOpen=0.2 * i)), head_pose(), i) for i in range(5)]
    session = Session("jaw", frames[0].camera, frames[:1], frames, _actor=actor)
    return RetargetingStudy(session, views.Replay(frames, actor).run(), ("hag",), pane=120)


def test_learned_expressions_are_what_the_coefficients_mean(study):
    """With expressions twice as large, half the coefficients make the same mesh."""
    twice = 2.0 * study.actor.blendshapes[: len(study.names)]
    session = Session("jaw", None, [], [], _actor=study.actor)
    other = RetargetingStudy(session, study.results, ("hag",), pane=120, expressions=twice)
    jaw = study.names.index("jawOpen")
    assert other.resolved[4, jaw] == pytest.approx(0.5 * study.resolved[4, jaw], abs=0.02)
    other.sliders["jawOpen"].value = 0.5
    np.testing.assert_allclose(other.shapes(0)[0] - study.actor.neutral, 0.5 * twice[jaw], atol=1e-4)


def mouth(study, index: int) -> float:
    """Opening of the hag's mouth, mm: inner lips in the middle."""
    character = study.characters[0]
    shape = study.shapes(index)[1]
    from adaptiveface.geometry.mesh import surface_points
    from adaptiveface.model.face_model import embedded_face_model

    model = embedded_face_model()
    points = surface_points(shape[: character.skin], model.feature_triangles, model.feature_weights)
    return points[34, 1] - points[38, 1]


def test_modes_drive_the_character(study):
    for mode in (RESOLVED, INITIAL, CORRECTIVES):
        study.mode.value = mode
        assert mouth(study, 4) > mouth(study, 0) + 5
    study.mode.value = RESOLVED
    plain = study.shapes(4)[1]
    study.mode.value = CORRECTIVES
    assert np.abs(study.shapes(4)[1] - plain).max() > 0
    assert not study.message.value


def test_one_character_by_all_three_side_by_side(study):
    study.player.go_to(4)
    study.mode.value = COMPARED
    faces = study.faces(4)
    assert [title for _, _, title in faces] == ["actor", INITIAL, RESOLVED, CORRECTIVES]
    assert [face.name for face, _, _ in faces] == ["actor", "hag", "hag", "hag"]
    for title, shape in ((INITIAL, faces[1][1]), (RESOLVED, faces[2][1]), (CORRECTIVES, faces[3][1])):
        study.mode.value = title
        np.testing.assert_allclose(study.shapes(4)[1], shape)
    assert np.abs(faces[1][1] - faces[2][1]).max() > 0.01 and np.abs(faces[3][1] - faces[2][1]).max() > 0.01
    study.mode.value = COMPARED
    assert study.picture().shape == (120, 480, 3)


def test_a_moved_slider_takes_over(study):
    study.mode.value = RESOLVED
    before = study.picture()
    study.sliders["jawOpen"].value = 0.9
    assert study.mode.value == SLIDERS and mouth(study, 0) > 10
    after = study.picture()
    assert after.shape == (120, 240, 3) and (before != after).any(axis=2).sum() > 200
    seen = [after]
    for camera in ([40.0, 0.0, 1.0], [40.0, 25.0, 1.0], [40.0, 25.0, 1.6]):  # what the mouse sends
        sent = bytes(study.view.value)
        study.view.camera = camera
        assert bytes(study.view.value) != sent  # it redraws
        seen.append(study.picture())
        assert (seen[-1] != seen[-2]).any(axis=2).sum() > 500
    study.view.camera = [0.0, 0.0, 1.0]


def test_the_faces_stand_on_the_colour_of_the_page(study):
    light, sent = study.picture(), bytes(study.view.value)
    study.view.background = [17, 17, 17]  # what the browser sends in JupyterLab's dark theme
    dark = study.picture()
    assert bytes(study.view.value) != sent and (dark[-1, 0] == 17).all() and (light[-1, 0] == 255).all()
    title = np.s_[4:18, 6:60]
    assert dark[title].max() > 200 and light[title].min() < 80
    study.view.background = [255, 255, 255]


def test_playback_draws_every_frame(study):
    study.mode.value = RESOLVED
    pictures = []
    for index in range(5):
        study.player.go_to(index)
        pictures.append(bytes(study.view.value))
    assert len(set(pictures)) == 5
    study.close()


def test_another_price_on_expressions_is_solved_and_shown(study):
    study.mode.value = RESOLVED
    study.player.go_to(4)
    before, cheap = study.view.value, study.resolved.copy()
    dear = study.resolve(200.0)
    assert dear is study.resolved and dear[4].sum() < cheap[4].sum() - 0.1
    assert study.view.value != before, "the faces show it"
    assert np.array_equal(study.resolve(), cheap)


def test_the_actor_has_eyes_and_a_mouth_inside(study):
    """No background shows through the head: from every row's first to last pixel of the face there are no holes."""
    study.mode.value = RESOLVED
    study.player.go_to(4)
    pane = study.picture()[20:, : study.pane]  # below the title
    empty = (pane == 255).all(axis=2)
    holes = 0
    for row in empty:
        face = np.flatnonzero(~row)
        if len(face):
            holes += int(row[face[0] : face[-1]].sum())
    assert holes < 10
