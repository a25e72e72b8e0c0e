"""JupyterLab in a real browser: sliders dragged with the mouse change the face and the charts, playback advances."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))
pytest.importorskip("jupyterlab", reason="the extra 'notebooks' is not installed")
pytest.importorskip("playwright", reason="playwright is not installed")

import lab  # noqa: E402
import nbformat  # noqa: E402

if lab.CHROMIUM is None:
    pytest.skip("no chromium found (Debian: apt install chromium; or set CHROMIUM to its path)", allow_module_level=True)

LAPLACIAN, PCA = "05_laplacian_deformation.ipynb", "06_incremental_pca.ipynb"


@pytest.fixture(scope="module")
def address(tmp_path_factory):
    quick = {"ADAPTIVEFACE_NOTEBOOK_FAST": "1"}
    with lab.jupyter_lab(tmp_path_factory.mktemp("lab"), (LAPLACIAN, PCA), **quick) as address:
        yield address


@pytest.fixture
def page():
    with lab.chromium_page() as page:
        yield page


def workbench(page, address: str, name: str):
    """Open a notebook, run it up to its first workbench; returns the face's and the first chart's picture."""
    lab.open_notebook(page, address, name)
    lab.run_cells(page, lab.cell_with(name, "views.StageExplorer("))
    face, chart = page.locator("canvas.adaptiveface-face").first, page.locator("img.adaptiveface-chart").first
    face.wait_for(state="visible", timeout=180_000)
    chart.wait_for(state="visible", timeout=240_000)
    page.wait_for_timeout(1500)
    shown = lab.pixels(face)
    assert shown.std() > 15 and shown.mean() > 60, "the face is blank or black"
    return face, chart


def check_drag(page, face, chart, parameter: str, by: float) -> None:
    """Drag a slider: first the face changes, then the chart, and nothing turns black."""
    before_face, before_chart = lab.pixels(face), lab.pixels(chart)
    lab.drag(page, parameter, by)
    assert lab.wait_for_change(page, face, before_face) > 0.005, f"{parameter} does not change the face"
    assert lab.wait_for_change(page, chart, before_chart, least=0.0005) > 0.0005, f"{parameter} does not change the chart"
    after = lab.pixels(face)
    assert after.std() > 15 and after.mean() > 60, "the face went black: drawn on the wrong thread?"


def check_mouse(page, face) -> None:
    """Dragging on the face turns it, the wheel zooms, a double click goes back; the kernel hears of none of it."""
    ahead = lab.pixels(face)
    lab.drag_face(page, face, (80, 30))
    assert lab.wait_for_change(page, face, ahead, least=0.03) > 0.03, "dragging on the face does not turn it"
    check_camera(page, face, 32, 1, "80 pixels are 32 degrees")
    turned = lab.pixels(face)
    page.wait_for_timeout(500)  # scrolling the page into place must not count as the start of a zoom
    page.mouse.wheel(0, -400)
    assert lab.wait_for_change(page, face, turned, least=0.03) > 0.03, "the wheel does not zoom"
    face.dblclick()
    page.mouse.move(5, 5)  # off the face: no value beside the pointer
    assert lab.wait_until(page, lambda: lab.changed(ahead, lab.pixels(face)) < 0.003), "a double click does not go back"


_LEFT_EYE = """
from adaptiveface.views import still
shown = bench.view._image
seen = still.Still(tuple(shown.pane), bench.view.centre, shown.radius, *shown.camera)
print(*(seen.camera.project(seen.points(bench.view._shown[0].insides.eye_centres))[0] / shown.pane / shown.grid))"""


def check_eyes(page, face) -> None:
    """The first head has an eyeball behind its lids: dark pupil and white."""
    shown = lab.pixels(face)
    u, v = np.array(lab.run_code(page, _LEFT_EYE).split(), float) * shown.shape[1::-1]
    eye = shown[int(v) - 6 : int(v) + 7, int(u) - 15 : int(u) + 16]
    white = (eye.min(axis=2) > 110) & (np.ptp(eye, axis=2) < 30)
    assert (eye.max(axis=2) < 60).sum() >= 4 and 4 <= white.sum() < 0.5 * white.size


def check_hover(page, face) -> None:
    """Under the pointer stands the value of a vertex of the kernel's; beside the face there is none."""
    bubble, box = page.locator(".adaptiveface-value").first, face.bounding_box()
    page.mouse.move(box["x"] + 0.28 * box["width"], box["y"] + 0.55 * box["height"])
    bubble.wait_for(state="visible", timeout=120_000)
    value, _, vertex = bubble.inner_text().partition(" mm · vertex ")
    frame = "session.frames[bench.player.index]"
    told = lab.run_code(page, f"print(measures.error(bench.result, {frame}, 'v1')[{int(vertex)}])")
    assert float(value) == pytest.approx(float(told), abs=0.006)
    page.mouse.move(box["x"] + 3, box["y"] + 30)
    bubble.wait_for(state="hidden", timeout=120_000)


