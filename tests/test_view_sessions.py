"""What a notebook starts with, of a recording, a video and a saved head: what is tracked of it, and what is said first."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

pytest.importorskip("ipywidgets", reason="the extra 'notebooks' is not installed")

from recordings import talking_head  # noqa: E402
from scenes import coefficients, exact_actor, head_pose, posed_shape, render_frame  # noqa: E402

from adaptiveface import views  # noqa: E402
from adaptiveface.errors import AdaptiveFaceError, FileFormatError  # noqa: E402
from adaptiveface.geometry.mesh import surface_points  # noqa: E402
from adaptiveface.model.face_model import embedded_face_model  # noqa: E402
from adaptiveface.neutral.coverage import choose_by_coverage  # noqa: E402
from adaptiveface.studies.measures import TunedPane, plain  # noqa: E402
from adaptiveface.studies.recorded import PROPORTIONS, read_take  # noqa: E402
from adaptiveface.studies.session import Session  # noqa: E402


@pytest.fixture(scope="module")
def session() -> Session:
    """Eight frames of an opening jaw, and the rig they were rendered from."""
    actor = exact_actor()
    frames = []
    for index in range(8):
        shape = posed_shape(actor, coefficients(actor, jawOpen=0.06 * index))
        frames.append(render_frame(actor, shape, head_pose((0, 0.01 * index, 0)), index, noise=0.5, pixel_noise=0.3))
    return Session("jaw", frames[0].camera, frames[:2], frames, _actor=actor)


def test_neutral_frames_are_calm_and_see_the_face_from_all_sides():
    """The first second looks straight ahead and says something; later the head turns to both sides."""
    actor, model, frames = exact_actor(), embedded_face_model(), []
    for index in range(24):
        jaw = 0.9 if index in (2, 3) else 0.0
        turn = 0.0 if index < 12 else 0.5 * np.sin((index - 12) / 11 * 2 * np.pi)
        shape = posed_shape(actor, coefficients(actor, jawOpen=jaw))
        frames.append(render_frame(actor, shape, head_pose((0, turn, 0)), index, pixel_noise=0.2))
    points = surface_points(model.mean, model.feature_triangles, model.feature_weights)
    picked = choose_by_coverage(frames, points, 12).picked
    assert not {2, 3} & set(picked) and len(picked) <= 12 and picked == sorted(set(picked))
    turns = [np.sin((k - 12) / 11 * 2 * np.pi) for k in picked if k >= 12]
    assert max(turns) > 0.7 and min(turns) < -0.7 and sum(k < 12 for k in picked) >= 6
    still = choose_by_coverage(frames[:12], points, 12).picked
    assert still == [k for k in range(12) if k not in (2, 3)], "nobody turns: the leading ones that are calm"


def test_session_from_a_recording(tmp_path, capsys):
    talking_head(tmp_path / "take", frames=8)
    session = views.load_session(tmp_path / "take", neutral_frames=2, frames=4)
    assert [f.index for f in session.neutral] == [0, 1] and [f.index for f in session.frames] == [2, 3, 4, 5]
    assert session.truth is None and not views.Measures(session).has_truth
    assert capsys.readouterr().out.startswith("take: 4 of 8 frames are tracked, frames 2 to 5; load_session(..., frames=300)")


def test_of_a_short_take_the_neutral_frames_are_tracked_as_well(tmp_path, capsys):
    talking_head(tmp_path / "take", frames=8)
    session = views.load_session(tmp_path / "take", neutral_frames=6)
    assert len(session.frames) == 8 and {f.index for f in session.neutral} <= set(range(8))
    first, second, *_ = capsys.readouterr().out.splitlines()
    assert first == "take: all 8 frames are tracked." and "which are tracked as well" in second
    named = views.load_session(tmp_path / "take" / "intrinsic.json", neutral_frames=[5, 2])
    assert [f.index for f in named.neutral] == [2, 5] and len(named.frames) == 8
    with pytest.raises(AdaptiveFaceError, match="no face is seen in the frames 100 to 139"):
        views.load_session(tmp_path / "take", neutral_frames=range(100, 140))
    with pytest.raises(AdaptiveFaceError, match="none of the frames from 8 on can be used; it has 8"):
        views.load_session(tmp_path / "take", first=8)
    with pytest.raises(AdaptiveFaceError, match="neutral_frames = 0: at least 1 frame of take must show the face at rest"):
        views.load_session(tmp_path / "take", neutral_frames=0)


def test_a_doubtful_neutral_is_said_plainly(session):
    """Chosen or named: what is wrong with its frames, and what follows from it, on a line of its own."""
    actor, frames = session.actor, []
    for index in range(6):
        shape = posed_shape(actor, coefficients(actor, jawOpen=0.9))
        frames.append(render_frame(actor, shape, head_pose((0, 0.01 * index, 0)), index, pixel_noise=0.2))
    for wanted, others in ((4, True), (range(2, 6), False)):
        note = read_take(Session("jaw", session.camera, [], frames), wanted, 6).note
        first, face, doubt = note.splitlines()
        assert first == "jaw: all 6 frames are tracked." and face.startswith("The neutral face: frames ")
        assert doubt.startswith("The neutral frames are doubtful: of 4, the face is with an open mouth in 4.")
        assert "missing from all of them" in doubt and doubt.endswith("names others.") == others
    assert "doubtful" not in read_take(session, 2, 6).note + read_take(session, range(2), 6).note


@pytest.mark.parametrize("count", [1, 2])
def test_a_take_of_one_frame_has_a_workbench(tmp_path, count):
    actor = talking_head(tmp_path / "take", frames=count)
    take = views.load_session(tmp_path / "take", actor=actor)
    assert views.Measures(take).top(2) == 5, "distances from a depth map, its noise included"
    bench = views.StageExplorer(
        take, ["laplacian.w2"], {"v4": views.Measures(take).stage("v4")}, [views.error_chart(take, views.Measures(take))]
    )
    assert len(bench.replay.results) == count and bench.result.tracked
    bench.close()


def test_a_saved_head_opens_with_any_source(tmp_path, capsys):
    """Nothing is captured; a head that is not the performer's is named one."""
    own = talking_head(tmp_path / "take", frames=4)
    own.save(tmp_path / "head.npz")
    session = views.load_session(tmp_path / "take", actor=tmp_path / "head.npz")
    np.testing.assert_allclose(session.actor.neutral, own.neutral, atol=1e-3)
    assert capsys.readouterr().out.splitlines()[-1] == f"The head is {tmp_path / 'head.npz'}."
    views.load_session("synthetic:3:none", neutral_frames=2, frames=2, cache=tmp_path, actor=own)
    assert "The head is the given one: another person's" in capsys.readouterr().out
    with pytest.raises(FileFormatError, match="nowhere.npz: no such file"):
        views.load_session(tmp_path / "take", actor=tmp_path / "nowhere.npz")
    with np.load(tmp_path / "head.npz") as old:
        np.savez(tmp_path / "old.npz", **{name: old[name] for name in old.files if name != "frontal"})
    with pytest.raises(FileFormatError, match="old.npz.*frontal"):
        views.load_session(tmp_path / "take", actor=tmp_path / "old.npz")


