"""The notebooks' panels without a browser: sliders, pictures, replay, playback, errors, what closing leaves behind."""

from __future__ import annotations

import asyncio
import base64
import dataclasses
import gzip
import json
import re
import threading
import time
from contextlib import ExitStack
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("ipywidgets", reason="the extra 'notebooks' is not installed")
pytest.importorskip("pyvista", reason="the extra 'notebooks' is not installed")

import cv2  # noqa: E402
import ipywidgets as widgets  # noqa: E402
from scenes import coefficients, exact_actor, head_pose, posed_shape, render_frame  # noqa: E402

from adaptiveface import views  # noqa: E402
from adaptiveface.errors import AdaptiveFaceError, ParameterError  # noqa: E402
from adaptiveface.geometry.frame import FEATURE_IDS  # noqa: E402
from adaptiveface.geometry.mesh import cotangent_laplacian, rotation_vector_matrix, vertex_normals  # noqa: E402
from adaptiveface.insides import make_insides, placed  # noqa: E402
from adaptiveface.parameters import Parameters, describe  # noqa: E402
from adaptiveface.studies import fit, icp, laplacians, learning, sweep
from adaptiveface.studies.printed_equation import PrintedEquation
from adaptiveface.studies.rendered import liveliest_window  # noqa: E402
from adaptiveface.studies.session import Session  # noqa: E402
from adaptiveface.tracking.tracker import FaceTracker  # noqa: E402
from adaptiveface.views import fit_study, saved  # noqa: E402
from adaptiveface.views.kernel import BackgroundTask, on_main_thread, shown_errors  # noqa: E402
from adaptiveface.views.pictures import annotate  # noqa: E402


@pytest.fixture(scope="module")
def session() -> Session:
    """Twelve noisy frames of an opening jaw, and the rig they were rendered from."""
    actor = exact_actor()
    name = actor.expression_names[0]
    frames = []
    for index in range(12):
        shape = posed_shape(actor, coefficients(actor, **{name: 0.06 * index}))
        shape[actor.frontal, 2] += 1.5 * np.sin(actor.neutral[actor.frontal, 1] / 12.0) * index / 12  # in no basis
        frames.append(render_frame(actor, shape, head_pose((0, 0.01 * index, 0)), index, noise=0.5, pixel_noise=0.3))
    return Session("jaw", frames[0].camera, frames[:2], frames, _actor=actor)


@pytest.fixture
def strict(monkeypatch):
    monkeypatch.setenv("ADAPTIVEFACE_STRICT", "1")


def decoded(image) -> np.ndarray:
    return cv2.imdecode(np.frombuffer(image.value, np.uint8), cv2.IMREAD_COLOR).astype(int)


# ---- parameter panel ----


def test_panel_shows_every_parameter_with_its_default():
    rows = describe()
    panel = views.ParameterPanel(sorted({row["stage"] for row in rows}))
    assert set(panel.controls) == {f"{row['stage']}.{row['name']}" for row in rows}
    for row in rows:
        assert panel[f"{row['stage']}.{row['name']}"].value == row["default"]


def test_sliders_reach_both_ends_of_their_range_and_the_papers_value(strict):
    seen = []
    start = Parameters().replace(adaptive_pca__valid_min=0.0, adaptive_pca__valid_max=1e6)  # an order of their own
    panel = views.ParameterPanel(["laplacian", "adaptive_pca"], seen.append, start)
    for row in describe():
        name = f"{row['stage']}.{row['name']}"
        if name not in panel.controls or isinstance(row["default"], (bool, str)):
            continue
        for value in (row["low"], row["high"], row["paper"]):
            if value is not None:
                panel.set(**{name.replace(".", "__"): value})
                assert getattr(getattr(panel.parameters, row["stage"]), row["name"]) == value
                panel.reset()
    assert panel.parameters == start and seen[-1] == start


def test_paper_button_sets_the_papers_value(strict):
    panel = views.ParameterPanel(["laplacian.w2"])
    (button,) = [b for b in walk(panel.widget) if getattr(b, "description", "").startswith("paper")]
    button.click()
    assert panel.parameters.laplacian.w2 == Parameters.paper().laplacian.w2 == 100.0


def test_a_refused_value_shows_a_message_and_keeps_the_last_good_one(monkeypatch):
    monkeypatch.delenv("ADAPTIVEFACE_STRICT", raising=False)

    def refuse_large(parameters: Parameters) -> None:
        if parameters.laplacian.w2 > 10:
            raise ParameterError("w2 & w1 do not go together")

    panel = views.ParameterPanel(["laplacian"], refuse_large)
    panel.set(laplacian__w2=5.0)
    good = panel.parameters
    panel.set(laplacian__w2=100.0)
    assert "w2 &amp; w1 do not go together" in panel.message.value and panel.parameters is good
    panel.set(laplacian__w2=5.0)
    assert panel.message.value == ""
    monkeypatch.setenv("ADAPTIVEFACE_STRICT", "1")
    with pytest.raises(ParameterError, match="do not go together"):
        panel["laplacian.w2"].value = 100.0


def walk(widget):
    yield widget
    for child in getattr(widget, "children", ()):
        yield from walk(child)


# ---- pictures and charts ----


def sent(view, pane: int) -> tuple[np.ndarray, np.ndarray]:
    """Positions (N, 3) mm and values (N,) that the browser has of a pane; of codes, as heads.js decodes them."""
    one, made = view._image.frame[pane], view._image.geometry[pane]
    codes, (low, high) = np.frombuffer(one["values"], "<u2").astype(float), one["range"]
    values = np.where(codes == 65535, np.nan, low + codes * (high - low) / 65534)
    positions = np.frombuffer(one["positions"], "<i2").reshape(-1, 3) / 64
    moving = np.frombuffer(made.get("moving", b""), "<u4")
    if len(positions) < made["count"]:
        everywhere = np.frombuffer(made["rest"], "<i2").reshape(-1, 3) / 64
        everywhere[moving], positions = positions, everywhere
    if 0 < len(values) < made["count"]:
        everywhere = np.full(made["count"], np.nan)
        everywhere[moving], values = values, everywhere
    return positions, values


