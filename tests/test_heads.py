"""The bundle that draws heads in the browser is the one of its sources, and its licence is there."""

from __future__ import annotations

import base64
import hashlib
import json
import re
from pathlib import Path

import pytest

CHECKOUT = Path(__file__).resolve().parents[1]
ASSETS, SOURCES = CHECKOUT / "adaptiveface" / "assets", CHECKOUT / "js"


def test_the_bundle_was_built_from_these_sources():
    """Else: ``npm ci && npm run build`` in ``js``."""
    digest = hashlib.sha256()
    for path in (SOURCES / "package.json", *sorted((SOURCES / "src").glob("*.js"))):
        digest.update(path.read_bytes().replace(b"\r\n", b"\n"))
    banner, saved = ((ASSETS / name).read_text(encoding="utf-8").splitlines()[0] for name in ("heads.js", "saved_heads.js"))
    assert digest.hexdigest() in banner and digest.hexdigest() in saved
    wanted = json.loads((SOURCES / "package.json").read_text())["dependencies"]["three"]
    locked = json.loads((SOURCES / "package-lock.json").read_text())["packages"]["node_modules/three"]["version"]
    assert re.search(r"three.js (\S+), MIT", banner)[1] == wanted == locked


def test_the_licence_of_what_is_bundled_is_there():
    text = (ASSETS / "LICENSE-three.txt").read_text(encoding="utf-8")
    assert "three.js authors" in text and "MIT" in text
    assert "adaptiveface/assets/LICENSE-three.txt" in (CHECKOUT / "pyproject.toml").read_text()


PAGE = """<!doctype html><title>heads</title><div id="webgl"></div><div id="canvas"></div><script type="module">
import heads from "./heads.js";
const {states, buffers} = JSON.parse(document.querySelector("#sent").textContent);
const data = (value) => Array.isArray(value) ? value.map(data) : value === null || typeof value !== "object" ? value
  : "bytes" in value ? new DataView(Uint8Array.from(atob(buffers[value.bytes]), (letter) => letter.charCodeAt(0)).buffer)
  : Object.fromEntries(Object.entries(value).map(([name, one]) => [name, data(one)]));
const pictures = {};
for (const renderer of ["webgl", "canvas"]) {
  const values = {...data(states), renderer}, place = document.getElementById(renderer);
  place.addEventListener("adaptiveface-picture", ({target: drawn}) => {
    const copy = Object.assign(document.createElement("canvas"), {width: drawn.width / 5, height: drawn.height / 5});
    const context = copy.getContext("2d");
    context.imageSmoothingQuality = "high";
    context.drawImage(drawn, 0, 0, copy.width, copy.height); // means of squares: only one of them has smooth edges
    pictures[renderer] = context.getImageData(0, 0, copy.width, copy.height).data;
    if (Object.keys(pictures).length < 2) return;
    const [one, other] = [pictures.webgl, pictures.canvas], differences = [];
    for (let k = 0; k < one.length; k += 4) {
      if (!one[k + 3] && !other[k + 3]) continue;
      differences.push(Math.max(...[0, 1, 2, 3].map((c) => Math.abs(one[k + c] - other[k + c]))));
    }
    const out = document.createElement("pre");
    out.id = "out";
    const size = [copy.width, copy.height];
    out.textContent = JSON.stringify({size, drawn: differences.length, far: differences.filter((d) => d > 25).length});
    document.body.append(out);
  });
  heads.render({el: place, model: {get: (name) => values[name], set() {}, on() {}, off() {}, save_changes() {}}});
}</script><script id="sent" type="application/json">"""


def test_without_webgl_the_same_picture_is_drawn(tmp_path):
    """Skin with values, what is inside the head, and points; outlines may differ a little."""
    pytest.importorskip("anywidget", reason="the extra 'notebooks' is not installed")
    from web import ask

    from adaptiveface.geometry.mesh import vertex_normals
    from adaptiveface.model.face_model import embedded_face_model
    from adaptiveface.views.face_view import FaceView

    model = embedded_face_model()
    wide = model.mean + model.expressions[model.expression_names.index("jawOpen")]
    moving = wide[:, 1] != model.mean[:, 1]
    view = FaceView(
        model.mean, model.triangles, ["skin", "values", "points"], limits=(-80, 80), label="mm", pane=(150, 165), moving=moving
    )
    view.show(1, wide, model.mean[:, 1])
    view.show_points(2, model.mean, model.mean[:, 0], vertex_normals(model.mean, model.triangles), size=4)
    view.hide_head(2)
    view.look(35, 10)
    view.refresh()
    buffers: list[str] = []

    def packed(value):
        """Values for JSON; bytes by their number among ``buffers``."""
        if isinstance(value, bytes):
            buffers.append(base64.b64encode(value).decode())
            return {"bytes": len(buffers) - 1}
        if isinstance(value, dict):
            return {name: packed(one) for name, one in value.items()}
        return [packed(one) for one in value] if isinstance(value, (list, tuple)) else value

    sent = {name: packed(getattr(view._image, name)) for name in view._image.trait_names(sync=True) if name[0] != "_"}
    sent = {name: value for name, value in sent.items() if name not in ("layout", "tabbable", "tooltip")}
    text = json.dumps({"states": sent, "buffers": buffers})
    seen = ask(tmp_path / "page", tmp_path, f"{PAGE}{text}</script>", {"heads.js": ASSETS / "heads.js"})
    assert seen["size"] == [90, 33] and seen["drawn"] > 1200
    assert seen["far"] < 0.02 * seen["drawn"], f"smooth edges alone differ less: {seen}"


CELL = """
import ipywidgets as widgets, numpy as np
from adaptiveface import views
points = np.array([[-60.0, -60, 0], [60, -60, 0], [0, 80, 0], [0, 0, 60]])
view = views.FaceView(points, np.array([[0, 1, 3], [1, 2, 3], [2, 0, 3]]), ["left", "right"], limits=(0, 5), label="mm")
chart = views.LiveChart(("error",), (0, 9), (0, 1), "frame", "mm")
widgets.VBox([view.widget, chart.widget])
"""
SAVED_PAGE = """{html}<script>document.addEventListener("adaptiveface-picture", (event) => {{
  const out = document.createElement("pre");
  out.id = "out";
  const sizes = [...document.querySelectorAll(".adaptiveface-saved img")].map((image) => image.naturalWidth);
  out.textContent = JSON.stringify({{camera: event.target.dataset.camera, titles: document.body.innerText, sizes}});
  document.body.append(out);
}}, {{once: true}});</script>"""


def test_a_notebook_made_html_has_heads_that_turn_and_pictures(tmp_path):
    """Without a network: what would fetch the live widgets' code fails, and the picture stands there all the same."""
    nbformat = pytest.importorskip("nbformat", reason="the extra 'notebooks' is not installed")
    nbclient = pytest.importorskip("nbclient", reason="the extra 'test' is not installed")
    nbconvert = pytest.importorskip("nbconvert", reason="the extra 'notebooks' is not installed")
    from web import ask

    notebook = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(CELL)])
    nbclient.NotebookClient(notebook, timeout=300).execute()
    html, _ = nbconvert.HTMLExporter().from_notebook_node(notebook)
    seen = ask(tmp_path / "page", tmp_path, SAVED_PAGE.format(html=html.replace("https://", "http://127.0.0.1:9/")), {})
    assert seen["camera"] == "0 0 1" and "left" in seen["titles"] and seen["sizes"] == [380], "a chart beside the heads"
