"""Looking at a panel changes nothing: every panel of every notebook is opened in a real browser, and nothing is touched.

JupyterLab's sliders answer to being shown: they send what they round. Every value that the browser sends is noted in
the kernel, and every parameter is compared with its default, which is that of live tracking in the live view.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))
pytest.importorskip("jupyterlab", reason="the extra 'notebooks' is not installed")
pytest.importorskip("playwright", reason="playwright is not installed")

import lab  # noqa: E402
import nbformat  # noqa: E402

from adaptiveface.parameters import describe  # noqa: E402

if lab.CHROMIUM is None:
    pytest.skip("no chromium found (Debian: apt install chromium; or set CHROMIUM to its path)", allow_module_level=True)

NOTEBOOKS = sorted(path.name for path in lab.NOTEBOOKS.glob("*.ipynb"))
#: What makes the widgets of the notebooks; the cells after the last of them are not run.
MAKERS = ("StageExplorer(", "Study(", "LiveView(")
#: Notes every value that the browser sends and that differs from the kernel's.
WATCH = """
import json
from ipywidgets import Widget
sent, known = [], Widget.set_state
def noting(self, state):
    before = {name: getattr(self, name) for name in ("value", "index") if name in state}
    known(self, state)
    sent.extend(f"{type(self).__name__} {self.description}: {name} {value} -> {getattr(self, name)}"
                for name, value in before.items() if getattr(self, name) != value)
Widget.set_state = noting
"""
#: Every panel's parameters, and those of what it steers, against those at the start.
COMPARE = """
import gc
from dataclasses import asdict
from adaptiveface.parameters import Parameters
from adaptiveface.views import LiveView, ParameterPanel, StageExplorer
found = [thing for thing in gc.get_objects() if type(thing) in (LiveView, ParameterPanel, StageExplorer)]
held = [t.run.session.parameters if isinstance(t, LiveView) else t.parameters for t in found]
start = asdict(Parameters.live() if any(isinstance(t, LiveView) for t in found) else Parameters())
def differences(one):
    return [f"{stage}.{name} = {value!r}" for stage, values in asdict(one).items() for name, value in values.items()
            if repr(value) != repr(start[stage][name])]
print(json.dumps({"panels": sum(isinstance(t, ParameterPanel) for t in found), "sent": sent,
                  "changed": [difference for one in held for difference in differences(one)]}))
"""


#: A notebook of one panel with every parameter, which counts what it is told.
EVERYTHING = """
from adaptiveface.parameters import Parameters, describe
from adaptiveface.views import ParameterPanel
told = []
panel = ParameterPanel(list(dict.fromkeys(row["stage"] for row in describe())), told.append)
panel.widget
"""

#: A window of pyvista, which is a frame of a page that the kernel serves.
WINDOW = """
from adaptiveface import views
import pyvista as pv
plotter = pv.Plotter(window_size=(300, 200))
plotter.add_mesh(pv.Sphere())
plotter.show()
"""


@pytest.fixture(scope="module")
def address(tmp_path_factory):
    folder = tmp_path_factory.mktemp("lab")
    nbformat.write(lab.notebook_of(EVERYTHING), folder / "everything.ipynb")
    nbformat.write(lab.notebook_of(WINDOW), folder / "window.ipynb")
    quick = {"ADAPTIVEFACE_NOTEBOOK_FAST": "1", "ADAPTIVEFACE_SENSOR": "synthetic"}
    with lab.jupyter_lab(folder, NOTEBOOKS, **quick) as address:
        yield address


@pytest.fixture(scope="module")
def page():
    with lab.chromium_page() as page:
        yield page


def last_maker(name: str) -> int:
    """Number of the last cell that makes something to look at; -1 where there is none."""
    cells = nbformat.read(lab.NOTEBOOKS / name, 4).cells
    return max((i for i, c in enumerate(cells) if c.cell_type == "code" and any(m in c.source for m in MAKERS)), default=-1)


def open_tabs(page) -> int:
    """Click on every tab of every panel, and come back to the first."""
    tabs = page.locator(".adaptiveface-tabs .lm-TabBar-tab")
    for number in [*range(tabs.count()), 0][: tabs.count() and None]:
        tabs.nth(number).click()
        page.wait_for_timeout(150)
    return tabs.count()


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in NOTEBOOKS if last_maker(name) >= 0])
def test_what_is_shown_and_not_touched_stays_as_it_is(page, address, name):
    lab.open_notebook(page, address, name)
    lab.run_code(page, WATCH)
    lab.run_cells(page, last_maker(name))
    if name.startswith("live"):
        lab.wait_for_text(page, ".adaptiveface-live-status", "tracking", 240)
    page.locator(".widget-hslider").first.wait_for(state="attached", timeout=240_000)
    tabs = open_tabs(page)
    page.wait_for_timeout(500)
    seen = json.loads(lab.run_code(page, COMPARE))
    lab.shut_down(page)
    assert seen["changed"] == [] and seen["sent"] == []
    assert (seen["panels"] > 0) == any(
        marker in (lab.NOTEBOOKS / name).read_text() for marker in ("StageExplorer(", "LiveView(")
    )
    assert tabs >= {"04_blendshape_fit.ipynb": 2, "live_sensor.ipynb": 10}.get(name, 0)


def keys_to(number: int) -> list[str]:
    """From the lower end to step ``number``: PageUp goes five steps."""
    return ["Home", *["PageUp"] * (number // 5), *["ArrowRight"] * (number % 5)]


@pytest.fixture
def everything(page, address):
    """The notebook of one panel, opened and shown."""
    lab.open_notebook(page, address, "everything.ipynb")
    lab.run_cells(page, 0)
    page.locator(".adaptiveface-tabs").wait_for(timeout=120_000)
    yield page
    lab.shut_down(page)


def slider_of(page, name: str):
    """A parameter's slider, with its tab opened."""
    stages = list(dict.fromkeys(row["stage"] for row in describe()))
    page.locator(".adaptiveface-tabs .lm-TabBar-tab").nth(stages.index(name.partition(".")[0])).click()
    return page.locator(f".adaptiveface-{name.replace('.', '-')}")