def test_what_is_not_tracked_and_why_is_said_first(session):
    frames = list(session.frames)
    for k in (0, 3):
        frames[k] = dataclasses.replace(frames[k], features=None, depth=np.zeros_like(frames[k].depth))
    bench = views.StageExplorer(dataclasses.replace(session, frames=frames), ["laplacian.w2"], {"v4": plain("v4")})
    assert bench.verdict.value == "6 of 8 frames are tracked; the others: the depth map is empty (2)"
    bench.close()


def test_a_video_is_tracked_by_its_features(session, tmp_path):
    """Without depth: the degraded tracker, no error of a vertex, and the distance from the features in its place."""
    flat = [dataclasses.replace(f, depth=np.zeros_like(f.depth)) for f in session.frames]
    video = dataclasses.replace(session, frames=flat, colour_only=True)
    assert read_take(video, 2, 6).note.splitlines()[-1] == PROPORTIONS
    measures = views.Measures(video)
    chart = views.error_chart(video, measures, ("v1", "v4"))
    bench = views.StageExplorer(video, ["blendshapes"], {"v4": measures.stage("v4")}, [chart], label=measures.label)
    assert all(result.tracked for result in bench.replay.results) and measures.label == "" and measures.unit == "px"
    curve = chart[1](bench.replay)["v4"]
    assert np.isfinite(curve).all() and 0 < np.median(curve) < 5
    bench.close()


def test_a_notebook_about_depth_refuses_a_video(tmp_path):
    av = pytest.importorskip("av", reason="the extra 'landmarks' is not installed")
    with av.open(str(tmp_path / "grey.mp4"), "w") as video:
        stream = video.add_stream("mpeg4", rate=30)
        stream.width, stream.height = 64, 48
        for _ in range(3):
            video.mux(stream.encode(av.VideoFrame.from_ndarray(np.full((48, 64, 3), 90, np.uint8))))
        video.mux(stream.encode())
    with pytest.raises(AdaptiveFaceError, match="grey.mp4: has no depth, which this notebook is about"):
        views.load_session(tmp_path / "grey.mp4", needs_depth=True)


def test_a_tuned_pane_follows_the_explorers_parameters(session):
    pane = TunedPane(lambda result, frame, parameters: (result.v1, np.full(len(result.v1), parameters.laplacian.w1)))
    explorer = views.StageExplorer(session, ["laplacian"], {"w1": pane, "v4": plain("v4")}, camera=False)
    try:
        explorer.set(laplacian__w1=0.25)
        assert (explorer.view._shown[0].heat == 0.25).all() and explorer.view._shown[1].heat is None
    finally:
        explorer.close()
