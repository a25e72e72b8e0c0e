"""The live notebook in a real browser: the tracked face moves, a slider and a button act, closing ends every thread."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))
pytest.importorskip("jupyterlab", reason="the extra 'notebooks' is not installed")
pytest.importorskip("playwright", reason="playwright is not installed")

import lab  # noqa: E402

if lab.CHROMIUM is None:
    pytest.skip("no chromium found (Debian: apt install chromium; or set CHROMIUM to its path)", allow_module_level=True)

LIVE = "live_sensor.ipynb"
STATUS, FIGURES = ".adaptiveface-live-status", ".adaptiveface-live-figures"
#: Threads of the live chain that are still there, printed by a cell of the test's own.
THREADS = (
    "view.close(); import threading; names = ('sensor', 'features', 'tracker', 'live run', 'recording'); "
    "print('left:', [t.name for t in threading.enumerate() if t.name.startswith(names)])"
)


@pytest.fixture
def page(tmp_path):
    with lab.jupyter_lab(tmp_path, (LIVE,), ADAPTIVEFACE_SENSOR="synthetic") as address, lab.chromium_page() as page:
        lab.open_notebook(page, address, LIVE)
        yield page


@pytest.mark.slow
def test_live_notebook_tracks_and_answers(page):
    lab.run_cells(page, lab.cell_with(LIVE, "views.LiveView("))
    lab.wait_for_text(page, ".adaptiveface-coverage", "left", 240)
    page.locator(".adaptiveface-face").first.wait_for(state="visible", timeout=120_000)
    lab.wait_for_text(page, STATUS, "tracking", 240)
    lab.wait_for_text(page, FIGURES, "latency", 240)
    page.wait_for_timeout(1000)  # the tracked head's pane takes the place of the scan's
    face = page.locator(".adaptiveface-face").first
    shown = lab.pixels(face)
    assert shown.std() > 15 and shown.mean() > 60, "the face is blank or black"
    page.evaluate("() => { window.loads.face = []; }")
    page.wait_for_function("() => window.loads.face.length > 20", timeout=240_000)  # how fast: measure.py

    w2 = page.locator(".adaptiveface-laplacian-w2 .widget-readout").first
    before = w2.inner_text()
    lab.drag(page, "laplacian.w2", 90)
    assert lab.wait_until(page, lambda: w2.inner_text() != before)
    freeze = page.locator("button.adaptiveface-freeze")
    freeze.click()
    assert "mod-active" in freeze.get_attribute("class")
    assert lab.wait_until(page, lambda: lab.run_code(page, "print(view.run.session.frozen)").strip() == "True")
    code = "s = view.run.session; print(s.frozen, view.result.tracked.tracked, s.parameters.laplacian.w2)"
    frozen, tracked, value = lab.run_code(page, code).split()
    assert (frozen, tracked) == ("True", "True") and float(value) == pytest.approx(float(w2.inner_text()), rel=0.01)

    assert lab.run_code(page, THREADS).strip() == "left: []"
    lab.wait_for_rest(page)
    assert page.problems == []