def check_exaggeration(page, face) -> None:
    """The slider enlarges what the second head has and the first has not."""
    page.mouse.move(5, 5)
    page.wait_for_timeout(500)
    before = lab.pixels(face)
    slider = page.locator("input.adaptiveface-exaggeration").first
    slider.fill("10")

    def differences() -> np.ndarray:
        """(2,) share of pixels that differ, of the left and of the right head."""
        different = np.abs(lab.pixels(face) - before)[2:-2, 2:-2].max(axis=2) > 12  # a neighbour may touch the rim
        half = different.shape[1] // 2
        return np.array([different[:, :half].mean(), different[:, half:].mean()])

    assert lab.wait_until(page, lambda: differences()[1] > 0.01), "the second head does not change"
    assert differences()[0] < 0.003  # a page that has scrolled by part of a pixel changes some at the outline
    slider.fill("1")


def check_messages(page, face) -> None:
    """Turning and zooming ask the kernel nothing, and go on while it computes."""
    page.evaluate(
        """() => { const k = window.jupyterapp.shell.currentWidget.sessionContext.session.kernel; window.sent = 0;
          k.anyMessage.connect((_, m) => { if (m.direction === 'send') window.sent += 1; });
          k.requestExecute({code: 'import time; time.sleep(60)'}); }"""
    )
    page.wait_for_timeout(500)
    asked = page.evaluate("() => { window.loads.turned = []; return window.sent; }")
    ahead = lab.pixels(face)
    lab.drag_face(page, face, (60, 20))
    page.mouse.wheel(0, -200)
    page.wait_for_function("() => window.loads.turned.length >= 5", timeout=120_000)
    turned = lab.wait_for_change(page, face, ahead, least=0.03)
    kernel = "window.jupyterapp.shell.currentWidget.sessionContext.session.kernel"
    assert page.evaluate(f"() => {kernel}.status") == "busy", "the kernel was to be busy all the time"
    assert page.evaluate("() => window.sent") == asked, "the kernel was asked"
    assert turned > 0.03
    face.dblclick()
    page.mouse.move(5, 5)
    page.evaluate(f"() => {kernel}.interrupt()")
    page.wait_for_function(f"() => {kernel}.status === 'idle'", timeout=120_000)


def check_touch(page, face) -> None:
    """One finger turns the face, two that move apart enlarge it, two taps go back; the page does not scroll or zoom."""
    face.scroll_into_view_if_needed()
    box = face.bounding_box()
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    lab.touch(page, ((x - 40, y), (x + 40, y)))
    check_camera(page, face, 32, 1, "80 pixels are 32 degrees")
    lab.touch(page, ((x - 40, y), (x - 72, y)), ((x + 40, y), (x + 72, y)))
    check_camera(page, face, 32, 1.8, "fingers 1.8 times as far apart; a pinch does not turn")
    assert face.bounding_box() == box and page.evaluate("() => window.visualViewport.scale") == 1, "the page moved"
    lab.touch(page, ((x, y), (x, y)), steps=1)
    lab.touch(page, ((x, y), (x, y)), steps=1)
    check_camera(page, face, 0, 1, "two taps go back")