def test_face_view_shows_heat_motion_and_camera(session):
    actor = session.actor
    view = views.FaceView.of(actor, ("left", "right"), limits=(0, 5), label="mm", pane=(160, 180))
    plain = view.picture().astype(int)
    assert plain.shape == (180, 320, 3) and 20 < plain.mean() < 250 and plain.std() > 20
    view.show(1, actor.neutral, np.full(len(actor.neutral), 5.0))
    hot = view.picture().astype(int)
    left, right = np.abs(hot - plain)[:, :160], np.abs(hot - plain)[:, 160:]
    assert (left > 12).mean() < 0.001 < 0.2 < (right > 12).mean()
    r, g, b = hot[60:120, 215:265].reshape(-1, 3).mean(axis=0)
    assert min(g, r) > b + 40, "the top of the range is yellow"
    view.look(45)
    turned = np.abs(view.picture() - hot).max(axis=2) > 12
    assert turned[:, :160].mean() > 0.05 and turned[:, 160:].mean() > 0.05, "the cameras are linked"
    assert view._image.camera == [45.0, 0.0, 1.0], "the browser turns, too"
    view.close()


def test_of_vertices_that_rest_nothing_is_sent(session):
    actor = session.actor
    view = views.FaceView.of(actor, ("one",), limits=(0, 2))
    moved = actor.neutral + 3 * actor.blendshapes[0]
    heat = np.where(actor.frontal, 1.0 + np.arange(len(actor.neutral)) / 1e4, np.nan)
    sizes = []
    for vertices, values in ((moved, heat), (moved + 1, heat), (moved, np.ones(len(moved)))):
        view.show(0, vertices, values)
        view.refresh()
        seen = sent(view, 0)
        assert np.abs(seen[0] - vertices).max() < 0.01
        np.testing.assert_allclose(seen[1], values, atol=1e-4)
        sizes.append([len(view._image.frame[0][name]) // size for name, size in (("positions", 6), ("values", 2))])
    moving = (actor.frontal | (actor.blendshapes != 0).any(axis=(0, 2))).sum()
    assert sizes == [[moving, moving], [len(moved), moving], [moving, len(moved)]] and moving < 0.8 * len(moved)


def test_the_browser_gets_what_is_shown(session):
    actor = session.actor
    view = views.FaceView.of(actor, ("one", "two"), limits=(-2, 2), compare=True)
    heat = np.where(actor.frontal, np.linspace(-3, 4, len(actor.neutral)), np.nan)
    view.show(1, actor.neutral + [0.0, 0.0, 3.0], heat)
    before = view._image.frame
    assert np.abs(sent(view, 1)[0] - actor.neutral).max() < 0.01, "only with refresh()"
    view.refresh()
    positions, values = sent(view, 1)
    assert np.abs(positions - actor.neutral - [0, 0, 3]).max() < 0.01
    np.testing.assert_allclose(values, heat, atol=1e-4)
    assert not len(sent(view, 0)[1]) and view._image.frame[0] == before[0]
    assert [pane["differs"] for pane in view._image.frame] == [False, True], "from the first head"
    triangles = np.frombuffer(view._image.geometry[1]["triangles"], np.uint32).reshape(-1, 3)
    assert np.array_equal(triangles, actor.triangles) and view._image.geometry[1]["count"] == len(actor.neutral)
    red, blue = np.frombuffer(view._image.palette, np.uint8).reshape(-1, 3)[[-1, 0]].astype(int)
    assert red[0] > red[2] + 80 and blue[2] > blue[0] + 80, "signed values have signed colours"
    view.close()
    view.show(0, 2 * actor.neutral)
    view.refresh()
    assert np.abs(sent(view, 0)[0] - actor.neutral).max() < 0.01, "the last picture stays"


def parts_sent(view, pane: int) -> np.ndarray:
    """(P, 3) mm: eyes, teeth and tongue where the browser puts them."""
    one, part = view._image.frame[pane]["inside"], np.frombuffer(view._image.geometry[pane]["inside"]["part"], np.int8)
    rest, soft = (np.frombuffer(sent, "<i2").reshape(-1, 3) / 64 for sent in (view._image.rests[pane], one["soft"]))
    return placed(rest, part, np.frombuffer(one["placements"], "<f4").reshape(-1, 3, 4), soft)


def test_heads_have_eyes_teeth_and_a_tongue(session):
    actor = session.actor
    insides = make_insides(actor.neutral, actor.triangles)
    jaw = actor.neutral + actor.blendshapes[actor.expression_names.index("jawOpen")]
    gaze = np.array([[0.3, -0.1], [0.25, -0.1]])
    view = views.FaceView.of(actor, ("still", "turned"), pane=(160, 180))
    before = view._image.geometry
    turn = rotation_vector_matrix(np.array([0.1, 0.4, 0.0]))
    view.show(0, jaw, gaze=gaze)
    view.show(1, jaw, np.full(len(jaw), np.nan), gaze=gaze, turn=turn)
    view.refresh()
    still, turned = parts_sent(view, 0), parts_sent(view, 1)
    assert np.abs(still - insides.at(jaw, gaze)).max() < 0.02
    assert np.abs(turned - ((still - view.centre) @ turn.T + view.centre)).max() < 0.05
    assert np.abs(sent(view, 1)[0] - ((jaw - view.centre) @ turn.T + view.centre)).max() < 0.01
    assert view._image.geometry is before, "sent once"
    assert sum(map(len, view._image.frame[0]["inside"].values())) < 2000, "bytes a frame"
    assert len(sent(view, 1)[1]) == len(jaw), "the heat map is of the skin"
    shown = view.picture()[:, 160:].astype(int)
    assert (np.ptp(shown, axis=2) > 15).sum() > 20, "skin without values is grey, its eyes are not"
    view.close()


def test_another_head_gets_eyes_that_fit(session):
    actor = session.actor
    view = views.FaceView.of(actor, ("one", "two"))
    wider = actor.neutral * [1.05, 1.0, 1.0]
    view.show(1, wider, neutral=wider)
    view.refresh()
    assert np.abs(parts_sent(view, 1) - make_insides(wider, actor.triangles).at(wider)).max() < 0.02
    assert view._image.rests[0] != view._image.rests[1]
    plain = views.FaceView(actor.neutral, actor.triangles[:-1])
    assert "inside" not in plain._image.geometry[0] and "inside" not in plain._image.frame[0], "of another model"
    for each in (view, plain):
        each.close()


def test_eyes_look_where_irises_were_seen(session):
    bench = bench_of(session)
    ahead = parts_sent(bench.view, 0)
    bench._eyes.see = lambda result, frame: np.array([[0.4, 0.0], [np.nan, np.nan]])
    bench.show(bench.player.index)
    moved = np.abs(parts_sent(bench.view, 0) - ahead).max(axis=1)
    left = make_insides(session.actor.neutral, session.actor.triangles).part == 0
    assert moved[left].max() > 3.0 and moved[~left].max() == 0.0
    bench.close()


def test_a_view_hands_its_heads_to_pyvista(session):
    actor = session.actor
    view = views.FaceView.of(actor, ("v1: fit", "v2: deformed"))
    view.show(1, actor.neutral + [0.0, 1.0, 0.0], np.arange(len(actor.neutral)))
    mesh = view.mesh("v2")
    np.testing.assert_allclose(mesh.points, (actor.neutral + [0, 1, 0])[:, [2, 0, 1]], atol=1e-3)
    assert np.array_equal(mesh["heat"], np.arange(len(actor.neutral))) and "heat" not in view.mesh(0).array_names
    assert view.mesh("v1", heat=np.ones(len(actor.neutral)))["heat"].max() == 1
    with pytest.raises(KeyError, match="v1: fit, v2: deformed"):
        view.mesh("v4")


def test_a_displayed_view_leaves_its_pictures_and_a_head_that_turns(session):
    """What a saved notebook shows where no kernel runs."""
    bench = bench_of(session)
    text = saved.saved(bench.widget)
    pictures = [base64.b64decode(data) for data in re.findall(r"data:image/[a-z]+;base64,([A-Za-z0-9+/=]+)", text)]
    assert pictures[1:] == [bytes(chart._image.value) for chart, _ in bench.charts] + [bytes(bench.camera._image.value)]
    head = cv2.cvtColor(cv2.imdecode(np.frombuffer(pictures[0], np.uint8), cv2.IMREAD_COLOR), cv2.COLOR_BGR2RGB)
    assert np.abs(head.astype(int) - bench.view.picture()).mean() < 3 and head.std() > 20
    data = re.search(r"octet-stream'>([^<]+)<", text)[1]
    sent = json.loads(gzip.decompress(base64.b64decode(data)))
    positions = base64.b64decode(sent["buffers"][sent["state"]["frame"][1]["positions"]["bytes"]])
    assert positions == bench.view._image.frame[1]["positions"] and sent["state"]["titles"] == list(bench.view.titles)
    assert saved.saved(widgets.VBox([widgets.IntSlider()])) == "", "boxes of other people stay as they are"
    bench.close()


def test_the_window_of_a_plotter_leaves_its_picture(monkeypatch):
    """pyvista's window is a frame of the kernel's own page: where no kernel runs, only this picture can be seen."""
    image = np.zeros((40, 60, 3), np.uint8)
    image[:, :30] = (200, 30, 90)
    shown: list = []
    monkeypatch.setattr("IPython.display.display", lambda what, raw=False: shown.append(what))
    window = widgets.HTML("<iframe src='http://localhost:1'></iframe>")
    window.viewer = SimpleNamespace(plotter=SimpleNamespace(screenshot=lambda return_img: image))
    saved.show_window(window)
    assert "application/vnd.jupyter.widget-view+json" in shown[0]
    picture = re.search(r"data:image/png;base64,([A-Za-z0-9+/=]+)", shown[1].data)[1]
    got = cv2.imdecode(np.frombuffer(base64.b64decode(picture), np.uint8), cv2.IMREAD_COLOR)
    assert np.array_equal(got[..., ::-1], image)
    assert any(name in shown[1].data for name in window._dom_classes), "it is hidden where the window is alive"
    saved.show_window(widgets.HTML("text of other people"))
    assert len(shown) == 3, "text stays as it is"


def test_points_appear_where_they_are(session):
    actor = session.actor
    view = views.FaceView.of(actor, ("points",), limits=(0, 1), pane=(160, 180))
    view.hide_head(0)
    empty = view.picture().astype(int)
    tip = actor.neutral[actor.neutral[:, 2].argmax()]
    for side in (-1.0, 1.0):  # the subject's left is +x, on the right of the picture
        cloud = tip + np.array([30.0 * side, 0, 0]) + np.random.default_rng(0).normal(size=(500, 3))
        view.show_points(0, cloud, np.ones(500))
        view.refresh()
        columns = np.nonzero((np.abs(view.picture() - empty).max(axis=2) > 40).any(axis=0))[0]
        assert len(columns) and (columns > 80).all() == (side > 0) and (columns < 80).all() == (side < 0)
        shown = view._image.frame[0]
        assert not shown["visible"], "without the head"
        points = np.frombuffer(shown["points"]["positions"], "<i2").reshape(-1, 3) / 64
        assert np.abs(points - cloud).max() < 0.01
    view.show_points(0, np.zeros((0, 3)))
    view.refresh()
    assert np.array_equal(view.picture(), empty)
    view.close()


def test_camera_view_marks_features_and_survives_missing_ones(session):
    frame, actor = session.frames[3], session.actor
    annotated = annotate(frame)
    u, v = np.round(frame.features.pixels[0]).astype(int)
    ring = annotated[v - 4 : v + 5, u - 4 : u + 5].reshape(-1, 3).astype(int)
    assert ((ring[:, 0] > 180) & (ring[:, 2] < 90)).any(), "a yellow ring"
    view = views.CameraView((100, 120))
    empty = dataclasses.replace(frame, depth=0 * frame.depth, features=None)
    for shown in (frame, dataclasses.replace(frame, features=None), empty):
        view.show(shown, actor.neutral + [0, 0, 600.0])
        assert decoded(view._image).shape == (120, 100, 3)


@pytest.mark.parametrize("size", [(300, 200), (420, 260), (800, 300)])
def test_the_legend_of_a_live_chart_lies_within_the_picture_and_beside_the_axes(size):
    names = ("mouthSmileRight", "browInnerUp", "mouthLowerDown", "eyeBlinkRight")
    chart = views.LiveChart(names, (0, 10), (0, 1), "frame", "mm", size=size)
    (legend,) = chart._axis.figure.legends
    box, axes = legend.get_window_extent(), chart._axis.get_window_extent()
    assert 0 <= box.x0 and box.x1 <= size[0] and 0 <= box.y0 and box.y1 <= axes.y0
    assert axes.height > 0.3 * size[1]


def contrast(a: str, b: str) -> float:
    """WCAG's contrast ratio of two colours "#rrggbb"."""

    def luminance(colour: str) -> float:
        rgb = np.array([int(colour[k : k + 2], 16) for k in (1, 3, 5)]) / 255
        return np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4) @ (0.2126, 0.7152, 0.0722)

    low, high = sorted((luminance(a), luminance(b)))
    return (high + 0.05) / (low + 0.05)


@pytest.mark.parametrize("kind", ["lines", "bars", "grid"])
def test_charts_are_transparent_and_their_text_reads_on_light_and_dark_pages(kind):
    size = (300, 200)
    if kind == "lines":
        chart = views.LiveChart(("a", "b"), (0, 10), (0, 1), "frame", "mm", "a title", size=size)
        chart.update(a=np.linspace(0, 1, 11))
    elif kind == "bars":
        chart = views.BarChart(("a", "b"), (0, 1), "mm", "a title", size=size)
        chart.update([0.5, 1.0])
    else:
        chart = views.GridChart((1, 2), (3, 4), "K", "w2", "a title", (0, 1), size=size)
        chart.set(0, 0, 0.3)
    rgba = cv2.imdecode(np.frombuffer(chart._image.value, np.uint8), cv2.IMREAD_UNCHANGED)
    assert rgba.shape == (*size[::-1], 4) and (rgba[..., 3] == 0).mean() > 0.4
    title = rgba[2:16][rgba[2:16, :, 3] > 200]
    ink = "#" + "".join(f"{round(value):02x}" for value in np.median(title, axis=0)[[2, 1, 0]])
    assert len(title) > 20 and min(contrast(ink, "#ffffff"), contrast(ink, "#111111")) > 4


def test_live_chart_draws_lines_in_place_and_leaves_gaps():
    chart = views.LiveChart(("a", "b"), (0, 10), (0, 1), "frame", "mm", size=(300, 200))
    empty = decoded(chart._image)
    values = np.full(11, 0.5)
    values[3:8] = np.nan
    chart.update(a=values)
    drawn = np.abs(decoded(chart._image) - empty).max(axis=2) > 60
    columns = np.nonzero(drawn.any(axis=0))[0]
    assert 20 < len(columns) < 200 and np.diff(columns).max() > 50, "a line with a gap"
    chart.update(a=np.zeros(0))
    assert np.array_equal(decoded(chart._image), empty)


# ---- replay ----


def same(a, b) -> bool:
    """The same result, but for the single precision in which replays keep meshes."""
    v4 = (one.v4.astype(np.float32) for one in (a, b))
    return np.array_equal(*v4) and np.array_equal(a.head_pose, b.head_pose)


def test_replay_equals_a_plain_tracker(session):
    replay = views.Replay(session.frames, session.actor)
    tracker = FaceTracker(session.actor)
    assert all(same(r, tracker.track(f)) for r, f in zip(replay.run(), session.frames, strict=True))
    assert replay.results[-1].corrective_updates > 0
    assert replay.model_after(11).correctives.shape[1] >= replay.model_after(2).correctives.shape[1]


@pytest.mark.parametrize("changes", [{}, {"blendshapes__A": 5}, {"adaptive_pca__K": 0}])
def test_kept_results_are_the_trackers_in_less_than_half_the_memory(session, changes):
    parameters = Parameters().replace(**changes)
    blind = dataclasses.replace(session.frames[3], features=None, depth=np.zeros_like(session.frames[3].depth))
    frames = [*session.frames[:3], blind, *session.frames[4:6]]
    tracker, results = FaceTracker(session.actor, parameters), views.Replay(frames, session.actor, parameters).run()
    for result, frame in zip(results, frames, strict=True):
        plain = tracker.track(frame)
        for name in ("v1", "v2", "v3", "v4"):
            assert np.array_equal(getattr(result, name), getattr(plain, name).astype(np.float32)), name
        assert result.reason == plain.reason and np.array_equal(result.coefficients, plain.coefficients)
        assert sum(rows.nbytes for _, rows in result._parts) < 0.5 * 4 * result.v1.nbytes
    assert results[0].v2 is results[0].v2, "made once while it is on show"


@pytest.mark.parametrize(
    "changes",
    [
        {"adaptive_pca__S": 4},
        {"adaptive_pca__S": 3, "adaptive_pca__startup": "full-buffer"},
        {"adaptive_pca__S": 4, "adaptive_pca__buffer": "distinct"},
        {},
    ],
)
def test_trackers_of_the_past_are_what_they_were(session, changes):
    """Their correctives are made of samples again, also where the buffer has gone round."""
    parameters = Parameters().replace(adaptive_pca__K=2, adaptive_pca__valid_min=0.001).replace(**changes)
    replay = views.Replay(session.frames, session.actor, parameters)
    replay.run()
    tracker, past = FaceTracker(session.actor, parameters), []
    for frame in session.frames:
        tracker.track(frame)
        past.append((tracker.model.correctives, tracker.state))
    assert past[-1][0].shape[1] == 2
    for index, (correctives, state) in enumerate(past):
        np.testing.assert_allclose(replay.model_after(index).correctives, correctives, atol=1e-6)
        if index + 1 < len(past):
            np.testing.assert_allclose(replay._history.before(index + 1).state.v4, state.v4, atol=2e-5)
    assert len({replay.learned_by(index) for index in range(len(past))}) > 5


@pytest.mark.parametrize("changes", [{"laplacian__final_w2": 50.0}, {"laplacian__final_feature_weight": 0.5}])
def test_preview_is_exact_where_earlier_frames_do_not_depend_on_the_parameter(session, changes):
    replay, parameters = views.Replay(session.frames, session.actor), Parameters().replace(**changes)
    replay.run()
    preview = replay.preview(parameters, 9)
    exact = views.Replay(session.frames, session.actor, parameters).run()[9]
    np.testing.assert_allclose(preview.v4, exact.v4, atol=2e-5)  # kept in single precision
    assert not same(preview, replay.results[9])


def test_preview_of_k_learns_again_from_the_earlier_frames(session):
    replay = views.Replay(session.frames, session.actor)
    replay.run()
    parameters = Parameters().replace(adaptive_pca__K=1)
    exact = views.Replay(session.frames, session.actor, parameters).run()[9]
    np.testing.assert_allclose(replay.preview(parameters, 9).v3, exact.v3, atol=1e-4)
    before = replay.tracker.model.correctives.copy()
    replay.preview(Parameters().replace(adaptive_pca__K=3, laplacian__w2=9.0), 5)
    assert np.array_equal(before, replay.tracker.model.correctives), "a preview leaves the learned model alone"


CHANGES = [
    {"blendshapes__A": 5},
    {"kalman__model": "acceleration"},
    {"rigid__max_correspondence_distance": 10.0},
    {"depth__smoothing": 3.0},
    {"blendshapes__w": 1e-3},
]


@pytest.mark.parametrize("changes", CHANGES)
def test_preview_answers_for_every_stage(session, changes):
    replay = views.Replay(session.frames, session.actor)
    replay.run()
    result = replay.preview(Parameters().replace(**changes), 8)
    assert result.tracked and not np.array_equal(result.v4, replay.results[8].v4)


FOLLOWED = [
    ({"laplacian__w2": 1e5}, lambda r: np.linalg.norm(r.v2 - r.v1, axis=1).mean() < 0.02),
    ({"adaptive_pca__K": 0}, lambda r: abs(r.anchor_distance - r.adaptive_distance) < 1e-6),
    ({"blendshapes__A": 5}, lambda r: len(r.coefficients_initial) == 5),
]


@pytest.mark.parametrize("changes, has_it", FOLLOWED)
def test_frames_on_show_follow_a_change_before_the_background_run_does(session, changes, has_it):
    """A slider that moves during playback: the next frames are drawn with its value, not with the old one."""
    parameters = Parameters().replace(**changes)

    async def scenario() -> None:
        replay = views.Replay(session.frames, session.actor)
        old = replay.run()[:]
        replay.change(parameters, 6)
        shown = [replay.current(index) for index in (7, 11)]
        assert replay.busy and replay.current(7) is shown[0], "one preview a frame"
        await replay.finished()
        assert all(map(has_it, shown)) and not any(has_it(old[index]) for index in (7, 11))
        assert replay.current(7) is replay.results[7] is not shown[0] and has_it(replay.results[7])

    asyncio.run(scenario())


def test_change_recomputes_everything_in_the_background(session):
    parameters = Parameters().replace(laplacian__w2=40.0)

    async def scenario() -> views.Replay:
        finished = []
        replay = views.Replay(session.frames, session.actor, on_result=finished.append)
        replay.run()
        old = replay.results[:]
        for w2 in (7.0, 20.0, 40.0):  # a moving slider: only the last value is worth the whole performance
            replay.change(parameters.replace(laplacian__w2=w2), 6)
            await asyncio.sleep(0.01)
        assert not same(replay.results[6], old[6]) and replay.busy
        await replay.finished()
        assert finished[-12:] == list(range(12)) and len(finished) == 24
        return replay

    replay = asyncio.run(scenario())
    expected = views.Replay(session.frames, session.actor, parameters).run()
    assert all(same(a, b) for a, b in zip(replay.results, expected, strict=True))


# ---- workbench and player ----


def bench_of(session, **options) -> views.StageExplorer:
    measures = views.Measures(session)
    panes = {"v1": measures.stage("v1"), "v2": measures.difference("v2", "v1")}
    options = {"limits": (0, 2), "label": measures.label, **options}
    return views.StageExplorer(session, ["laplacian.w2", "adaptive_pca.K"], panes, [views.figure_11(session)], **options)


def test_the_sliders_of_a_workbench_end_at_the_actors_expressions(session, strict):
    """A is 23 by default; with fewer expressions the slider shows those, and the run keeps its own parameters."""
    few = dataclasses.replace(
        session.actor, blendshapes=session.actor.blendshapes[:9], expression_names=session.actor.expression_names[:9]
    )
    less = dataclasses.replace(session, frames=session.frames[:3], _actor=few)
    bench = views.StageExplorer(less, ["blendshapes"], {"v1": lambda result, frame: (result.v1, None)}, camera=False)
    slider = bench.panel["blendshapes.A"]
    assert (slider.value, slider.max, bench.parameters) == (9, 9, Parameters())
    bench.set(blendshapes__ridge=5.0)
    assert bench.parameters == Parameters().replace(blendshapes__ridge=5.0)
    bench.close()


def test_a_moved_slider_changes_the_picture_and_then_the_chart(session, strict):
    async def scenario() -> None:
        bench = bench_of(session, start=8)
        face, chart = bench.view.picture().astype(int), decoded(bench.charts[0][0]._image)
        bench.panel["laplacian.w2"].value = max(v for _, v in bench.panel["laplacian.w2"].options)
        now, told = bench.view.picture(), sent(bench.view, 1)[0]
        np.testing.assert_allclose(told, bench.result.v2, atol=0.01)
        half = now.shape[1] // 2
        assert (np.abs(now - face)[:, half:].max(axis=2) > 8).mean() > 0.01, "the right head, at once"
        await bench.settled()
        assert (np.abs(decoded(bench.charts[0][0]._image) - chart).max(axis=2) > 60).sum() > 20
        bench.close()

    asyncio.run(scenario())


def test_player_plays_loops_pauses_and_follows_the_hand():
    async def scenario() -> None:
        shown = []
        player = views.Player(10, shown.append, fps=200.0)
        player.play()
        assert player.button.description == "pause"
        for _ in range(200):  # a busy machine draws fewer pictures a second, but goes round as well
            await asyncio.sleep(0.05)
            if len(shown) > 20:
                break
        assert len(shown) > 20 and shown.count(shown[0]) >= 2, "it went round"
        player.pause()
        assert player.button.description == "play"
        await asyncio.sleep(0.02)
        count = len(shown)
        player.go_to(4 if player.index != 4 else 5)
        assert len(shown) == count + 1
        await asyncio.sleep(0.1)
        assert len(shown) == count + 1 and views.running_tasks() == 0
        player.loop.value = False
        player.button.value = True
        for _ in range(200):
            await asyncio.sleep(0.05)
            if not player.button.value:
                break
        assert player.index == 9 and not player.button.value, "it stopped at the end"

    asyncio.run(scenario())


def test_a_playback_that_is_stopped_and_started_at_once_plays_on(session):
    """As "learn live" does while the performance plays."""

    async def scenario() -> None:
        bench = bench_of(session)
        bench.player.play()
        while bench.player.index < 2:
            await asyncio.sleep(0.01)
        bench.learn_live()
        drawn = bench.player.drawn
        for _ in range(300):
            await asyncio.sleep(0.02)
            if bench.player.drawn > drawn + 3:
                break
        assert bench.player.button.value and bench.player.drawn > drawn + 3
        bench.player.pause()
        await asyncio.sleep(0.02)
        assert not bench.player.button.value and views.running_tasks() == 0
        bench.close()

    asyncio.run(scenario())


def test_the_slider_follows_a_playback_and_stands_right_when_it_ends():
    async def scenario() -> None:
        shown, told = [], []
        player = views.Player(400, shown.append, fps=400.0)
        player.slider.observe(lambda change: told.append(change["new"]), "value")
        player.play()
        while len(shown) < 30:
            await asyncio.sleep(0.01)
        assert len(told) < len(shown) / 2, "a step of the slider costs the page as much as half a head"
        player.pause()
        await asyncio.sleep(0.02)
        assert player.slider.value == player.index == shown[-1]
        player.slider.value = 0
        assert player.index == 0 == shown[-1], "the hand counts at once"

    asyncio.run(scenario())


def test_a_slow_view_may_play_slower_instead_of_passing_over_frames():
    async def scenario() -> None:
        shown = []

        def draw(index: int) -> None:
            shown.append(index)
            time.sleep(0.02)

        player = views.Player(60, draw, fps=1000.0)
        player.loop.value, player.longest_step = False, 2
        player.play()
        while player.button.value:
            await asyncio.sleep(0.01)
        assert shown[-1] == 59 and max(np.diff(shown)) <= 2

    asyncio.run(scenario())


def test_learning_live_tracks_while_it_plays(session, strict):
    async def scenario() -> None:
        bench = bench_of(session)
        final = bench.replay.results[-1]
        bench.player.loop.value = False
        bench.learn_live()
        await asyncio.sleep(0.05)
        assert bench.replay.done < len(session.frames)
        while bench.player.button.value:
            await asyncio.sleep(0.02)
        assert bench.replay.done == len(session.frames) and same(bench.replay.results[-1], final)
        bench.close()

    asyncio.run(scenario())


def test_closing_leaves_no_task_and_no_thread(session):
    async def scenario() -> None:
        before = threading.active_count()
        bench = bench_of(session)
        bench.player.play()
        bench.set(laplacian__w2=20.0)
        await asyncio.sleep(0.05)
        assert views.running_tasks() >= 1
        bench.close()
        await asyncio.sleep(0.05)
        assert views.running_tasks() == 0 and threading.active_count() == before

    asyncio.run(scenario())


def test_callbacks_of_other_threads_run_on_the_main_thread_newest_first():
    async def scenario() -> None:
        calls = []
        wrapped = on_main_thread(lambda value: calls.append((value, threading.current_thread())))
        worker = threading.Thread(target=lambda: [wrapped(value) for value in range(20)])
        worker.start()
        worker.join()  # the main thread is busy: the calls pile up
        await asyncio.sleep(0.01)
        assert calls == [(19, threading.main_thread())]

    asyncio.run(scenario())


def test_errors_are_shown_and_tasks_report_theirs(monkeypatch):
    monkeypatch.delenv("ADAPTIVEFACE_STRICT", raising=False)
    shown = []
    with shown_errors(shown.append):
        raise ValueError("<oops>")
    assert "ValueError: &lt;oops&gt;" in shown[-1]
    assert "background:#" in shown[-1] and "color:#" in shown[-1], "legible in any theme: not on the page's own ground"

    async def fails() -> None:
        raise ValueError("in the background")

    async def scenario() -> None:
        task = BackgroundTask()
        task.start(fails())
        with pytest.raises(ValueError, match="in the background"):
            await task.finished()

    asyncio.run(scenario())


# ---- studies ----


def test_printed_equation_ignores_its_weights_and_the_weighted_one_does_not(session):
    replay = views.Replay(session.frames, session.actor)
    result, frame = replay.run()[8], session.frames[8]
    printed = PrintedEquation(session.actor, session.camera)
    reference = printed.deform(frame, result, 0.1, 100.0)
    assert np.linalg.norm(reference, axis=1).max() > 0.1
    np.testing.assert_allclose(printed.deform(frame, result, 1e-4, 1e4), reference, atol=1e-9)
    frontal, sizes = session.actor.frontal, []
    for w2 in (0.01, 1e4):
        deformed = replay.preview(Parameters().replace(laplacian__w2=w2), 8)
        sizes.append(np.linalg.norm((deformed.v2 - deformed.v1)[frontal], axis=1).mean())
    assert sizes[0] > 5 * sizes[1]


def test_printed_equation_solves_the_stacked_rows_without_weights(session):
    """The normal equations of K dv = G^-1 a hold, with the rows of eqs. (3), (4) and (6) written out here anew."""
    actor, frame = session.actor, session.frames[8]
    result = views.Replay(session.frames[:9], actor).run()[8]
    solution = PrintedEquation(actor, frame.camera).deform(frame, result, 0.1, 100.0) @ result.head_pose[:3, :3].T
    frontal, vertices = np.flatnonzero(actor.frontal), result.in_camera(result.v1[actor.frontal])
    u, v = np.round(frame.camera.project(vertices)).astype(int).T
    ratio = frame.depth[v, u] / vertices[:, 2]
    use = (np.abs(ratio - 1) * vertices[:, 2] < 15.0) & actor.depth_valid[actor.frontal]
    to_depth = np.where(use[:, None], vertices * (ratio - 1)[:, None], 0.0)
    smooth = cotangent_laplacian(actor.neutral, actor.triangles)[:, frontal]
    gradient = solution - to_depth + smooth.T @ (smooth @ solution)
    for j, vertex in enumerate(np.searchsorted(frontal, actor.feature_vertices)):
        offset = frame.features.pixels[j] - frame.camera.project(vertices[vertex])
        target = np.append(offset * to_depth[vertex, 2], to_depth[vertex, 2])  # H_j^-1 d_j
        focal = np.array([frame.camera.fx, frame.camera.fy, 1.0])
        gradient[vertex] += focal * (focal * solution[vertex] - target)
    assert np.abs(gradient).max() < 1e-6


def test_hole_removes_depth_at_the_mouth_corner(session):
    pierced = laplacians.with_hole(session, 20.0)
    frame, whole = pierced.frames[4], session.frames[4]
    u, v = np.round(whole.features.pixels[list(FEATURE_IDS).index(54)]).astype(int)
    gone = (whole.depth > 0) & (frame.depth == 0)
    assert frame.depth[v, u] == 0 and 500 < gone.sum() < 3000
    assert FaceTracker(session.actor).track(frame).tracked
    painted = dataclasses.replace(whole, colour=np.full((*whole.depth.shape, 3), 200, np.uint8))
    (shown,) = laplacians.with_hole(dataclasses.replace(session, frames=[painted]), 20.0).frames
    assert (shown.colour[gone] == 100).all() and (shown.colour == 200).mean() > 0.9


def test_error_in_the_hole_counts_what_lost_its_depth(session):
    measures, run = views.Measures(session), views.Replay(session.frames, session.actor).run()
    assert np.isnan(laplacians.error_in_hole(session, session, measures, run))
    everywhere = np.nanmean([measures.mean_error(r, f, "v2") for r, f in zip(run, session.frames, strict=True)])
    inside = laplacians.error_in_hole(session, laplacians.with_hole(session, 1000.0), measures, run)
    assert inside == pytest.approx(everywhere, rel=0.1)
    assert laplacians.error_in_hole(session, laplacians.with_hole(session, 20.0), measures, run) != inside


def test_incremental_correctives_lie_near_the_batch_pca(session):
    replay = views.Replay(
        session.frames * 3, session.actor, Parameters().replace(adaptive_pca__K=2, adaptive_pca__valid_min=0.01)
    )
    replay.run()
    samples = replay.model_after(35).buffer()
    assert len(samples) > 20
    assert learning.angle_to_batch(replay.tracker.model, samples) < 8.0
    assert np.isnan(learning.angle_to_batch(FaceTracker(session.actor).model, samples))


def test_icp_study_converges_on_the_true_pose():
    actor = exact_actor()
    frame, goal = render_frame(actor, actor.neutral, head_pose(), noise=0.3), head_pose()
    keep = actor.frontal & actor.depth_valid
    normals = vertex_normals(actor.neutral, actor.triangles)[keep]
    start = icp.displaced(goal, actor.neutral[keep].mean(axis=0), 10.0, 8.0)
    run = icp.run_icp(frame, actor.neutral[keep], normals, start, 25.0)
    assert run.residuals[0] > 3.0 > 0.5 > run.residuals[-1] and len(run.poses) == 13
    assert icp.rotation_angle(run.poses[0], goal) == pytest.approx(8.0, abs=1e-6)
    assert icp.rotation_angle(run.poses[-1], goal) < 0.3
    assert np.linalg.norm(run.poses[-1][:3, 3] - goal[:3, 3]) < 1.0


def test_fit_problem_bounded_beats_clipped(session):
    result = views.Replay(session.frames, session.actor).run()[10]
    problem = fit.fit_problem(session.actor, session.frames[10], result, Parameters.paper().blendshapes)
    bounded = problem.bounded()
    assert problem.energy(problem.unbounded()) <= problem.energy(bounded) < problem.energy(problem.clipped())
    assert bounded.min() >= 0 and bounded.max() <= 1
    assert bounded[0] == pytest.approx(0.6, abs=0.15), "the jaw that the frame was rendered with"
    other = dataclasses.replace(result, v1=result.v1 + 1.0)  # no b0 + B x of the actor, as with personal blendshapes
    again = fit.fit_problem(session.actor, session.frames[10], other, Parameters.paper().blendshapes)
    np.testing.assert_array_equal(again.g, problem.g)


def test_bars_of_the_solutions_are_kept_by_saved_notebooks():
    bars = fit_study.coefficient_bars(["jawOpen", "mouthPucker"], {"clipped": np.array([0.2, 1.0])}, "frame 3")
    data, metadata = bars._repr_mimebundle_()
    assert data["image/png"] and "clipped" in metadata["image/png"]["alt"]


def test_jitter_and_lag():
    t = np.arange(60)[:, None]
    smooth = np.sin(t / 6.0)
    late = np.roll(smooth, 4, axis=0)
    assert fit.lag(late, smooth) == 4 and fit.lag(smooth, smooth) == 0
    assert fit.jitter(smooth + 0.1 * (-1.0) ** t) > 10 * fit.jitter(smooth)


def test_sweep_fills_its_chart(session):
    chart = views.GridChart((0, 2), (5, 20), "K", "S", "error", limits=(0, 1))
    values = sweep.sweep(session, {"adaptive_pca.K": (0, 2)}, {"adaptive_pca.S": (5, 20)}, chart)
    assert np.isfinite(values).all() and np.array_equal(values, chart.values)
    assert values[0, 0] == values[0, 1], "without correctives the buffer does not matter"


def test_a_cell_of_a_sweep_keeps_its_colour_while_others_are_filled():
    chart = views.GridChart((0, 2), (5, 20), "K", "S", "error", limits=(0, 1))
    pictures = []
    for value in (0.3, 0.9):
        chart.set(0, len(pictures), value)
        pictures.append(cv2.imdecode(np.frombuffer(chart._image.value, np.uint8), cv2.IMREAD_COLOR))
    first, second = (picture[50:130, 70:110] for picture in pictures)  # within the first cell, beside its number
    assert np.array_equal(first, second) and first.std(axis=(0, 1)).max() < 1


@pytest.mark.parametrize("elsewhere", [False, True], ids=["its own processes", "a scheduler by its address"])
def test_sweep_on_a_cluster_gives_the_same_numbers(session, elsewhere):
    distributed = pytest.importorskip("distributed", reason="the extra 'cluster' is not installed")
    rows, columns = {"adaptive_pca.K": (0, 2)}, {"adaptive_pca.S": (5,)}
    with ExitStack() as stack:
        address = None
        if elsewhere:
            local = dict(n_workers=1, threads_per_worker=1, processes=False, dashboard_address=None, protocol="tcp")
            address = stack.enter_context(distributed.LocalCluster(**local)).scheduler_address
        client = stack.enter_context(sweep.cluster(address, workers=1))
        values = sweep.sweep(session, rows, columns, client=client)
    assert np.array_equal(values, sweep.sweep(session, rows, columns))


def test_a_scheduler_that_does_not_answer_is_named():
    pytest.importorskip("distributed", reason="the extra 'cluster' is not installed")
    with pytest.raises(AdaptiveFaceError, match="no Dask scheduler answers at nonsense://here"):
        sweep.cluster("nonsense://here")


# ---- session ----


def test_session_is_cached_and_a_damaged_cache_is_made_anew(tmp_path):
    first = views.load_session("synthetic:3", neutral_frames=2, frames=4, cache=tmp_path)
    again = views.load_session("synthetic:3", neutral_frames=2, frames=4, cache=tmp_path)
    (file,) = tmp_path.glob("*.npz")
    (tmp_path / "damaged").write_bytes(file.read_bytes()[:5000])
    (tmp_path / "damaged").replace(file)  # as writers do: sessions read what they have opened
    mended = views.load_session("synthetic:3", neutral_frames=2, frames=4, cache=tmp_path)
    for other in (again, mended):
        assert len(other) == 6 and len(other.neutral) == 2
        for a, b in zip(first.frames, other.frames, strict=True):
            assert np.array_equal(a.depth, b.depth) and np.array_equal(a.colour, b.colour)
            np.testing.assert_array_equal(a.features.pixels, b.features.pixels)
    truth = first.truth[first.frames[2].index]
    assert truth.performance == 1 and len(truth.vertices) == len(first.truth.neutral)
    assert first.frames[0].depth[first.frames[0].depth > 0].min() > 300


def test_liveliest_window_holds_the_movement():
    script = np.zeros((60, 2))
    script[30:40, 1] = np.sin(np.linspace(0, np.pi, 10))
    assert 24 <= liveliest_window(script, 16) <= 30


def test_a_workbench_hands_its_meshes_to_pyvista(session):
    bench = bench_of(session, start=8)
    heat = np.linspace(0, 1, len(session.actor.neutral))
    mesh = bench.mesh("v2", heat)
    np.testing.assert_allclose(mesh.points, bench.result.v2[:, [2, 0, 1]], atol=1e-3)
    moved = np.linalg.norm(bench.result.v2 - session.actor.neutral, axis=1)
    np.testing.assert_allclose(mesh["distance"], moved, atol=1e-9)
    assert mesh.active_scalars_name == "heat" and np.array_equal(mesh["heat"], heat)
    known = bench.replay.model_after(8).correctives.shape[1]
    assert known > 0 and f"corrective {known}" in mesh.array_names and f"corrective {known + 1}" not in mesh.array_names
    assert not mesh["corrective 1"][~session.actor.frontal].any(), "outside the frontal region nothing is learned"
    with pytest.raises(ParameterError, match="none of v1, v2, v3, v4"):
        bench.mesh("v7")
    bench.close()
