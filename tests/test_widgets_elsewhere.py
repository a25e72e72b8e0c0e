"""The notebooks' widgets outside Jupyter: in a page with the standard widget manager and anywidget's own front end.

Colab and VS Code are not here to try; what they share with this page is all that the widgets may ask for.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("anywidget", reason="the extra 'notebooks' is not installed")

import anywidget  # noqa: E402
import ipywidgets as widgets  # noqa: E402
from ipywidgets.embed import dependency_state, embed_data  # noqa: E402
from web import ask, install  # noqa: E402

from adaptiveface import views  # noqa: E402
from adaptiveface.views.thresholds import Thresholds  # noqa: E402
from adaptiveface.views.turntable import Turntable  # noqa: E402

MANAGER = ("@jupyter-widgets/html-manager@1.0.15", "requirejs@2.3.8")
PAGE = """<!doctype html><title>widgets</title><body>
<script src="/node_modules/requirejs/require.js"></script>
<script>requirejs.config({paths: {anywidget: "/anywidget"}})</script>
<script src="/node_modules/@jupyter-widgets/html-manager/dist/embed-amd.js"></script>
<script type="application/vnd.jupyter.widget-state+json">STATE</script>
<script type="application/vnd.jupyter.widget-view+json">VIEW</script>
<script>
const wanted = ["canvas.adaptiveface-face", ".adaptiveface-threshold-high", "img.adaptiveface-turned", ".widget-readout",
  ".adaptiveface-tabs .lm-TabBar-tab, .adaptiveface-tabs .p-TabBar-tab"];
let drawn = false;
document.addEventListener("adaptiveface-picture", () => { drawn = true; });
const timer = setInterval(() => {
  const found = wanted.map((one) => document.querySelectorAll(one).length);
  if (!drawn || found.includes(0)) return;
  clearInterval(timer);
  const face = document.querySelector("canvas.adaptiveface-face"), box = face.getBoundingClientRect();
  face.setPointerCapture = () => {};
  const send = (type, x) => face.dispatchEvent(
    new PointerEvent(type, {pointerId: 1, button: 0, clientX: box.x + x, clientY: box.y + 50, bubbles: true}));
  send("pointerdown", 50);
  send("pointermove", 100);
  send("pointerup", 100);
  face.addEventListener("adaptiveface-picture", () => {
    const out = Object.assign(document.createElement("pre"), {id: "out"});
    out.textContent = JSON.stringify({found, camera: face.dataset.camera, lab: "jupyterapp" in window});
    document.body.append(out);
  }, {once: true});
}, 100);
</script>"""


def everything() -> widgets.Widget:
    """One of each kind of widget that is our own, and a panel of parameters."""
    points = np.array([[-60.0, -60, 0], [60, -60, 0], [0, 80, 0], [0, 0, 60]])
    faces = views.FaceView(points, np.array([[0, 1, 3], [1, 2, 3], [2, 0, 3]]), ["one"], limits=(0, 5), label="mm")
    faces.refresh()
    lines = Thresholds(low=1.0, high=100.0, names={"low": "valid_min", "high": "valid_max"})
    panel = views.ParameterPanel(["laplacian", "adaptive_pca"], lambda _: None)
    return widgets.VBox([faces.widget, lines, Turntable(name="adaptiveface-turned"), panel.widget])


def test_the_standard_widget_manager_shows_every_widget(tmp_path):
    """A head that turns, lines to drag, a picture, sliders with numbers, tabs: without JupyterLab and without a network."""
    modules = install(tmp_path, *MANAGER)
    shown = everything()
    data = embed_data(views=[shown], state=dependency_state([shown], drop_defaults=False))
    page = PAGE.replace("VIEW", _script(data["view_specs"][0])).replace("STATE", _script(data["manager_state"]))
    front_end = Path(anywidget.__file__).parent / "nbextension" / "index.js"
    seen = ask(tmp_path / "page", modules, page, {"anywidget.js": front_end})
    assert min(seen["found"]) >= 1 and not seen["lab"]
    assert abs(float(seen["camera"].split()[0])) == pytest.approx(20, abs=0.1), "50 pixels are 20 degrees"


def _script(data) -> str:
    return json.dumps(data).replace("</", "<\\/")