def check_camera(page, face, turn: float, zoom: float, why: str) -> None:
    """The camera that the browser has drawn with, signs aside."""

    def shown() -> tuple[float, float]:
        words = face.get_attribute("data-camera").split()
        return abs(float(words[0])), float(words[2])

    assert lab.wait_until(page, lambda: shown() == pytest.approx((turn, zoom), abs=0.01)), f"{why}: {shown()}"


def check_playback(page, button: str) -> None:
    """A click on a button starts a playback that draws pictures; another one on "play" stops it."""
    page.evaluate("() => { window.loads.face = []; }")
    page.locator(button).first.click()
    page.wait_for_function("() => window.loads.face.length > 20", timeout=240_000)  # how fast: measure.py
    page.locator(".adaptiveface-play").first.click()
    lab.wait_for_rest(page)


def check_learn_live_while_playing(page) -> None:
    """It begins anew and plays on."""
    page.locator(".adaptiveface-play").first.click()
    page.wait_for_function("() => window.loads.face.length > 5", timeout=240_000)
    page.evaluate("() => { window.loads.face = []; }")
    page.locator(".adaptiveface-live").first.click()
    page.wait_for_function("() => window.loads.face.length > 20", timeout=240_000)
    assert "pause" in page.locator(".adaptiveface-play").first.inner_text()
    page.locator(".adaptiveface-play").first.click()
    lab.wait_for_rest(page)


def check_threshold(page) -> None:
    """A line of the energy chart is dragged, and moved with a key: the parameter follows, and the slider with it."""

    def valid_max() -> float:
        return float(lab.run_code(page, "print(bench.parameters.adaptive_pca.valid_max)"))

    line = page.locator(".adaptiveface-threshold-high").first
    lab.drag_line(page, line, 40)
    assert lab.wait_until(page, lambda: valid_max() < 60), "dragging the line changes nothing"
    dragged = valid_max()
    assert float(lab.run_code(page, "print(bench.panel['adaptive_pca.valid_max'].value)")) == pytest.approx(dragged)
    line.press("ArrowUp")
    assert lab.wait_until(page, lambda: valid_max() == pytest.approx(dragged * 10**0.05, rel=1e-3)), "the key does nothing"


@pytest.mark.slow
def test_a_cell_that_raises_is_noticed(page, tmp_path):
    """What every other test here relies on."""
    nbformat.write(lab.notebook_of("print(1)", "1 / 0"), tmp_path / "raises.ipynb")
    with lab.jupyter_lab(tmp_path) as address:
        lab.open_notebook(page, address, "raises.ipynb")
        with pytest.raises(AssertionError, match="ZeroDivisionError: division by zero"):
            lab.run_cells(page, 1)


@pytest.mark.slow
def test_laplacian_sliders_and_playback(page, address):
    face, chart = workbench(page, address, LAPLACIAN)
    check_eyes(page, face)
    check_mouse(page, face)
    check_hover(page, face)
    check_exaggeration(page, face)
    check_messages(page, face)
    check_touch(page, face)
    check_drag(page, face, chart, "laplacian.w2", 90)
    check_playback(page, ".adaptiveface-play")
    assert page.problems == []


@pytest.mark.slow
def test_pca_sliders_and_live_learning(page, address):
    face, chart = workbench(page, address, PCA)
    check_threshold(page)
    check_drag(page, face, chart, "adaptive_pca.K", -120)
    check_playback(page, ".adaptiveface-live")
    check_learn_live_while_playing(page)
    assert page.problems == []