@pytest.mark.slow
def test_every_default_is_reached_with_the_keys(everything):
    """From its lower end every slider goes back to its default, and the parameters are those of the start, bit by bit."""
    page = everything
    # Of a slider of whole numbers, up to 100000 steps long, only the next one is tried.
    listed = "{name: getattr(c, 'index', -1) for name, c in panel.controls.items() if 'Slider' in type(c).__name__}"
    steps = json.loads(lab.run_code(page, f"import asyncio, json; print(json.dumps({listed}))"))
    assert len(steps) == sum(type(row["default"]) in (int, float) for row in describe())
    for name, number in steps.items():
        slider_of(page, name).locator(".noUi-handle").focus()
        *keys, last = keys_to(number) if number >= 0 else ["ArrowRight", "ArrowLeft"]
        for key in keys:
            page.keyboard.press(key)
        page.wait_for_timeout(150)  # the browser sends the place before the last, and not only where the keys end
        page.keyboard.press(last)
        waited = "[await asyncio.sleep(0.02) for _ in range(250) if not told or told[-1] != Parameters()]"  # at most 5 s
        seen = lab.run_code(page, f"{waited}; print(len(told), repr(panel.parameters) == repr(Parameters())); told.clear()")
        assert seen.split()[1] == "True", (name, lab.run_code(page, f"print(panel['{name}'])"))
        assert number == 0 or int(seen.split()[0]) >= 2, f"{name} did not move"


@pytest.mark.slow
def test_a_number_is_typed_and_a_contradiction_is_refused(everything):
    page = everything

    def write(name: str, text: str) -> str:
        readout = slider_of(page, name).locator(".widget-readout")
        readout.click()
        page.keyboard.press("Control+a")
        page.keyboard.type(text)
        page.keyboard.press("Enter")
        page.wait_for_timeout(300)
        stage, _, entry = name.partition(".")
        return lab.run_code(page, f"print(panel.parameters.{stage}.{entry}, panel['{name}'].value)").strip()

    assert write("blendshapes.sparsity", "3.37") == "3.37 3.37"
    assert write("kalman.process_noise", "1e-3") == "0.001 0.001"
    assert write("rigid.max_correspondence_distance", "100000") == "200.0 200.0", "the end of the slider"
    assert write("rigid.max_correspondence_distance", "many") == "200.0 200.0"
    assert write("adaptive_pca.valid_min", "250") == "1.0 250.0", "above valid_max"
    message = page.locator(".adaptiveface-message")
    assert "valid_min = 250 is above adaptive_pca.valid_max = 100" in message.inner_text()
    assert write("adaptive_pca.valid_max", "300") == "300.0 300.0"
    assert message.inner_text() == "" and lab.run_code(page, "print(panel.parameters.adaptive_pca.valid_min)") == "250.0\n"
    page.get_by_role("button", name="reset all").click()
    page.wait_for_timeout(300)
    assert lab.run_code(page, "print(repr(panel.parameters) == repr(Parameters()))") == "True\n"
    assert page.problems == []


@pytest.mark.slow
def test_a_living_window_hides_its_picture(page, address):
    """The picture of pyvista's window is for pages without a kernel; both are in the notebook's output."""
    lab.open_notebook(page, address, "window.ipynb")
    lab.run_cells(page, 0)
    page.locator("iframe.pyvista").wait_for(timeout=60_000)
    picture = page.locator('img[alt="pyvista\'s window"]')
    picture.wait_for(state="attached", timeout=60_000)
    assert not picture.is_visible()
    lab.shut_down(page)
