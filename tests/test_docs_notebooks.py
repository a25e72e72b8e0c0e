"""Executed notebooks for the site: panels become pictures, nothing needs a kernel, and a fresh copy is not run again."""

from __future__ import annotations

import base64
import importlib
import io
import json
import sys
from pathlib import Path

import numpy as np
import pytest

nbformat = pytest.importorskip("nbformat", reason="the extra 'notebooks' is not installed")
pytest.importorskip("nbclient", reason="the extra 'test' is not installed")
pytest.importorskip("ipywidgets", reason="the extra 'notebooks' is not installed")
from PIL import Image  # noqa: E402

DOCS = Path(__file__).resolve().parents[1] / "docs"
CELL = """
import io, sys
import ipywidgets as widgets, numpy as np
from PIL import Image
stream = io.BytesIO()
Image.fromarray(np.full((40, 1800, 3), 200, np.uint8)).save(stream, "JPEG")
picture = widgets.Image(value=stream.getvalue(), format="jpeg")
print("noise", file=sys.stderr)
widgets.VBox([widgets.HTML("<style>p {}</style>"), widgets.HTML("a <b>note</b>"), widgets.IntSlider(3), picture])
"""


@pytest.fixture
def script(monkeypatch, tmp_path):
    monkeypatch.syspath_prepend(str(DOCS))
    module = importlib.import_module("execute_notebooks")
    monkeypatch.setattr(module, "EXECUTED", tmp_path / "executed")
    yield module
    sys.modules.pop("execute_notebooks")


def test_a_panel_becomes_its_picture_and_words_and_is_run_once(script, tmp_path):
    source = tmp_path / "planted.ipynb"
    nbformat.write(nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(CELL)]), source)
    assert script.execute(source, "package") and not script.execute(source, "package")
    page = json.loads((tmp_path / "executed" / "planted.ipynb").read_text(encoding="utf-8"))
    assert "widgets" not in page["metadata"] and "noise" not in json.dumps(page["cells"][0]["outputs"])
    words, picture = page["cells"][0]["outputs"]
    assert words["data"] == {"text/html": "<p>a <b>note</b></p>"}
    drawn = Image.open(io.BytesIO(base64.b64decode(picture["data"]["image/jpeg"])))
    assert drawn.size == (900, 20) and abs(np.asarray(drawn).mean() - 200) < 3
    assert script.execute(source, "another package")


def test_a_picture_that_the_mouse_turns_is_shown_too(script):
    panels = importlib.import_module("panels")
    stream = io.BytesIO()
    Image.new("RGB", (30, 20), "white").save(stream, "PNG")
    buffer = {"path": ["value"], "data": base64.b64encode(stream.getvalue()).decode()}
    state = {"a": {"model_name": "AnyModel", "state": {"_esm": "", "camera": []}, "buffers": [buffer]}}
    cell = {"cell_type": "code", "outputs": [{"output_type": "display_data", "data": {panels.VIEW: {"model_id": "a"}}}]}
    page = panels.static({"metadata": {"widgets": {panels.STATE: {"state": state}}}, "cells": [cell]})
    assert list(page["cells"][0]["outputs"][0]["data"]) == ["image/png"]


HEAD_CELL = """
import numpy as np
from adaptiveface.views.face_view import FaceView
points = np.array([[-60.0, -60, 0], [60, -60, 0], [0, 80, 0], [0, 0, 60]])
view = FaceView(points, np.array([[0, 1, 3], [1, 2, 3], [2, 0, 3]]), ["left", "right"], limits=(0, 5), label="mm")
view.show(1, points, np.arange(4.0))
view.refresh()
view.widget
"""
HEAD_PAGE = """<!doctype html><title>heads</title>{heads}
<script>document.addEventListener("adaptiveface-picture", (event) => {{
  const out = document.createElement("pre");
  out.id = "out";
  out.textContent = JSON.stringify({{camera: event.target.dataset.camera, titles: document.body.innerText}});
  document.body.append(out);
}}, {{once: true}});</script><script defer src="saved_heads.js"></script>"""


def test_heads_are_drawn_by_the_page_itself(script, tmp_path):
    """What the widget held is in the page, and the viewer of saved notebooks draws it there without a kernel."""
    from web import ask

    source = tmp_path / "heads.ipynb"
    nbformat.write(nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(HEAD_CELL)]), source)
    script.execute(source, "package")
    page = json.loads((tmp_path / "executed" / "heads.ipynb").read_text(encoding="utf-8"))
    (output,) = page["cells"][0]["outputs"]
    assets = {"saved_heads.js": DOCS.parent / "adaptiveface/assets/saved_heads.js"}
    html = HEAD_PAGE.format(heads=output["data"]["text/html"])
    seen = ask(tmp_path / "page", tmp_path, html, assets)
    assert seen["camera"] == "0 0 1" and "left" in seen["titles"] and "right" in seen["titles"]
